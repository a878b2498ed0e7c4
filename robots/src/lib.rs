//! Arms behind the hal traits.
//!
//! A needle is moved by a twist of its base, an arm by the rates of its joints; between the two lies the
//! arm's geometry, and behind them something that moves. In reading order:
//!
//! * [`kinematics`]: a [`Chain`](kinematics::Chain) read from a URDF, with forward and inverse kinematics,
//!   Jacobians and joint rates for twists. [`arms`] holds the descriptions that ship.
//! * [`sim`]: a [`SimulatedArm`](sim::SimulatedArm) that needs no hardware, with lag, latency and faults to
//!   inject.
//! * [`viper`]: the Adept Viper S650 over its controller's sockets, driver and emulator.
//! * [`meshes`]: the files of shapes that a URDF names.
//!
//! SI units, radians; twists are \[linear; angular\] of the tip's origin, along the axes of the chain's root.
//!
//! **Architecture invariant:** nothing here knows of needles, tissue, cameras or laws.

pub mod arms;
pub mod kinematics;
pub mod meshes;
pub mod sim;
pub mod viper;

/// The example of the README, as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
