//! Stereo calibration and needle tracking.
//!
//! Two cameras look through the walls of a container at a needle half a millimetre thick; its tip is
//! wanted in 3D to a tenth of a millimetre, with an honest covariance. In reading order:
//!
//! * [`camera`]: a [`Camera`], two of them as a [`StereoRig`], refraction through the container's walls,
//!   [`triangulate`](camera::triangulate). [`DistortedPx`] and [`UndistortedPx`] are different types.
//! * [`detect`]: boards in images, [`detect_board`](detect::detect_board).
//! * [`calibrate`]: from corners to a rig with covariance, [`calibrate_stereo`](calibrate::calibrate_stereo).
//! * [`register`]: the cameras in the laboratory.
//! * [`track`]: the needle in stereo images.
//! * [`report`]: a calibration as an HTML page. [`files`]: calibrations and images on disk.
//!
//! Metres in the left camera's frame (x right, y down, z forward), pixels as in OpenCV.
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

/// The example of the README, as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
