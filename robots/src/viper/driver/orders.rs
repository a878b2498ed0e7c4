//! What the caller orders, and the points that follow from it.

use std::time::Duration;

use hal::{ArmState, Joints, RateCommand, Stamp};

use super::core::{Core, Mode};
use super::fault::{Fault, Refused, Unfit};
use super::watch::status_fault;
use crate::viper::config::Dialect;
use crate::viper::trapezoid::fastest;

impl Core {
    /// Newest feedback.
    ///
    /// # Errors
    /// No link, or feedback too old.
    pub fn state(&mut self, now: Stamp) -> Result<ArmState, Refused> {
        let now = self.at(now);
        let sample = match &self.tracker.sample {
            Some(sample) if self.link.is_up() => *sample,
            _ => return Err(Refused::NoLink(self.link.last_error.clone())),
        };
        let age = self.feedback_age(now);
        if age > self.config.timing.feedback {
            return Err(Refused::StaleFeedback {
                age_s: age.as_secs_f64(),
            });
        }
        Ok(ArmState {
            stamp: sample.stamp,
            positions: sample.positions,
            rates: sample.rates,
            mode: self.mode(),
        })
    }

    /// Allows motion.
    ///
    /// # Errors
    /// The mode, the controller's state or the arm does not allow it.
    pub fn enable(&mut self, now: Stamp) -> Result<(), Refused> {
        let now = self.at(now);
        match &self.mode {
            Mode::Connected => {}
            Mode::Faulted(fault) => return Err(Refused::Faulted(fault.clone())),
            Mode::Disconnected => return Err(Refused::NoLink(self.link.last_error.clone())),
            _ => return Err(Refused::Mode(self.mode())),
        }
        self.is_ready(now)?;
        let state = self.state(now)?;
        let (bend, least_rad) = (state.positions[4], self.config.tolerances.wrist_bend);
        if bend.abs() < least_rad {
            return Err(Refused::Singular {
                position_rad: bend,
                least_rad,
            });
        }
        self.settle_at(state.positions);
        self.command = None;
        self.last_sequence = None;
        self.mode = Mode::Enabled;
        Ok(())
    }

    /// Checks that nothing speaks against motion.
    fn is_ready(&mut self, now: Stamp) -> Result<(), Refused> {
        let state = self.state(now)?;
        if let Some(unfit) = self.unfit {
            return Err(unfit.into());
        }
        let Some(status) = self.tracker.status else {
            return Err(Refused::NoLink(self.link.last_error.clone()));
        };
        if let Some(fault) = status_fault(&status) {
            return Err(Refused::NotReady(fault));
        }
        if status.in_motion != 0 {
            let fault = Fault::Uncommanded {
                joint: 0,
                error_rad: state.rates.max_abs(),
            };
            return Err(Refused::NotReady(fault));
        }
        if let Some((joint, position_rad)) = self.outside_limits() {
            return Err(Unfit::Position {
                joint,
                position_rad,
            }
            .into());
        }
        let limit = self.config.timing.acknowledgement;
        match self.session.unanswered(now) {
            Some((sequence, age)) if age > limit => {
                let age_s = age.as_secs_f64();
                Err(Refused::NotReady(Fault::StaleAcknowledgement {
                    sequence,
                    age_s,
                }))
            }
            _ => Ok(()),
        }
    }

    /// Takes rates to execute until the next command.
    ///
    /// # Errors
    /// The mode or the command does not allow it; a command that is not finite also faults.
    pub fn command(&mut self, now: Stamp, command: &RateCommand) -> Result<(), Refused> {
        let now = self.at(now);
        let outcome = self.check_command(now, command);
        if let Err(refused) = &outcome {
            self.metrics.counts.refused_commands += 1;
            if *refused == Refused::NonFinite {
                self.latch(now, Fault::NonFinite);
            }
            return outcome;
        }
        self.last_sequence = Some((command.sequence, command.stamp));
        self.command = Some(*command);
        if command.rates.max_abs() > 0.0 {
            self.mode = Mode::Moving;
        }
        Ok(())
    }

    fn check_command(&self, now: Stamp, command: &RateCommand) -> Result<(), Refused> {
        match &self.mode {
            Mode::Enabled | Mode::Moving => {}
            Mode::Faulted(fault) => return Err(Refused::Faulted(fault.clone())),
            _ => return Err(Refused::Mode(self.mode())),
        }
        let (expected, found) = (self.config.limits.len(), command.rates.len());
        if expected != found {
            return Err(Refused::Joints { expected, found });
        }
        if !command.rates.is_finite() {
            return Err(Refused::NonFinite);
        }
        if let Some((last, stamp)) = self.last_sequence {
            if command.sequence <= last {
                return Err(Refused::Sequence {
                    last,
                    found: command.sequence,
                });
            }
            if command.stamp < stamp {
                return Err(Refused::Late {
                    age_s: now.secs_since(command.stamp),
                });
            }
        }
        if now.since(command.stamp) > self.config.timing.command_hold {
            return Err(Refused::Late {
                age_s: now.secs_since(command.stamp),
            });
        }
        if command.stamp > now + self.config.timing.command_hold {
            return Err(Refused::Future {
                ahead_s: command.stamp.secs_since(now),
            });
        }
        Ok(())
    }

