//! A phantom and needles for the tests.

use hal::{Stamp, Transform};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use crate::NeedleView;
use crate::camera::{CameraSettings, StereoRig};

pub(super) fn world_from_phantom() -> Isometry3<f64> {
    Isometry3::new(
        Vector3::new(0.4, 0.0, 0.25),
        Vector3::x() * core::f64::consts::PI,
    )
}

pub(super) fn rig(settings: &CameraSettings, seed: u64) -> StereoRig {
    StereoRig::new(settings, &world_from_phantom(), seed).unwrap()
}

/// A needle `depth` deep, bent by `bend` d^2 towards `azimuth`; its bevel turned by `bevel`.
pub(super) fn needle(depth: f64, bend: f64, azimuth: f64, bevel: f64) -> NeedleView {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), azimuth);
    let at = |z: f64| turn * Vector3::new(0.0, -bend * z.max(0.0).powi(2), z);
    let slope = 2.0 * bend * depth.max(0.0);
    let lean = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), slope.atan());
    let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), bevel);
    NeedleView {
        stamp: Stamp::ZERO,
        centreline: (0..=252)
            .map(|i| at(depth - 0.126 + 0.5e-3 * f64::from(i)))
            .map(|p| (world_from_phantom() * Point3::from(p)).coords)
            .collect(),
        world_from_tip: Transform::assume(
            world_from_phantom()
                * Isometry3::from_parts(Translation3::from(at(depth)), turn * lean * roll),
        ),
        outer_diameter: 0.7e-3,
        bevel_angle: 24f64.to_radians(),
        entry_arc: 0.126 - depth,
    }
}
