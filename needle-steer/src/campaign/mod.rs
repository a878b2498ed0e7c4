//! Campaigns: laws x phantoms x targets x seeds, on all cores, resumable, in shards.
//!
//! A campaign's [`plan`] numbers its runs; the [`ledger`] holds one line for each finished run,
//! on the disk before the next begins; the [`table`] is those lines in order, so that an
//! interrupted campaign ends with the same table as an uninterrupted one. [`compare`] draws the
//! conclusions.

pub mod plan;
pub mod ledger;
pub mod table;
pub mod execute;
pub mod compare;
pub mod interval;

pub use compare::{Cell, Conclusions, Pair};
pub use execute::{Failure, Shard, execute};
pub use ledger::{Ledger, LedgerError};
pub use plan::{Plan, PlanError, Task};
pub use table::Row;
