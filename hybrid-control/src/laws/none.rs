//! No control: straight insertion along the needle's axis at its base.

use hal::telemetry::SteeringMode;

use crate::tasks::target_velocity;
use crate::view::{Decision, Law, View, blank_report};

pub(super) struct Straight;

impl Law for Straight {
    fn name(&self) -> &'static str {
        "none"
    }

    fn decide(&mut self, view: &View<'_>) -> Decision {
        let desired = target_velocity(
            &view.tip.locate(&view.target.position),
            view.insertion_speed,
        );
        let mut report = blank_report();
        report.mode = SteeringMode::Straight;
        report.heading_error = crate::duty_cycle::heading_angle(&desired);
        report.bevel_error = crate::tasks::wrap(crate::tasks::bevel_angle(&desired));
        Decision {
            twist: view.screw(view.insertion_speed, 0.0),
            report,
        }
    }

    fn reset(&mut self) {}
}
