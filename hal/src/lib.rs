//! Vocabulary of the needle-steering system and the contracts of its devices.
//!
//! A controller that is to run on a simulator today and on an arm tomorrow needs words that both
//! understand. Everything that crosses a seam between crates is defined here. In reading order:
//!
//! * What is measured: [`Stamp`] (time is data), [`Transform`] and [`Position`] between named frames,
//!   [`Twist`], [`Joints`], [`GrayImage`], [`SensedShape`], [`WavelengthShifts`], [`SensedMarker`].
//! * Devices: [`Arm`] with its contract, [`ShapeSensor`], [`FibreSensor`], [`StereoCamera`],
//!   [`MarkerSensor`]; what goes wrong with them is an [`Error`].
//! * What stands before an arm: [`Guard`], limits that downstream code cannot violate, of which
//!   [`Limiter`] is the part for joints; [`Guarded`], any arm behind a guard; [`Recorded`], an arm whose
//!   traffic is kept.
//! * What a run shows and takes: [`Telemetry`], one snapshot a step; [`request`], what may be asked of it;
//!   [`Overlay`], what is drawn over an image.
//!
//! **Architecture invariant:** this crate does no I/O, reads no clock and starts no thread.
#![cfg_attr(
    test,
    allow(clippy::float_cmp, reason = "tests compare exact constructions")
)]

pub mod arm;
pub mod error;
pub mod fibre;
pub mod frame;
pub mod guarded;
pub mod image;
pub mod joints;
pub mod marker;
pub mod overlay;
pub mod recorded;
pub mod request;
pub mod shape;
pub mod telemetry;
pub mod time;
pub mod twist;

pub use arm::{Arm, ArmDescription, ArmMode, ArmState, FaultReason, RateCommand};
pub use error::{Error, ErrorKind};
pub use fibre::{FibreSensor, WavelengthShifts};
pub use frame::{Position, Transform};
pub use guarded::{Guard, Guarded, Limiter};
pub use image::{CameraFrame, GrayImage, StereoCamera, StereoFrame};
pub use joints::{JointLimit, JointLimits, Joints, MAX_JOINTS};
pub use marker::{MarkerSensor, SensedMarker};
pub use overlay::Overlay;
pub use recorded::Recorded;
pub use shape::{SensedPoint, SensedShape, SensedTip, ShapeSensor};
pub use telemetry::Telemetry;
pub use time::{Clock, Stamp};
pub use twist::Twist;

/// The example of the README, as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
