//! The bounds of the base's place and tilt.

use hal::Twist;
use nalgebra::{Isometry3, Vector3};

use crate::settings::Limits;
use crate::view::Entry;

/// Time constant with which the base approaches the workspace's bounds \[s\]: twice a step that
/// comes late, the delay of an arm and its braking together.
const APPROACH: f64 = 0.3;

/// Outward speeds below this are rounding \[rad/s, m/s\]: a base at its bound may spin and insert.
const ROUNDING: f64 = 1e-9;

/// The part of a motion of the base that lets it come to rest at the workspace's bounds: the
/// outward speed falls with the room that is left, so an arm that lags does not run over them,
/// and many small steps do not creep over them.
pub fn inside_workspace(
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
            (speed > most + ROUNDING).then(|| most / speed)
        })
        .fold(1.0, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, UnitQuaternion};

    fn entry() -> Entry {
        Entry {
            point: Point3::new(0.4, 0.1, 0.25),
            inward: -Vector3::z_axis(),
        }
    }

    /// A base above the entry, tilted by `degrees` towards `azimuth`, its axis through the entry.
    fn tilted(degrees: f64, azimuth: f64) -> Isometry3<f64> {
        let towards = Vector3::new(-azimuth.sin(), azimuth.cos(), 0.0);
        let turn = UnitQuaternion::from_scaled_axis(towards * degrees.to_radians())
            * UnitQuaternion::from_scaled_axis(Vector3::x() * core::f64::consts::PI);
        let origin = entry().point.coords - turn * Vector3::z() * 0.08;
        Isometry3::from_parts(origin.into(), turn)
    }

    #[test]
    fn a_base_over_its_bounds_spins_inserts_and_turns_back() {
        let limits = Limits::default();
        let mut rounded = 0;
        for k in 0..360 {
            let base = tilted(limits.tilt_deg + 1e-3, f64::from(k).to_radians());
            let axis = base.rotation * Vector3::z();
            let out = entry().inward.cross(&axis).normalize();
            let part = |twist: Twist| inside_workspace(&twist, &base, &entry(), &limits);
            let screw = Twist {
                linear: axis * 3e-3,
                angular: axis * 6.0,
            };
            rounded += i32::from(out.dot(&screw.angular) > 0.0);
            assert!((part(screw) - 1.0).abs() < f64::EPSILON, "at {k} degrees");
            let turn = |rate: f64| Twist {
                linear: Vector3::zeros(),
                angular: out * rate,
            };
            assert!((part(turn(-0.1)) - 1.0).abs() < f64::EPSILON);
            assert!(part(turn(1e-6)).abs() < f64::EPSILON);
        }
        assert!(rounded > 0, "no case with an outward speed by rounding");
    }
}
