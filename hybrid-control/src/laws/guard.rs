//! What every law is wrapped in: finite numbers in and out, speeds and travel kept.

use hal::Twist;
use hal::telemetry::Limit;
use nalgebra::Vector3;

use crate::estimator::Estimator;
use crate::view::{Decision, Law, View};

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
    if leaves_workspace(&parts.whole(&axis), view) {
        // A pivot about the entry moves a shifted base along the needle too. What stays of a
        // pivot that is taken away would draw the needle back for ever.
        let arm = view.world_from_base.translation.vector - view.entry.point.coords;
        let most = limits.insertion_speed_mm_s * 1e-3;
        parts.insertion = (parts.insertion - parts.tilt.cross(&arm).dot(&axis)).clamp(-most, most);
        parts.across = Vector3::zeros();
        parts.tilt = Vector3::zeros();
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

/// Whether the next pose is outside tilt or offset and farther out than the present one.
fn leaves_workspace(twist: &Twist, view: &View<'_>) -> bool {
    let measure = |pose: &nalgebra::Isometry3<f64>| {
        let tilt = (pose.rotation * Vector3::z()).angle(&view.entry.inward);
        let out = pose.translation.vector - view.entry.point.coords;
        let across = (out - view.entry.inward.into_inner() * view.entry.inward.dot(&out)).norm();
        (tilt, across)
    };
    let (tilt, across) = measure(&view.world_from_base);
    let (next_tilt, next_across) =
        measure(&twist.integrate(&view.world_from_base, view.dt.max(1e-3)));
    (next_tilt > view.limits.tilt_deg.to_radians() && next_tilt > tilt)
        || (next_across > view.limits.base_offset_mm * 1e-3 && next_across > across)
}
