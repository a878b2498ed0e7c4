//! What every law is wrapped in: finite numbers in and out, speeds and travel kept.

use hal::Twist;
use hal::telemetry::Limit;
use nalgebra::Vector3;

use crate::estimator::Estimator;
use crate::view::{Decision, Law, View};
use crate::workspace::inside_workspace;

/// Travel with which the bevel can steer to all sides, alternating between its ends \[rad\]: 300 degrees.
const STEERABLE: f64 = 5.236;
/// Least reserve for tilting that a joint of so little travel keeps \[rad\]: 2 degrees.
const LEAST_RESERVE: f64 = 0.035;

struct Guarded(Box<dyn Law>);

/// `law` held to its contract: finite numbers in and out, speeds, workspace and travel kept.
pub fn guarded(law: Box<dyn Law>) -> Box<dyn Law> {
    Box::new(Guarded(law))
}

impl Law for Guarded {
    fn name(&self) -> &str {
        self.0.name()
    }

    fn decide(&mut self, view: &View<'_>) -> Decision {
        if !view.is_finite() {
            return Decision::hold();
        }
        // Tilting moves the last joint too: the law may not spend the whole travel on spin.
        let reserve = view.limits.roll_reserve_deg.to_radians();
        let view = &View {
            roll_travel: view
                .roll_travel
                .within_spare(reserve, LEAST_RESERVE, STEERABLE),
            ..*view
        };
        let mut decision = self.0.decide(view);
        if !decision.twist.is_finite() {
            return Decision::hold();
        }
        leave_out(&mut decision.twist, view);
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

/// Leaves out what the device cannot do: insertion, spin and the base's motion, each as a whole.
fn leave_out(twist: &mut Twist, view: &View<'_>) {
    if view.freedom.is_full() || view.freedom.gives(twist) {
        return;
    }
    let axis = view.base_axis();
    let parts = Parts::of(twist, &axis);
    let screws = [
        view.screw(parts.insertion, 0.0),
        view.screw(0.0, parts.spin),
    ];
    let base = Twist {
        linear: parts.across,
        angular: parts.tilt,
    };
    *twist = Twist::zero();
    for part in screws.into_iter().chain([base]) {
        if view.freedom.gives(&part) {
            twist.linear += part.linear;
            twist.angular += part.angular;
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
    let part = inside_workspace(
        &parts.whole(&axis),
        &view.world_from_base,
        &view.entry,
        limits,
    );
    if part < 1.0 {
        // A pivot about the entry moves a shifted base along the needle too. What stays of a
        // pivot that is taken away would draw the needle back for ever.
        let arm = view.world_from_base.translation.vector - view.entry.point.coords;
        let most = limits.insertion_speed_mm_s * 1e-3;
        let along = parts.tilt.cross(&arm).dot(&axis) * (1.0 - part);
        parts.insertion = (parts.insertion - along).clamp(-most, most);
        parts.across *= part;
        parts.tilt *= part;
        // A tilted base goes sideways when it is pushed or drawn, too.
        let rest = inside_workspace(
            &parts.whole(&axis),
            &view.world_from_base,
            &view.entry,
            limits,
        );
        parts.insertion *= rest;
        parts.across *= rest;
        parts.tilt *= rest;
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

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Point3, Translation3};

    use super::*;
    use crate::settings::{EstimatorSettings, Limits};
    use crate::view::{Entry, RollTravel, Target, Tip};
    use crate::{Estimator, Start};

    const DT: f64 = 1.0 / 30.0;

    /// Poses of a base through an arm that follows 0.1 s late, and the fastest tilt that it was
    /// sent, relative to the limit.
    fn driven(
        limits: &Limits,
        start: Isometry3<f64>,
        steps: u32,
        command: impl Fn(u32, &View<'_>) -> Twist,
    ) -> (Vec<Isometry3<f64>>, f64) {
        let entry = Entry {
            point: Point3::origin(),
            inward: Vector3::z_axis(),
        };
        let estimator = Estimator::new(
            &EstimatorSettings::default(),
            &Start {
                length: 0.126,
                bending_stiffness: 2e-2,
                cutting_edge: 1e-3,
                guide_gap: None,
                tip_sensor: None,
                advance_by_tip: false,
                entry,
                world_from_base: start,
            },
        )
        .unwrap();
        let mut base = start;
        let mut on_its_way = [Twist::zero(); 3];
        let (mut poses, mut fastest) = (Vec::new(), 0.0_f64);
        for step in 0..steps {
            let view = View {
                time: hal::Stamp::from_secs(f64::from(step) * DT),
                dt: DT,
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
                shape: &[],
                estimator: &estimator,
                roll_travel: RollTravel {
                    positive: 1.0,
                    negative: 1.0,
                },
                freedom: crate::Freedom::full(),
                limits,
                insertion_speed: 1e-3,
            };
            let mut decision = Decision::hold();
            decision.twist = command(step, &view);
            keep_limits(&mut decision, &view);
            let speed = limits.tilt_speed_deg_s.to_radians();
            fastest = fastest.max(decision.twist.angular.norm() / speed);
            on_its_way.rotate_left(1);
            let now = std::mem::replace(&mut on_its_way[2], decision.twist);
            base = now.integrate(&base, DT);
            poses.push(base);
        }
        (poses, fastest)
    }

    /// It comes to rest at the bound, is not held back before, and may move inwards.
    #[test]
    fn a_base_that_is_tilted_stops_at_the_bound() {
        let limits = Limits {
            tilt_deg: 5.0,
            ..Limits::default()
        };
        let speed = limits.tilt_speed_deg_s.to_radians();
        let start = Isometry3::translation(0.0, 0.0, -0.12);
        let (poses, fastest) = driven(&limits, start, 300, |step, view| {
            // To and fro at the bound, more out than in.
            let sense = if step > 150 && step % 3 == 0 {
                -0.5
            } else {
                1.0
            };
            view.pivot(&(Vector3::y() * speed * sense))
        });
        let tilt = |base: &Isometry3<f64>| (base.rotation * Vector3::z()).angle(&Vector3::z());
        let bound = limits.tilt_deg.to_radians();
        assert!(fastest > 0.99, "{fastest}");
        let last = tilt(poses.last().unwrap());
        assert!(last > 0.9 * bound, "{} deg", last.to_degrees());
        let farthest = poses.iter().map(tilt).fold(0.0, f64::max);
        assert!(farthest < bound + 1e-3, "{} deg", farthest.to_degrees());
    }

    /// Drawing a tilted needle back moves its base sideways.
    #[test]
    fn a_base_that_is_drawn_back_askew_stops_at_the_bound() {
        let limits = Limits::default();
        let turned = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -0.3);
        let start = Isometry3::from_parts(Translation3::new(0.03, 0.0, -0.12), turned);
        let (poses, _) = driven(&limits, start, 3000, |_, view| Twist {
            linear: view.base_axis() * (-1e-3 * limits.insertion_speed_mm_s),
            angular: Vector3::zeros(),
        });
        let across = |base: &Isometry3<f64>| base.translation.vector.xy().norm() * 1e3;
        let farthest = poses.iter().map(across).fold(0.0, f64::max);
        let bound = limits.base_offset_mm;
        assert!(farthest > bound - 0.5, "{farthest} mm");
        assert!(farthest < bound + 0.1, "{farthest} mm");
    }
}