    /// Brings the arm to rest, in every mode.
    ///
    /// # Errors
    /// There is no link to a controller that had been moving; the next link begins with a stop.
    pub fn stop(&mut self, now: Stamp) -> Result<(), Refused> {
        let now = self.at(now);
        self.halt(now);
        if self.mode == Mode::Moving {
            self.mode = Mode::Stopping { since: now };
        }
        match &self.mode {
            Mode::Faulted(_) if !self.link.is_up() => {
                Err(Refused::NoLink(self.link.last_error.clone()))
            }
            _ => Ok(()),
        }
    }

    /// Clears a latched fault.
    ///
    /// # Errors
    /// Its cause is still there.
    pub fn reset(&mut self, now: Stamp) -> Result<(), Refused> {
        let now = self.at(now);
        let Mode::Faulted(fault) = self.mode.clone() else {
            return Ok(());
        };
        match self.is_ready(now) {
            Err(Refused::NotReady(cause)) => return Err(Refused::CauseRemains(cause)),
            Err(Refused::NoLink(error)) if matches!(fault, Fault::Protocol(_)) => {
                return Err(Refused::CauseRemains(Fault::ConnectionLost(error)));
            }
            outcome => outcome?,
        }
        self.mode = Mode::Connected;
        Ok(())
    }

    /// The points of one period.
    pub(super) fn move_on(&mut self, now: Stamp) {
        let mode = self.mode.clone();
        match mode {
            Mode::Enabled | Mode::Moving => {}
            _ => return,
        }
        let Some(command) = self.command else { return };
        let Some(wanted) = self.wanted_rates(now, &command) else {
            return;
        };
        let at_rest = self.guard.motion().is_rest();
        if at_rest && wanted.max_abs() == 0.0 {
            self.rest(now, &command);
            return;
        }
        // Answers do not tell when the 2018 program has finished a segment: its time is computed.
        let queued = self
            .course
            .as_mut()
            .map_or(0, |course| course.unfinished(now));
        if !self.session.is_clear() || queued > 1 {
            // Nothing accumulates meanwhile.
            self.metrics.counts.held_back += 1;
            return;
        }
        let (Some(course), Some(sample)) = (&mut self.course, &self.tracker.sample) else {
            return;
        };
        if !self.session.armed {
            course.restart();
            if course.deviation(sample, Duration::ZERO).1 > self.config.tolerances.start {
                return self.latch(now, Fault::StartMismatch);
            }
        }
        if self.session.start(now, &course.set_point) {
            self.send_segment(now, &wanted);
        }
    }

    /// The rates of a command, zero when it is old; `None` after a fault.
    fn wanted_rates(&mut self, now: Stamp, command: &RateCommand) -> Option<Joints> {
        let timing = self.config.timing;
        let mut wanted = command.rates;
        if wanted.max_abs() == 0.0 {
            return Some(wanted);
        }
        let age = now.since(command.stamp);
        if age > timing.command_fault {
            self.latch(
                now,
                Fault::StaleCommand {
                    age_s: age.as_secs_f64(),
                },
            );
            return None;
        }
        if age > timing.command_hold {
            wanted = wanted.zeroed();
        }
        Some(wanted)
    }

    /// At rest: holds, and disarms the controller when nobody renews even the zero command.
    fn rest(&mut self, now: Stamp, command: &RateCommand) {
        if command.rates.max_abs() > 0.0 {
            // Ramped down because the command is old; it may still be renewed.
            self.hold_still(now);
            return;
        }
        self.mode = Mode::Enabled;
        if now.since(command.stamp) <= self.config.timing.command_hold {
            self.hold_still(now);
        } else if self.session.armed && self.session.is_clear() {
            self.session.stop(now);
        }
    }

    /// Repeats the set point, where the controller's watchdog wants to be fed.
    fn hold_still(&mut self, now: Stamp) {
        let feed = self.config.dialect == Dialect::Steer;
        if feed && self.session.armed && self.session.is_clear() {
            let rest = self.guard.motion().rates.zeroed();
            self.send_segment(now, &rest);
        }
    }

    /// The first segment, as soon as the start point is accepted.
    pub(super) fn follow_start(&mut self, now: Stamp) {
        let waits = self.session.armed
            && self.session.is_clear()
            && self.course.as_ref().is_some_and(|course| course.fresh);
        if waits && matches!(self.mode, Mode::Enabled | Mode::Moving) && self.link.is_up() {
            self.move_on(now);
        }
    }

    fn send_segment(&mut self, now: Stamp, wanted: &Joints) {
        let Some(course) = &mut self.course else {
            return;
        };
        let step = course.step(now, self.config.period);
        let limited = self
            .guard
            .step(&course.set_point, wanted, step.as_secs_f64());
        self.acted = limited.limits;
        let from = course.set_point;
        let segment = course.advance(now, step, &limited.rates);
        if self.config.dialect == Dialect::Adept2018 {
            let by = segment.to.zip(&from, |to, from| to - from);
            course.will_take(now, fastest(&by, &self.config.limits).0);
        }
        self.session.point(now, &segment);
    }
}
