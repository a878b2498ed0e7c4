//! Base manipulation alone: the paper's first task by pivoting, without bevel orientation.

use hal::Twist;
use hal::telemetry::SteeringMode;

use crate::laws::paper::{beside, insertion_part, pivot_rate};
use crate::settings::PaperSettings;
use crate::tasks::target_velocity;
use crate::view::{Decision, Law, View, blank_report};

pub(super) struct BaseOnly {
    settings: PaperSettings,
}

impl BaseOnly {
    pub(super) fn new(settings: &PaperSettings) -> Self {
        Self {
            settings: settings.clone(),
        }
    }
}

impl Law for BaseOnly {
    fn name(&self) -> &'static str {
        "base-only"
    }

    fn decide(&mut self, view: &View<'_>) -> Decision {
        let Some(springs) = &view.springs else {
            return Decision::hold();
        };
        let mut report = blank_report();
        report.mode = SteeringMode::Manipulation;
        let desired = target_velocity(
            &view.tip.locate(&view.target.position),
            view.insertion_speed,
        );
        report.heading_error = crate::duty_cycle::heading_angle(&desired);
        report.base_authority = view.estimator.pivot_authority();
        report.shortfall = beside(view);
        let omega = pivot_rate(view, springs, &desired, &self.settings);
        let (pivot, screw) = (
            view.pivot(&omega),
            view.screw(insertion_part(&desired), 0.0),
        );
        Decision {
            twist: Twist {
                linear: pivot.linear + screw.linear,
                angular: pivot.angular + screw.angular,
            },
            report,
        }
    }

    fn reset(&mut self) {}
}
