//! The Adept Viper S650 behind a socket: [driver], [frames](wire) and an
//! [emulator] of its controller.
//!
//! The driver's decisions are a state machine without I/O or clock ([`driver::Core`]); [`tcp`]
//! joins it to sockets and a wall clock, [`lockstep`] to an emulator and a virtual clock.
//! Nothing here was tried on hardware.
//!
//! **Architecture invariant:** no lock is held across I/O, and no queue is unbounded.

pub mod arm;
pub mod config;
pub mod driver;
pub mod emulator;
pub mod lockstep;
pub mod tcp;
mod trapezoid;
pub mod wire;

pub use arm::{Monitor, ViperArm};
pub use config::{Config, ConfigError, Dialect, Timing, Tolerances, viper_limits};
pub use driver::{Fault, LinkError, Metrics, ProtocolError, Refused, ToolLimits, Unfit};
pub use emulator::Emulator;
pub use lockstep::Lockstep;

/// The two connections of a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Port {
    /// Points, stops and their answers.
    Motion,
    /// Feedback.
    State,
}

impl Port {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Motion, Self::State];
}
