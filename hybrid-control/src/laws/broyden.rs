//! Data-driven baseline: the base moves across by a numeric Jacobian that Broyden's rule
//! corrects on the way; no model, no bevel control.

use hal::Twist;
use hal::telemetry::SteeringMode;
use nalgebra::{Matrix2, Vector2};

use crate::settings::BroydenSettings;
use crate::tasks::target_velocity;
use crate::view::{Decision, Law, View, blank_report};

pub(super) struct Broyden {
    settings: BroydenSettings,
    /// Change of the target's lateral place in the tip frame per base displacement \[m/m\].
    jacobian: Matrix2<f64>,
    /// Miss and base displacement at the last correction.
    anchor: Option<(Vector2<f64>, Vector2<f64>)>,
    moved: Vector2<f64>,
}

impl Broyden {
    pub(super) fn new(settings: &BroydenSettings) -> Self {
        Self {
            settings: settings.clone(),
            // A rigid needle through the entry: the base goes one way, the aim the other.
            jacobian: Matrix2::identity(),
            anchor: None,
            moved: Vector2::zeros(),
        }
    }
}

impl Law for Broyden {
    fn name(&self) -> &'static str {
        "broyden"
    }

    fn decide(&mut self, view: &View<'_>) -> Decision {
        let s = &self.settings;
        let seen = view.tip.locate(&view.target.position);
        let desired = target_velocity(&seen, view.insertion_speed);
        let frame = view.estimator.world_from_insertion();
        let away = frame.inverse_transform_vector(
            &(view.tip.world_from_tip.rotation * nalgebra::Vector3::new(seen.x, seen.y, 0.0)),
        );
        let miss = away.xy();
        let (old_miss, old_moved) = *self.anchor.get_or_insert((miss, self.moved));
        let du = self.moved - old_moved;
        if du.norm() > s.update_step_mm * 1e-3 {
            let surprise = (miss - old_miss) - self.jacobian * du;
            self.jacobian += surprise * du.transpose() * (s.update_gain / du.norm_squared());
            self.anchor = Some((miss, self.moved));
        }
        // Damped: the Jacobian passes zero during every insertion.
        let j = self.jacobian;
        let damping = Matrix2::identity() * 0.01;
        let inverse = (j * j.transpose() + damping)
            .try_inverse()
            .unwrap_or_default();
        let speed = (-(j.transpose() * inverse * miss) * s.gain_per_s)
            .cap_magnitude(0.25 * view.limits.lateral_speed_mm_s * 1e-3);
        self.moved += speed * view.dt;
        // A displacement of the base as a pivot about the entry, so that the entry is spared.
        let height = -frame
            .inverse_transform_point(&view.world_from_base.translation.vector.into())
            .z;
        let slope = -speed / height.max(0.02);
        let pivot = view.pivot(&view.estimator.pivot_rotation(&slope));
        let screw = view.screw(view.insertion_speed, 0.0);
        let mut report = blank_report();
        report.mode = SteeringMode::Manipulation;
        report.heading_error = crate::duty_cycle::heading_angle(&desired);
        Decision {
            twist: Twist {
                linear: pivot.linear + screw.linear,
                angular: pivot.angular + screw.angular,
            },
            report,
        }
    }

    fn reset(&mut self) {
        *self = Self::new(&self.settings);
    }
}
