//! The parameters of a stereo rig, true or as a calibration believes them.

use hal::frame::{LeftCamera, RightCamera, World};
use hal::{Position, Transform};
use nalgebra::{Unit, Vector3};
use serde::{Deserialize, Serialize};

use super::lens::Lens;
use super::view::View;

/// One of the two cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// The left camera, whose frame is the stereo frame.
    Left,
    /// The right camera.
    Right,
}

impl Side {
    /// Both, left first.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// 0 for left, 1 for right.
    pub const fn index(self) -> usize {
        match self {
            Self::Left => 0,
            Self::Right => 1,
        }
    }
}

/// A plane in the stereo frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plane {
    /// Any point of it \[m\].
    pub point: Position<LeftCamera>,
    /// Unit normal.
    pub normal: Unit<Vector3<f64>>,
}

/// The gel's container, in the stereo frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Container {
    /// Outer face of the wall before the left camera; the normal points out of the container.
    pub left_wall: Plane,
    /// Outer face of the wall before the right camera; the normal points out of the container.
    pub right_wall: Plane,
    /// The gel's surface; the normal points out of the gel.
    pub surface: Plane,
    /// Thickness of both walls \[m\].
    pub wall_thickness: f64,
    /// Refractive index of the walls.
    pub wall_index: f64,
    /// Refractive index of the gel.
    pub gel_index: f64,
}

/// Everything that is needed to project a point into both cameras.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigParameters {
    /// Width of both images \[px\].
    pub width_px: usize,
    /// Height of both images \[px\].
    pub height_px: usize,
    /// Left camera's intrinsics.
    pub left: Lens,
    /// Right camera's intrinsics.
    pub right: Lens,
    /// Extrinsics of the pair.
    pub right_from_left: Transform<RightCamera, LeftCamera>,
    /// The stereo frame in the laboratory: truth, or as a registration has it.
    pub left_from_world: Transform<LeftCamera, World>,
    /// Container and media.
    pub container: Container,
}

impl RigParameters {
    /// The projection of one camera.
    pub fn view(&self, side: Side) -> View {
        View::new(self, side)
    }
}
