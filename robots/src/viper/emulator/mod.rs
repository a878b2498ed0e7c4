//! The controller's emulator: what the public 2018 program does, and what our own `steer`
//! program is meant to do, with every fault of the [knobs](Knobs).
//!
//! It cannot show what only the real controller knows: the preamble, the bits of STATE, V+'s
//! throughput and blending of small steps, ALTER, abort and restart, real accelerations and stop
//! distances, the emergency-stop chain.

mod controller;
mod handle;
mod journal;
mod knobs;
mod outbox;
mod program_2018;
mod segment;
mod server;
mod steer_program;

use std::time::Duration;

use hal::{JointLimit, Joints};

pub use handle::Emulator;
pub use journal::{Entry, Journal, Record};
pub use knobs::{Answers, Knobs};
pub use server::{Server, ServerError};

use super::config::{Dialect, viper_limits};

/// What to emulate.
#[derive(Clone, Debug, PartialEq)]
pub struct EmulatorConfig {
    /// The program that runs.
    pub dialect: Dialect,
    /// Where the arm stands \[rad\].
    pub start: Joints,
    /// Limits of the arm; the 2018 program has no other.
    pub limits: Vec<JointLimit>,
    /// Number of joints that the program claims.
    pub joints: i32,
    /// Trajectory cycle.
    pub cycle: Duration,
    /// Entries that the journal keeps; 0 switches it off.
    pub journal: usize,
    /// Seed of losses and jitter.
    pub seed: u64,
}

impl EmulatorConfig {
    /// A Viper S650 standing at `start` \[rad\].
    pub fn viper(dialect: Dialect, start: Joints) -> Self {
        Self {
            dialect,
            start,
            limits: viper_limits(),
            joints: 6,
            cycle: Duration::from_millis(16),
            journal: 100_000,
            seed: 1,
        }
    }
}
