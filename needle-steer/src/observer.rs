//! Who watches a run.

use std::time::Duration;

use hal::telemetry::Telemetry;
use hal::{ArmState, RateCommand, SensedMarker, SensedShape, StereoFrame};
use vision::track::Tracked;

use crate::hand::Prompt;

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

    /// What is asked of the hand that pushes the needle from now on.
    fn prompt(&mut self, prompt: Prompt) {
        let _ = prompt;
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

/// Two observers of one run.
pub struct Both<'a>(pub &'a mut dyn Observer, pub &'a mut dyn Observer);

impl core::fmt::Debug for Both<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Both")
    }
}

impl Observer for Both<'_> {
    fn start(&mut self, arm: &ArmState) {
        self.0.start(arm);
        self.1.start(arm);
    }

    fn prompt(&mut self, prompt: Prompt) {
        self.0.prompt(prompt);
        self.1.prompt(prompt);
    }

    fn step(&mut self, telemetry: &Telemetry) {
        self.0.step(telemetry);
        self.1.step(telemetry);
    }

    fn inputs(&mut self, arm: &ArmState, shape: Option<&SensedShape>) {
        self.0.inputs(arm, shape);
        self.1.inputs(arm, shape);
    }

    fn arm(&mut self, state: &ArmState) {
        self.0.arm(state);
        self.1.arm(state);
    }

    fn images(&mut self, pair: &StereoFrame, tracked: &Tracked) {
        self.0.images(pair, tracked);
        self.1.images(pair, tracked);
    }

    fn timed(&mut self, step: Duration) {
        self.0.timed(step);
        self.1.timed(step);
    }

    fn marker(&mut self, marker: &SensedMarker) {
        self.0.marker(marker);
        self.1.marker(marker);
    }

    fn command(&mut self, command: &RateCommand) {
        self.0.command(command);
        self.1.command(command);
    }
}
