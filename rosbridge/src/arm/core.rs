//! The state machine of an arm behind ROS topics: no I/O, no clock.

mod limits;
mod refused;
mod reports;
mod rest;
mod tracking;
mod watch;

use std::time::Duration;

use hal::guarded::{LimiterError, Motion};
use limits::keeps_limits;
pub use refused::Refused;
pub(crate) use refused::skew;
use reports::Reports;
use rest::Rest;
use tracking::Tracking;

use hal::{
    ArmDescription, ArmMode, ArmState, FaultReason, Guard, Joints, Limiter, RateCommand, Stamp,
};

/// How far the stamp of a reading may be ahead of its arrival.
const AHEAD: Duration = Duration::from_millis(50);

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

/// Which deviations to accept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmTolerances {
    /// Largest distance between commanded and measured positions \[rad\].
    pub tracking: f64,
    /// How far a joint may move while no motion is commanded \[rad\]: 3 mrad are 2 mm at the
    /// needle of an arm of the Viper's size.
    pub rest: f64,
}

impl Default for ArmTolerances {
    fn default() -> Self {
        Self {
            tracking: 0.02,
            rest: 3e-3,
        }
    }
}

/// One message of feedback.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reading {
    /// Its stamp on the clock of the run.
    pub(crate) stamp: Stamp,
    /// How far the stamp is behind its arrival \[s\]; negative: ahead.
    pub(crate) behind: f64,
    pub(crate) positions: Joints,
    /// Missing ones are differences.
    pub(crate) rates: Option<Joints>,
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
    /// What the latched fault was, with figures.
    words: String,
    feedback: Option<Feedback>,
    /// When feedback last came with stamps that do not fit, and how far they are behind \[s\].
    skewed: Option<(Stamp, f64)>,
    command: Option<Accepted>,
    last_sequence: Option<u64>,
    /// What the robot's controller says.
    reports: Reports,
    /// Others that command the same arm, and where.
    others: Option<(String, Vec<String>)>,
    /// Why the node can no longer command it.
    cut_off: Option<String>,
    tracking: Tracking,
    rest: Rest,
    /// When the arm was enabled, until it rests or is commanded: it may still move by the last
    /// command of a program that is gone.
    taken_over: Option<Stamp>,
    zeros: Joints,
    closed: bool,
}

impl Core {
    pub(crate) fn new(
        description: &ArmDescription,
        timing: ArmTiming,
        tolerances: ArmTolerances,
    ) -> Result<Self, LimiterError> {
        let joints = description.limits.len();
        let limiter = Limiter::new(&description.limits, 0.0, description.period)?;
        let zeros = Joints::zeros(joints).map_err(|_| LimiterError::Joints { joints })?;
        Ok(Self {
            guard: Guard::new(limiter),
            timing,
            tolerance: tolerances.tracking,
            period: description.period.as_secs_f64(),
            mode: ArmMode::Disconnected,
            words: String::new(),
            feedback: None,
            skewed: None,
            command: None,
            last_sequence: None,
            reports: Reports::default(),
            others: None,
            cut_off: None,
            tracking: Tracking::new(&timing, tolerances.tracking, description.period),
            rest: Rest::new(tolerances.rest),
            taken_over: None,
            zeros,
            closed: false,
        })
    }

