//! The state machine of an arm behind ROS topics: no I/O, no clock.

mod limits;
mod tracking;

use std::time::Duration;

use hal::guarded::{LimiterError, Motion};
use limits::keeps_limits;
use tracking::Tracking;

use hal::{
    ArmDescription, ArmMode, ArmState, ErrorKind, FaultReason, Guard, Joints, Limiter, RateCommand,
    Stamp,
};

/// Times after which something is stale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArmTiming {
    /// Age of a command at which the arm slows to rest.
    pub command_hold: Duration,
    /// Age of a command at which a moving arm faults.
    pub command_fault: Duration,
    /// Age on arrival at which a command is refused.
    pub command_late: Duration,
    /// Silence of the feedback at which an enabled arm faults.
    pub feedback: Duration,
    /// Longest time by which the arm may follow the commands: its own ramps may be slower.
    pub delay: Duration,
    /// Time in which a distance from where the arm should be is forgotten: an arm that executes
    /// velocities does not make up for what it lost in ramps.
    pub settling: Duration,
}

impl Default for ArmTiming {
    fn default() -> Self {
        Self {
            command_hold: Duration::from_millis(48),
            command_fault: Duration::from_millis(200),
            command_late: Duration::from_millis(100),
            feedback: Duration::from_millis(100),
            delay: Duration::from_millis(150),
            settling: Duration::from_secs(2),
        }
    }
}

/// Why an order was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// No feedback has come yet.
    #[error("no feedback has come yet")]
    NoFeedback,
    /// The feedback is too old.
    #[error("last feedback {age_ms} ms ago")]
    StaleFeedback {
        /// Its age \[ms\].
        age_ms: u128,
    },
    /// Not in this mode.
    #[error("not in mode {mode:?}")]
    Mode {
        /// The mode.
        mode: ArmMode,
    },
    /// A fault is latched.
    #[error("faulted: {reason:?}")]
    Faulted {
        /// The fault.
        reason: FaultReason,
    },
    /// The robot's controller says that it cannot move.
    #[error("the robot's controller reports {reason:?}; clear it there first")]
    Hindered {
        /// What it says.
        reason: FaultReason,
    },
    /// A value is not finite.
    #[error("a rate is not finite")]
    NonFinite,
    /// The wrong number of rates.
    #[error("{found} rates for {expected} joints")]
    Size {
        /// Rates in the command.
        found: usize,
        /// Joints of the arm.
        expected: usize,
    },
    /// The sequence number does not increase.
    #[error("command {sequence} after {last}")]
    Sequence {
        /// Number of the command.
        sequence: u64,
        /// Number of the last accepted command.
        last: u64,
    },
    /// The command is too old.
    #[error("command is {age_ms} ms old")]
    Late {
        /// Its age \[ms\].
        age_ms: u128,
    },
}

impl Refused {
    /// The kind of error that a caller acts on.
    pub const fn kind(&self) -> ErrorKind {
        match self {
            Self::NoFeedback => ErrorKind::Disconnected,
            Self::StaleFeedback { .. } => ErrorKind::Timeout,
            Self::Mode { .. } => ErrorKind::WrongMode,
            Self::Faulted { .. } | Self::Hindered { .. } => ErrorKind::Faulted,
            Self::NonFinite | Self::Size { .. } | Self::Sequence { .. } | Self::Late { .. } => {
                ErrorKind::Rejected
            }
        }
    }
}

/// Newest feedback.
#[derive(Clone, Copy, Debug)]
struct Feedback {
    arrived: Stamp,
    stamp: Stamp,
    positions: Joints,
    rates: Joints,
}

/// The accepted command.
#[derive(Clone, Copy, Debug)]
struct Accepted {
    arrived: Stamp,
    rates: Joints,
}

/// The arm as this side knows it.
pub(crate) struct Core {
    guard: Guard,
    timing: ArmTiming,
    tolerance: f64,
    period: f64,
    mode: ArmMode,
    feedback: Option<Feedback>,
    command: Option<Accepted>,
    last_sequence: Option<u64>,
    /// Why the robot's controller cannot move it, where it says so.
    hindrance: Option<FaultReason>,
    tracking: Tracking,
    zeros: Joints,
    closed: bool,
}

