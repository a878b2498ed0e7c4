//! What the driver watches for, and what it does then: fault, stop, disarm.

use std::time::Duration;

use hal::Stamp;

use super::core::{Core, Mode};
use super::fault::{Fault, LinkError};
use crate::viper::wire::steer::Refusal;
use crate::viper::wire::{Mode as OperatingMode, Status, TriState};

/// A joint this far outside its limits is no longer a rounding of the wire \[rad\].
const LIMIT_ROUNDING: f64 = 1e-3;

impl Core {
    /// Latches a fault, unless there is one, and stops.
    pub(super) fn latch(&mut self, now: Stamp, fault: Fault) {
        if !matches!(self.mode, Mode::Faulted(_)) {
            self.metrics.counts.faults += 1;
            self.mode = Mode::Faulted(fault);
        }
        self.halt(now);
    }

    /// Forgets the command and orders the controller to stop.
    pub(super) fn halt(&mut self, now: Stamp) {
        self.command = None;
        self.acted.clear();
        if self.link.is_up() {
            self.session.stop(now);
        }
    }

    pub(super) const fn is_active(&self) -> bool {
        matches!(
            self.mode,
            Mode::Enabled | Mode::Moving | Mode::Stopping { .. }
        )
    }

    /// The watchdogs of one tick.
    pub(super) fn watch(&mut self, now: Stamp) {
        let timing = self.config.timing;
        let age = self.feedback_age(now);
        if age > timing.feedback && self.is_active() {
            self.latch(
                now,
                Fault::StaleFeedback {
                    age_s: age.as_secs_f64(),
                },
            );
        }
        if let Some((sequence, waited)) = self.session.unanswered(now) {
            if waited > timing.acknowledgement && self.is_active() {
                self.metrics.unanswered();
                let age_s = waited.as_secs_f64();
                self.latch(now, Fault::StaleAcknowledgement { sequence, age_s });
            }
            if waited > timing.acknowledgement + timing.silence {
                return self.drop_link(now, LinkError::Silent);
            }
        }
        if age > timing.feedback.max(timing.silence) {
            return self.drop_link(now, LinkError::Silent);
        }
        if let Mode::Stopping { since } = self.mode {
            let waited = now.since(since);
            if waited > timing.stop {
                self.latch(
                    now,
                    Fault::NotStopping {
                        age_s: waited.as_secs_f64(),
                    },
                );
            } else if let Some(sample) = self.tracker.sample.filter(|_| self.has_stopped(since)) {
                self.settle_at(sample.positions);
                self.mode = Mode::Enabled;
            }
        }
    }

    pub(super) fn feedback_age(&self, now: Stamp) -> Duration {
        self.tracker
            .sample
            .map_or(Duration::MAX, |sample| now.since(sample.stamp))
    }

    fn has_stopped(&self, since: Stamp) -> bool {
        let read_since = self
            .tracker
            .sample
            .is_some_and(|sample| sample.stamp > since)
            && self.tracker.status_at > since;
        let at_rest = self
            .tracker
            .status
            .is_some_and(|status| status.in_motion == 0);
        read_since && at_rest && !self.session.is_stopping()
    }

    pub(super) fn check_status(&mut self, now: Stamp) {
        let Some(fault) = self.tracker.status.as_ref().and_then(status_fault) else {
            return;
        };
        if self.is_active() {
            self.latch(now, fault);
        } else if let Mode::Faulted(
            Fault::Refused {
                refusal: Some(Refusal::State),
                ..
            }
            | Fault::Disarmed(Some(Refusal::State)),
        ) = self.mode
        {
            // The refusal overtook the feedback that tells why.
            self.mode = Mode::Faulted(fault);
        }
    }

    pub(super) fn refused(&mut self, now: Stamp, sequence: i32, refusal: Option<Refusal>) {
        let fault = match refusal {
            Some(Refusal::StartMismatch) => Fault::StartMismatch,
            refusal => Fault::Refused { sequence, refusal },
        };
        self.latch(now, fault);
    }

    /// Checks a new reading against limits and set points.
    pub(super) fn check_sample(&mut self, now: Stamp) {
        if !self.is_active() {
            return;
        }
        if let Some((joint, position_rad)) = self.outside_limits() {
            return self.latch(
                now,
                Fault::JointLimit {
                    joint,
                    position_rad,
                },
            );
        }
        let lag = self.lag();
        let tolerances = self.config.tolerances;
        let (Some(sample), Some(course)) = (&self.tracker.sample, &mut self.course) else {
            return;
        };
        let (joint, error_rad) = course.deviation(sample, lag);
        let follows = course.strike(error_rad > tolerances.tracking, tolerances.tracking_samples);
        if follows {
            self.latch(now, Fault::Tracking { joint, error_rad });
        } else if self.mode == Mode::Enabled && error_rad > tolerances.rest {
            self.latch(now, Fault::Uncommanded { joint, error_rad });
        }
    }

    /// A joint beyond its limits, if any.
    pub(super) fn outside_limits(&self) -> Option<(usize, f64)> {
        let sample = self.tracker.sample?;
        let limits = self
            .config
            .limits
            .iter()
            .zip(sample.positions.iter())
            .enumerate();
        let mut outside = limits.filter(|(_, (limit, q))| {
            !(limit.lower - LIMIT_ROUNDING..=limit.upper + LIMIT_ROUNDING).contains(*q)
        });
        outside.next().map(|(joint, (_, q))| (joint, *q))
    }
}

/// What in a status forbids motion; all that is not clearly well does.
pub(super) fn status_fault(status: &Status) -> Option<Fault> {
    if TriState::from(status.e_stopped) != TriState::False {
        Some(Fault::EmergencyStop)
    } else if TriState::from(status.drives_powered) != TriState::True {
        Some(Fault::DrivesOff)
    } else if status.operating_mode() != OperatingMode::Automatic {
        Some(Fault::NotAutomatic { mode: status.mode })
    } else if TriState::from(status.in_error) != TriState::False {
        Some(Fault::ControllerError {
            code: status.error_code,
        })
    } else {
        None
    }
}
