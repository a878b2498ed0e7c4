//! Where a run goes: the target of a configuration.

use hal::frame::LeftCamera;
use hal::{Position, Transform};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::config::{Config, TargetKind};
use crate::world::place_target;

/// The configuration's target in the stereo frame.
pub(crate) fn stereo_target(config: &Config) -> Position<LeftCamera> {
    let [x, y, z] = config.target.position_mm.map(|v| v * 1e-3);
    Position::new(Point3::new(x, y, z))
}

/// Aligned or shifted target from a tip and the holder's pose, World \[m\].
pub(crate) fn nominal_target(
    config: &Config,
    tip: &Vector3<f64>,
    world_from_holder: &Isometry3<f64>,
) -> Vector3<f64> {
    let t = &config.target;
    let offset = if t.kind == TargetKind::Aligned {
        0.0
    } else {
        t.offset_mm * 1e-3
    };
    place_target(
        tip,
        &Transform::assume(*world_from_holder),
        t.depth_mm * 1e-3,
        offset,
        t.angle_deg.to_radians(),
    )
}