impl Core {
    pub(crate) fn new(
        description: &ArmDescription,
        timing: ArmTiming,
        tolerance: f64,
    ) -> Result<Self, LimiterError> {
        let joints = description.limits.len();
        let limiter = Limiter::new(&description.limits, 0.0, description.period)?;
        let zeros = Joints::zeros(joints).map_err(|_| LimiterError::Joints { joints })?;
        Ok(Self {
            guard: Guard::new(limiter),
            timing,
            tolerance,
            period: description.period.as_secs_f64(),
            mode: ArmMode::Disconnected,
            feedback: None,
            command: None,
            last_sequence: None,
            hindrance: None,
            tracking: Tracking::new(&timing, tolerance, description.period),
            zeros,
            closed: false,
        })
    }

    /// Takes in feedback that arrived at `now`; missing rates are differences.
    pub(crate) fn feedback(
        &mut self,
        now: Stamp,
        stamp: Stamp,
        positions: Joints,
        rates: Option<Joints>,
    ) {
        let rates = rates.unwrap_or_else(|| match &self.feedback {
            Some(last) if stamp > last.stamp => {
                let dt = stamp.secs_since(last.stamp);
                positions.zip(&last.positions, |new, old| (new - old) / dt)
            }
            _ => self.zeros,
        });
        self.feedback = Some(Feedback {
            arrived: now,
            stamp,
            positions,
            rates,
        });
        if self.mode == ArmMode::Disconnected {
            self.mode = ArmMode::Connected;
        }
    }

    /// Takes in what the robot's controller says of itself.
    pub(crate) fn robot(&mut self, hindrance: Option<FaultReason>) {
        self.hindrance = hindrance;
    }

    pub(crate) fn state(&self, now: Stamp) -> Result<ArmState, Refused> {
        let feedback = self.fresh(now)?;
        Ok(ArmState {
            stamp: feedback.stamp,
            positions: feedback.positions,
            rates: feedback.rates,
            mode: self.mode,
        })
    }

    pub(crate) fn enable(&mut self, now: Stamp) -> Result<(), Refused> {
        match self.mode {
            ArmMode::Connected => {}
            ArmMode::Faulted(reason) => return Err(Refused::Faulted { reason }),
            mode => return Err(Refused::Mode { mode }),
        }
        if let Some(reason) = self.hindrance {
            return Err(Refused::Hindered { reason });
        }
        let positions = self.fresh(now)?.positions;
        self.tracking.restart(positions);
        self.guard.assume(Motion::steady(self.zeros));
        self.command = None;
        self.mode = ArmMode::Enabled;
        Ok(())
    }

    pub(crate) fn command(&mut self, now: Stamp, command: &RateCommand) -> Result<(), Refused> {
        match self.mode {
            ArmMode::Enabled | ArmMode::Moving => {}
            ArmMode::Faulted(reason) => return Err(Refused::Faulted { reason }),
            mode => return Err(Refused::Mode { mode }),
        }
        if !command.rates.is_finite() {
            self.fault(FaultReason::NonFiniteCommand);
            return Err(Refused::NonFinite);
        }
        let (found, expected) = (command.rates.len(), self.zeros.len());
        if found != expected {
            return Err(Refused::Size { found, expected });
        }
        if let Some(last) = self.last_sequence
            && command.sequence <= last
        {
            return Err(Refused::Sequence {
                sequence: command.sequence,
                last,
            });
        }
        let age = now.since(command.stamp);
        if age > self.timing.command_late {
            return Err(Refused::Late {
                age_ms: age.as_millis(),
            });
        }
        self.last_sequence = Some(command.sequence);
        self.command = Some(Accepted {
            arrived: now,
            rates: command.rates,
        });
        self.mode = ArmMode::Moving;
        Ok(())
    }

    pub(crate) fn stop(&mut self) {
        self.command = None;
        if self.mode == ArmMode::Moving || self.mode == ArmMode::Enabled && !self.is_rest() {
            self.mode = ArmMode::Stopping;
        }
    }

    pub(crate) fn reset(&mut self, now: Stamp) -> Result<(), Refused> {
        if let ArmMode::Faulted(reason) = self.mode {
            if let Some(reason) = self.hindrance {
                return Err(Refused::Hindered { reason });
            }
            self.fresh(now)?;
            if !self.is_rest() || self.outside_limits() {
                return Err(Refused::Faulted { reason });
            }
            self.mode = ArmMode::Connected;
        }
        Ok(())
    }

