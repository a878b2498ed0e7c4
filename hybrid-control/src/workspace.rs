//! The bounds of the base's place and tilt.

use hal::Twist;
use nalgebra::{Isometry3, Vector3};

use crate::settings::Limits;
use crate::view::Entry;

/// Time constant with which the base approaches the workspace's bounds \[s\]: twice a step that
/// comes late, the delay of an arm and its braking together.
const APPROACH: f64 = 0.3;

/// The part of a motion of the base that lets it come to rest at the workspace's bounds: the
/// outward speed falls with the room that is left, so an arm that lags does not run over them,
/// and many small steps do not creep over them.
pub(crate) fn inside_workspace(
    twist: &Twist,
    base: &Isometry3<f64>,
    entry: &Entry,
    limits: &Limits,
) -> f64 {
    let inward = entry.inward.into_inner();
    let axis = base.rotation * Vector3::z();
    let arm = base.translation.vector - entry.point.coords;
    let across = arm - inward * inward.dot(&arm);
    let tilt_room = limits.tilt_deg.to_radians() - axis.angle(&inward);
    let offset_room = limits.base_offset_mm * 1e-3 - across.norm();
    let outwards = [
        (inward.cross(&axis), twist.angular, tilt_room),
        (across, twist.linear, offset_room),
    ];
    outwards
        .into_iter()
        .filter_map(|(out, motion, room)| {
            let speed = out.try_normalize(1e-9)?.dot(&motion);
            let most = room.max(0.0) / APPROACH;
            (speed > most).then(|| most / speed)
        })
        .fold(1.0, f64::min)
}
