//! Cameras, and how points and pixels correspond.
//!
//! The conventions are OpenCV's: x right, y down, z forward; pixel centres have integer
//! coordinates.

mod lens;
mod pinhole;
mod refraction;
mod rig;
mod triangulate;

pub use lens::{Distortion, INTRINSICS, LensModel};
pub use pinhole::{Camera, InvalidCamera, Projection};
pub use refraction::{FlatWindow, InvalidWindow, Ray, WindowRay};
pub use rig::{Container, StereoRig, View, ViewRay};
pub use triangulate::{NoPoint, Triangulated, triangulate};

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

/// A point of a camera's image as the sensor shows it \[px\].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DistortedPx(pub Point2<f64>);

/// Where the point would be, had the lens no distortion: the same camera matrix, a pinhole
/// \[px\].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct UndistortedPx(pub Point2<f64>);

impl DistortedPx {
    /// From column and row \[px\].
    pub const fn new(x: f64, y: f64) -> Self {
        Self(Point2::new(x, y))
    }
}

impl UndistortedPx {
    /// From column and row \[px\].
    pub const fn new(x: f64, y: f64) -> Self {
        Self(Point2::new(x, y))
    }
}
