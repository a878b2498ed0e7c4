//! Needle tracking in stereo images.
//!
//! A curve through a few control points per image, filtered by Kalman's equations with the
//! robot's odometry; measured along its normals and at its tip; and one curve in space fitted to
//! both images through the refracting walls.

mod across;
mod find;
mod planar;
mod polynomial;
mod settings;
mod solid;
mod stereo;
mod tip;

pub use polynomial::MAX_POINTS;
pub use settings::{Surface, TrackSettings, TrackSettingsError};
pub use stereo::{Context, Curve2, FrameError, LossReason, StereoTracker, Tracked};
