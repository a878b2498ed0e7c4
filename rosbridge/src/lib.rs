//! ROS 1: messages, logs of runs, back end, telemetry.
//!
//! Builds with no ROS installed: the message definitions are part of this crate.
//!
//! * [`msg`]: the messages, generated from `msgs` at build time.
//! * [`log`]: a run as an MCAP file of ROS 1 messages, written while it goes, and read back
//!   bit by bit.
//!
//! **Architecture invariant:** nothing here runs inside the control loop; the loop hands over
//! snapshots and goes on.

mod codes;
pub mod convert;
mod display;
pub mod log;
pub mod msg;
mod step;

pub use convert::ConvertError;
