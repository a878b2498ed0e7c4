//! What every law is wrapped in: finite numbers in and out, speeds and travel kept.

use hal::Twist;
use hal::telemetry::Limit;
use nalgebra::Vector3;

use crate::estimator::Estimator;
use crate::view::{Decision, Law, View};

/// Time constant with which the base approaches the workspace's bounds \[s\]: twice a step that
/// comes late, the delay of an arm and its braking together.
const APPROACH: f64 = 0.3;

struct Guarded<L>(L);

pub(super) fn guarded<L: Law + 'static>(law: L) -> Box<dyn Law> {
    Box::new(Guarded(law))
}

impl<L: Law> Law for Guarded<L> {
    fn name(&self) -> &'static str {
        self.0.name()
    }

    fn decide(&mut self, view: &View<'_>) -> Decision {
        if !view.is_finite() {
            return Decision::hold();
        }
        // Tilting moves the last joint too: the law may not spend the whole travel on spin.
        let reserve = view.limits.roll_reserve_deg.to_radians();
        let view = &View {
            roll_travel: view.roll_travel.within(reserve),
            ..*view
        };
        let mut decision = self.0.decide(view);
        if !decision.twist.is_finite() {
            return Decision::hold();
        }
        keep_limits(&mut decision, view);
        decision
    }

    fn predicted_path(&self, estimator: &Estimator, path: &mut Vec<Vector3<f64>>) {
        self.0.predicted_path(estimator, path);
    }

    fn reset(&mut self) {
        self.0.reset();
    }
}

/// A base twist seen along and across the needle.
struct Parts {
    insertion: f64,
    spin: f64,
    across: Vector3<f64>,
    tilt: Vector3<f64>,
}

impl Parts {
    fn of(twist: &Twist, axis: &Vector3<f64>) -> Self {
        let (insertion, spin) = (axis.dot(&twist.linear), axis.dot(&twist.angular));
        Self {
            insertion,
            spin,
            across: twist.linear - axis * insertion,
            tilt: twist.angular - axis * spin,
        }
    }

    fn whole(&self, axis: &Vector3<f64>) -> Twist {
        Twist {
            linear: self.across + axis * self.insertion,
            angular: self.tilt + axis * self.spin,
        }
    }
}

/// Slows the whole twist until every speed is within its limit, then takes away what would
/// leave the workspace or the roll's travel.
fn keep_limits(decision: &mut Decision, view: &View<'_>) {
    let axis = view.base_axis();
    let limits = view.limits;
    let mut parts = Parts::of(&decision.twist, &axis);
    let speeds = [
        (
            parts.insertion.abs(),
            limits.insertion_speed_mm_s * 1e-3,
            Limit::InsertionSpeed,
        ),
        (
            parts.across.norm(),
            limits.lateral_speed_mm_s * 1e-3,
            Limit::LateralSpeed,
        ),
        (
            parts.tilt.norm(),
            limits.tilt_speed_deg_s.to_radians(),
            Limit::TiltSpeed,
        ),
        (
            parts.spin.abs(),
            limits.spin_speed_deg_s.to_radians(),
            Limit::SpinSpeed,
        ),
    ];
    let mut scale = 1.0_f64;
    for (speed, most, limit) in speeds {
        // Rounding at the limit itself is no violation.
        if speed > most * (1.0 + 1e-9) {
            scale = scale.min(most / speed);
            decision.report.limits.push(limit);
        }
    }
    parts = Parts::of(&decision.twist.scaled(scale), &axis);
    let part = inside_workspace(&parts.whole(&axis), view);
    if part < 1.0 {
        // A pivot about the entry moves a shifted base along the needle too. What stays of a
        // pivot that is taken away would draw the needle back for ever.
        let arm = view.world_from_base.translation.vector - view.entry.point.coords;
        let most = limits.insertion_speed_mm_s * 1e-3;
        let along = parts.tilt.cross(&arm).dot(&axis) * (1.0 - part);
        parts.insertion = (parts.insertion - along).clamp(-most, most);
        parts.across *= part;
        parts.tilt *= part;
        decision.report.limits.push(Limit::Workspace);
    }
    if view.dt > 0.0 && !view.roll_travel.allows(parts.spin * view.dt) {
        parts.spin = parts.spin.clamp(
            -view.roll_travel.negative.max(0.0) / view.dt,
            view.roll_travel.positive.max(0.0) / view.dt,
        );
        decision.report.limits.push(Limit::RemainingTurns);
    }
    decision.twist = parts.whole(&axis);
}

