//! Vocabulary of the needle-steering system and the contracts of its devices.
//!
//! Everything that crosses a seam between crates is defined here: [time], [frames](frame),
//! [twists](twist), [joints], [images](image), [sensed needle shapes](shape) and [markers](marker), the
//! [`Arm`] and sensor traits, the decorators that guard and record an arm, the
//! [`Telemetry`] snapshot and the [`Error`] of devices.
//!
//! **Architecture invariant:** this crate does no I/O, reads no clock and starts no thread.
#![cfg_attr(
    test,
    allow(clippy::float_cmp, reason = "tests compare exact constructions")
)]

pub mod arm;
pub mod error;
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
