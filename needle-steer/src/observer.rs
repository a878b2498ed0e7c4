//! Who watches a run.

use std::time::Duration;

use hal::telemetry::Telemetry;
use hal::{ArmState, RateCommand, SensedMarker, SensedShape, StereoFrame};
use vision::track::Tracked;

/// Takes note of a run while it goes on.
pub trait Observer {
    /// The arm where the controller starts from; called first.
    fn start(&mut self, arm: &ArmState) {
        let _ = arm;
    }

    /// A law step, with truth in simulation.
    fn step(&mut self, telemetry: &Telemetry);

    /// What the step read; called before [`Observer::step`].
    fn inputs(&mut self, arm: &ArmState, shape: Option<&SensedShape>) {
        let _ = (arm, shape);
    }

    /// The arm's newest feedback, every arm period.
    fn arm(&mut self, state: &ArmState) {
        let _ = state;
    }

    /// The pair that the step read, and what was tracked in it.
    fn images(&mut self, pair: &StereoFrame, tracked: &Tracked) {
        let _ = (pair, tracked);
    }

    /// How long the step of control took on the wall clock; no part of the run's own results.
    fn timed(&mut self, step: Duration) {
        let _ = step;
    }

    /// The marker that the step read; called after [`Observer::inputs`] where there was one.
    fn marker(&mut self, marker: &SensedMarker) {
        let _ = marker;
    }

    /// A command that went out.
    fn command(&mut self, command: &RateCommand) {
        let _ = command;
    }
}

/// Takes note of nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unobserved;

impl Observer for Unobserved {
    fn step(&mut self, _: &Telemetry) {}
}
