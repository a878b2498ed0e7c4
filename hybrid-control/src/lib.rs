//! Steering laws: tasks, priorities, duty cycling, prediction, estimation.
//!
//! A needle that is pushed goes where its bevel, its base and the tissue let it. A law says how to move
//! the base, thirty times a second, so that the tip comes to the target. In reading order:
//!
//! * The seam: [`View`], all that a law sees; [`Decision`], what it answers; [`Law`], the contract. The
//!   laws that ship are had by [`law_by_name`]; one of your own is kept within limits by [`guarded`].
//! * The paper's section III, equation by equation: [`tasks`], [`priority`], [`duty_cycle`].
//! * Beyond the paper: the [`bevel`] modulator, [`levels`] of tasks with inequality constraints and their
//!   solver [`qp`], and the [`Estimator`], which filters the tip and predicts its path.
//! * The world around it: [`Freedom`], what a device can do; [`motion`], which takes moving tissue out of
//!   all of the above; [`ReachMonitor`], which says when a target is out of reach.
//! * Numbers: [`LawSettings`], [`EstimatorSettings`], [`Limits`].
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

/// The example of the README, as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

/// Property tests that draw the same cases in every run.
#[cfg(test)]
fn seeded() -> proptest::test_runner::Config {
    proptest::test_runner::Config {
        rng_seed: proptest::test_runner::RngSeed::Fixed(1),
        ..Default::default()
    }
}
