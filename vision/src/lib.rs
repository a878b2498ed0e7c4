//! Stereo calibration and needle tracking.
//!
//! * [`camera`]: camera models, refraction through the container's walls, triangulation.
//! * [`detect`]: chessboards in images.
//! * [`calibrate`]: from corners to a rig with covariance.
//! * [`report`]: a calibration as an HTML page.
//! * [`register`]: the cameras in the laboratory.
//! * [`track`]: the needle in stereo images.
//! * [`files`]: calibrations and images on disk.
#![cfg_attr(
    test,
    allow(clippy::float_cmp, reason = "tests compare exact constructions")
)]

pub mod calibrate;
pub mod camera;
pub mod detect;
pub mod files;
mod homography;
pub mod register;
pub mod report;
pub mod track;

pub use camera::{Camera, DistortedPx, StereoRig, UndistortedPx};
