//! Steering laws: tasks, priorities, duty cycling, prediction, estimation.
//!
//! Read [`view`] first: what a law sees and what it answers. The paper's section III follows
//! equation by equation in [`tasks`], [`priority`] and [`duty_cycle`]; beyond the paper are the
//! [`bevel`] modulator, the [`levels`] with inequality constraints and the [`estimator`] with
//! its predictive model. [`freedom`] is what a device can do. [`motion`] takes moving tissue out of all of them. [`laws`] puts them
//! together; [`reach`] says when it is over.
//!
//! Everything is in World unless a name says otherwise; SI units.
//!
//! **Architecture invariant:** no device, no clock, no I/O; time and measurements are
//! arguments, and nothing here fails at run time: what cannot be used gives zero velocity.

pub mod view;

pub mod tasks;

pub mod priority;

pub mod duty_cycle;

pub mod bevel;
pub mod qp;

pub mod levels;

pub mod estimator;
pub mod freedom;
pub mod laws;
pub mod motion;
pub mod reach;
pub mod settings;
mod workspace;

pub use estimator::{Estimator, EstimatorError, Health, Observation, Rollout, Start, TipSensor};
pub use freedom::Freedom;
pub use laws::{LAW_NAMES, LawError, guarded, law_by_name};
pub use motion::{TissueField, TissueMotion, TissueSway};
pub use reach::{
    Means, Reach, ReachMonitor, Unreachable, lateral_error, reachable_at_start, target_ahead,
};
pub use settings::{EstimatorSettings, LawSettings, Limits, MotionSettings};
pub use view::{Decision, Entry, Law, RollTravel, Springs, Target, Tip, View};
pub use workspace::inside_workspace;

/// Property tests that draw the same cases in every run.
#[cfg(test)]
fn seeded() -> proptest::test_runner::Config {
    proptest::test_runner::Config {
        rng_seed: proptest::test_runner::RngSeed::Fixed(1),
        ..Default::default()
    }
}
