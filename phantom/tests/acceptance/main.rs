//! The phantom's own acceptance: its physics against closed forms and invariants.

mod authority;
mod bench;
mod energy;
mod events;
mod invariance;
mod population;
mod steering;
mod support;
mod tissue;
