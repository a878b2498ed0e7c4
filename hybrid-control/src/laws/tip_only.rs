//! Tip-based control alone: sliding mode and duty cycling while inserting straight.

use crate::laws::bevel_steering::BevelSteering;
use crate::settings::PaperSettings;
use crate::tasks::target_velocity;
use crate::view::{Decision, Law, View, blank_report};

pub(super) struct TipOnly {
    steering: BevelSteering,
}

impl TipOnly {
    pub(super) fn new(settings: &PaperSettings) -> Self {
        Self {
            steering: BevelSteering::new(settings),
        }
    }
}

impl Law for TipOnly {
    fn name(&self) -> &'static str {
        "tip-only"
    }

    fn decide(&mut self, view: &View<'_>) -> Decision {
        let mut report = blank_report();
        let desired = target_velocity(&self.steering.heading(view), view.insertion_speed);
        let command = self.steering.step(view, &desired, &mut report);
        Decision {
            twist: view.screw(command.speed, command.spin),
            report,
        }
    }

    fn reset(&mut self) {
        self.steering.reset();
    }
}
