//! What is watched while an arm is ours to command.

use std::time::Duration;

use hal::{ArmMode, FaultReason, Stamp};

use super::refused::{reported, second_controller, skew};
use super::reports::silent;
use super::{Core, Feedback};

/// Time that an arm may take to come to rest after it was enabled.
const BRAKING: Duration = Duration::from_millis(500);

impl Core {
    /// Faults of an arm that we command.
    pub(super) fn supervise(&mut self, now: Stamp, feedback: &Feedback) {
        if !matches!(
            self.mode,
            ArmMode::Enabled | ArmMode::Moving | ArmMode::Stopping
        ) {
            return;
        }
        if let Some((reason, words)) = self.trouble(now, feedback) {
            self.fault(reason, words);
        }
    }

    /// What is wrong with an arm that we command, with figures.
    fn trouble(&mut self, now: Stamp, feedback: &Feedback) -> Option<(FaultReason, String)> {
        let ms = |since: Stamp| now.since(since).as_millis();
        if let Some(why) = &self.cut_off {
            return Some((FaultReason::ConnectionLost, why.clone()));
        }
        if let Some(reason) = self.reports.hindrance {
            return Some((reason, reported(reason).to_owned()));
        }
        if let Some(silence) = self.reports.silence(now) {
            return Some((FaultReason::StaleFeedback, silent(silence)));
        }
        if let Some((topic, nodes)) = &self.others {
            let words = second_controller(topic, nodes);
            return Some((FaultReason::SecondController, words));
        }
        if now.since(feedback.arrived) > self.timing.feedback {
            return Some(match self.skew(now) {
                Some(behind) => (FaultReason::ClockSkew, skew("the feedback's", behind)),
                None => (
                    FaultReason::StaleFeedback,
                    format!("last feedback {} ms ago", ms(feedback.arrived)),
                ),
            });
        }
        if let Some(joint) = self.outside_limits() {
            let at = feedback.positions[joint];
            let words = format!("joint {} stands at {at:.4} rad", joint + 1);
            return Some((FaultReason::JointLimit, words));
        }
        if self.comes_to_rest(now) {
            self.tracking.restart(feedback.positions);
            self.rest.restart();
            return None;
        }
        let rates = self.guard.motion().rates;
        if let Some((joint, by)) = self.rest.moved(now, &feedback.positions, &rates) {
            let words = format!(
                "joint {} moved by {:.2} mrad while no motion was commanded",
                joint + 1,
                by * 1e3
            );
            return Some((FaultReason::UncommandedMotion, words));
        }
        if let Some((joint, off)) = self.tracking.lost(&feedback.positions) {
            let words = format!(
                "joint {} is {:.1} mrad from where its velocities lead",
                joint + 1,
                off * 1e3
            );
            return Some((FaultReason::TrackingError, words));
        }
        let command = self.command.filter(|command| {
            command.rates != self.zeros && now.since(command.arrived) > self.timing.command_fault
        })?;
        let words = format!("last command {} ms ago", ms(command.arrived));
        Some((FaultReason::StaleCommand, words))
    }

    /// Whether an arm that was just enabled may still be braking.
    fn comes_to_rest(&mut self, now: Stamp) -> bool {
        let braking = |since: Stamp| now.since(since) < BRAKING && self.command.is_none();
        if !self.taken_over.is_some_and(braking) {
            self.taken_over = None;
        }
        self.taken_over.is_some()
    }

    /// How far the feedback's stamps are behind \[s\], if that is why there is none.
    pub(super) fn skew(&self, now: Stamp) -> Option<f64> {
        self.skewed
            .filter(|(arrived, _)| now.since(*arrived) <= self.timing.feedback)
            .map(|(_, behind)| behind)
    }
}