    /// Takes in feedback that arrived at `now`. A repeated reading says nothing new, and one
    /// whose stamp does not fit the clock of the run is no evidence.
    pub(crate) fn feedback(&mut self, now: Stamp, reading: Reading) {
        let Reading {
            stamp,
            behind,
            positions,
            rates,
        } = reading;
        let last = self.feedback;
        if last.is_some_and(|last| stamp == last.stamp) {
            return;
        }
        if !(-AHEAD.as_secs_f64()..=self.timing.feedback.as_secs_f64()).contains(&behind) {
            self.skewed = Some((now, behind));
            return;
        }
        if last.is_some_and(|last| stamp < last.stamp) {
            return;
        }
        let rates = rates.unwrap_or_else(|| match &last {
            Some(last) => {
                let dt = stamp.secs_since(last.stamp);
                positions.zip(&last.positions, |new, old| (new - old) / dt)
            }
            None => self.zeros,
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

    /// Takes in who else publishes velocities on `topic`.
    pub(crate) fn others(&mut self, topic: &str, nodes: Vec<String>) {
        self.others = (!nodes.is_empty()).then(|| (topic.to_owned(), nodes));
    }

    /// From now on nothing that is sent can be relied on.
    pub(crate) fn cut_off(&mut self, why: &str) {
        self.cut_off = Some(why.to_owned());
    }

    /// What the latched fault was, with figures.
    pub(crate) fn explanation(&self) -> Option<String> {
        matches!(self.mode, ArmMode::Faulted(_)).then(|| self.words.clone())
    }

    /// Takes in what the robot's controller says of itself.
    pub(crate) fn robot(&mut self, now: Stamp, hindrance: Option<FaultReason>) {
        self.reports.take(now, hindrance);
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
            ArmMode::Faulted(reason) => return Err(self.refused(reason)),
            mode => return Err(Refused::Mode { mode }),
        }
        if let Some(reason) = self.reports.hindrance {
            return Err(Refused::Hindered { reason });
        }
        if let Some(silence) = self.reports.silence(now) {
            return Err(Refused::SilentRobot { silence });
        }
        if let Some((topic, nodes)) = self.others.clone() {
            return Err(Refused::SecondController { topic, nodes });
        }
        let positions = self.fresh(now)?.positions;
        self.tracking.restart(positions);
        self.rest.restart();
        self.taken_over = Some(now);
        self.guard.assume(Motion::steady(self.zeros));
        self.command = None;
        self.mode = ArmMode::Enabled;
        Ok(())
    }

    pub(crate) fn command(&mut self, now: Stamp, command: &RateCommand) -> Result<(), Refused> {
        match self.mode {
            ArmMode::Enabled | ArmMode::Moving => {}
            ArmMode::Faulted(reason) => return Err(self.refused(reason)),
            mode => return Err(Refused::Mode { mode }),
        }
        if !command.rates.is_finite() {
            self.fault(
                FaultReason::NonFiniteCommand,
                "a rate is not finite".to_owned(),
            );
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
        let ahead = command.stamp.since(now);
        if ahead > self.timing.command_hold {
            return Err(Refused::Ahead {
                ahead_ms: ahead.as_millis(),
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
        if self.reports.silence(now).is_some() {
            self.reports.forget();
        }
        if let ArmMode::Faulted(reason) = self.mode {
            if let Some(reason) = self.reports.hindrance {
                return Err(Refused::Hindered { reason });
            }
            self.fresh(now)?;
            if !self.is_rest() || self.outside_limits().is_some() || self.cut_off.is_some() {
                return Err(self.refused(reason));
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

    fn fault(&mut self, reason: FaultReason, words: String) {
        self.command = None;
        self.mode = ArmMode::Faulted(reason);
        self.words = words;
    }

    fn refused(&self, reason: FaultReason) -> Refused {
        Refused::Faulted {
            reason,
            words: self.words.clone(),
        }
    }

    fn fresh(&self, now: Stamp) -> Result<&Feedback, Refused> {
        let age = self.feedback.as_ref().map(|last| now.since(last.arrived));
        match (&self.feedback, age) {
            (Some(feedback), Some(age)) if age <= self.timing.feedback => Ok(feedback),
            (_, age) => Err(match (self.skew(now), age) {
                (Some(behind_s), _) => Refused::Skew { behind_s },
                (None, Some(age)) => Refused::StaleFeedback {
                    age_ms: age.as_millis(),
                },
                (None, None) => Refused::NoFeedback,
            }),
        }
    }

    /// A joint outside its limits by more than the tolerance of tracking.
    fn outside_limits(&self) -> Option<usize> {
        let limits = self.guard.limiter().limits();
        let positions = self.feedback?.positions;
        positions.iter().zip(limits).position(|(q, limit)| {
            *q < limit.lower - self.tolerance || *q > limit.upper + self.tolerance
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