/// The part of tilt and lateral motion that lets the base come to rest at the workspace's bounds:
/// the outward speed falls with the room that is left, so an arm that lags does not run over
/// them, and many small steps do not creep over them.
fn inside_workspace(twist: &Twist, view: &View<'_>) -> f64 {
    let inward = view.entry.inward.into_inner();
    let axis = view.base_axis();
    let arm = view.world_from_base.translation.vector - view.entry.point.coords;
    let across = arm - inward * inward.dot(&arm);
    let tilt_room = view.limits.tilt_deg.to_radians() - axis.angle(&inward);
    let offset_room = view.limits.base_offset_mm * 1e-3 - across.norm();
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

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Point3, Translation3};

    use super::*;
    use crate::settings::{EstimatorSettings, Limits};
    use crate::view::{Entry, RollTravel, Target, Tip};
    use crate::{Estimator, Start};

    /// A base that is commanded outwards through an arm that follows 0.1 s late comes to rest at
    /// the bound, is not held back before, and may move inwards.
    #[test]
    fn the_base_stops_at_the_workspaces_bounds() {
        let entry = Entry {
            point: Point3::origin(),
            inward: Vector3::z_axis(),
        };
        let start = Isometry3::translation(0.0, 0.0, -0.12);
        let estimator = Estimator::new(
            &EstimatorSettings::default(),
            &Start {
                length: 0.126,
                bending_stiffness: 2e-2,
                cutting_edge: 1e-3,
                entry,
                world_from_base: start,
            },
        )
        .unwrap();
        let limits = Limits {
            tilt_deg: 5.0,
            ..Limits::default()
        };
        let dt = 1.0 / 30.0;
        let mut base = start;
        let mut on_its_way = [Twist::zero(); 3];
        let mut tilt = 0.0;
        let (mut farthest, mut fastest) = (0.0_f64, 0.0_f64);
        for step in 0..300 {
            let view = View {
                time: hal::Stamp::from_secs(f64::from(step) * dt),
                dt,
                tip: Tip {
                    world_from_tip: base * Translation3::new(0.0, 0.0, 0.126),
                    position_sigma: 1e-4,
                    direction_sigma: 1e-3,
                    age: 0.0,
                },
                target: Target {
                    position: Point3::new(0.0, 0.0, 0.08),
                    velocity: Vector3::zeros(),
                },
                entry,
                depth: 6e-3,
                world_from_base: base,
                springs: None,
                estimator: &estimator,
                roll_travel: RollTravel {
                    positive: 1.0,
                    negative: 1.0,
                },
                limits: &limits,
                insertion_speed: 1e-3,
            };
            let speed = limits.tilt_speed_deg_s.to_radians();
            let mut decision = Decision::hold();
            // To and fro at the bound, more out than in.
            let sense = if step > 150 && step % 3 == 0 {
                -0.5
            } else {
                1.0
            };
            decision.twist = view.pivot(&(Vector3::y() * speed * sense));
            keep_limits(&mut decision, &view);
            fastest = fastest.max(decision.twist.angular.norm() / speed);
            on_its_way.rotate_left(1);
            let now = std::mem::replace(&mut on_its_way[2], decision.twist);
            base = now.integrate(&base, dt);
            tilt = (base.rotation * Vector3::z()).angle(&Vector3::z());
            farthest = farthest.max(tilt);
        }
        let bound = limits.tilt_deg.to_radians();
        assert!(fastest > 0.99, "{fastest}");
        assert!(tilt > 0.9 * bound, "{} deg", tilt.to_degrees());
        assert!(farthest < bound + 1e-3, "{} deg", farthest.to_degrees());
    }
}