    /// From now on only comes to rest.
    pub(crate) fn close(&mut self) {
        self.stop();
        self.closed = true;
    }

    pub(crate) const fn is_closed(&self) -> bool {
        self.closed
    }

    /// Whether what was sent last is rest.
    pub(crate) fn is_rest(&self) -> bool {
        self.guard.motion().is_rest()
    }

    /// One period: the rates to send, if the arm is ours to command.
    pub(crate) fn tick(&mut self, now: Stamp) -> Option<Joints> {
        let feedback = self.feedback?;
        self.supervise(now, &feedback);
        let wanted = self.wanted(now);
        let ours = matches!(
            self.mode,
            ArmMode::Enabled | ArmMode::Moving | ArmMode::Stopping
        );
        if !ours && self.is_rest() {
            return None;
        }
        // Where the arm is by now, if it goes on as it was told.
        let age = now.since(feedback.stamp).min(self.timing.feedback);
        let going = self.guard.motion().rates;
        let positions = feedback
            .positions
            .zip(&going, |q, rate| q + rate * age.as_secs_f64());
        let rates = self.let_through(&positions, &wanted);
        if self.is_rest() {
            let waits = self.command.is_some_and(|c| c.rates != self.zeros);
            if ours && !waits {
                self.mode = ArmMode::Enabled;
            }
        }
        self.tracking.advance(&feedback.positions, &rates);
        Some(rates)
    }

    /// What keeps every limit goes out unchanged, since another guard may stand before this one
    /// and shape the motion; anything else is limited.
    fn let_through(&mut self, positions: &Joints, wanted: &Joints) -> Joints {
        if keeps_limits(
            self.guard.limiter(),
            positions,
            self.guard.motion(),
            wanted,
            self.period,
        ) {
            let before = self.guard.motion().rates;
            let period = self.period;
            self.guard.assume(Motion {
                rates: *wanted,
                accelerations: wanted.zip(&before, |new, old| (new - old) / period),
            });
            return *wanted;
        }
        self.guard.step(positions, wanted, self.period).rates
    }

    /// Faults of an arm that we command.
    fn supervise(&mut self, now: Stamp, feedback: &Feedback) {
        if !matches!(
            self.mode,
            ArmMode::Enabled | ArmMode::Moving | ArmMode::Stopping
        ) {
            return;
        }
        if let Some(reason) = self.hindrance {
            return self.fault(reason);
        }
        if now.since(feedback.arrived) > self.timing.feedback {
            self.fault(FaultReason::StaleFeedback);
        } else if self.outside_limits() {
            self.fault(FaultReason::JointLimit);
        } else if self.tracking.is_lost(&feedback.positions) {
            self.fault(FaultReason::TrackingError);
        } else if let Some(command) = self.command
            && command.rates != self.zeros
            && now.since(command.arrived) > self.timing.command_fault
        {
            self.fault(FaultReason::StaleCommand);
        }
    }

    fn wanted(&self, now: Stamp) -> Joints {
        match (&self.command, self.mode) {
            (Some(command), ArmMode::Moving)
                if now.since(command.arrived) <= self.timing.command_hold =>
            {
                command.rates
            }
            _ => self.zeros,
        }
    }

    fn fault(&mut self, reason: FaultReason) {
        self.command = None;
        self.mode = ArmMode::Faulted(reason);
    }

    fn fresh(&self, now: Stamp) -> Result<&Feedback, Refused> {
        let feedback = self.feedback.as_ref().ok_or(Refused::NoFeedback)?;
        let age = now.since(feedback.arrived);
        if age > self.timing.feedback {
            return Err(Refused::StaleFeedback {
                age_ms: age.as_millis(),
            });
        }
        Ok(feedback)
    }

    /// Outside a joint's limits by more than the tolerance of tracking.
    fn outside_limits(&self) -> bool {
        let limits = self.guard.limiter().limits();
        self.feedback.is_some_and(|feedback| {
            feedback.positions.iter().zip(limits).any(|(q, limit)| {
                *q < limit.lower - self.tolerance || *q > limit.upper + self.tolerance
            })
        })
    }
}

impl std::fmt::Debug for Core {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Core")
            .field("mode", &self.mode)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests;
