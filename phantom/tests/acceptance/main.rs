//! The phantom's own acceptance: its physics against closed forms and invariants.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail where they stand")]

mod authority;
mod axial;
mod bench;
mod continuum;
mod energy;
mod entry;
mod events;
mod flaws;
mod invariance;
mod marker;
mod nonsense;
mod population;
mod ranges;
mod steering;
mod stress;
mod support;
mod tissue;
