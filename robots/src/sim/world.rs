//! Time, commands on their way, feedback on its way, watchdogs.

use std::collections::VecDeque;

use hal::{
    ArmDescription, ArmMode, ArmState, FaultReason, JointLimit, Joints, MAX_JOINTS, RateCommand,
    Stamp,
};

use super::driver::Refusal;
use super::fault::Fault;
use super::servo::{Servo, TICK};
use super::{SimError, SimSettings};

/// Readings in a row that have to show a wrong position.
const WRONG_READINGS: u32 = 3;
/// Distance from where a joint was left that is uncommanded motion \[rad, or the joint's unit\].
const UNCOMMANDED: f64 = 0.01;

#[derive(Debug)]
pub(crate) struct World {
    pub(super) description: ArmDescription,
    settings: SimSettings,
    /// What a radian is to each joint.
    units: Joints,
    servo: Servo,
    /// Stamp of the servo's state: the first tick not before `now`.
    tick: Stamp,
    now: Stamp,
    mode: ArmMode,
    target: Joints,
    /// Commands that have not taken effect yet.
    pending: VecDeque<(Stamp, Joints)>,
    last_command: Option<(u64, Stamp)>,
    /// Stamp of the newest command that was not lost.
    renewed: Stamp,
    /// Whether the last command was standstill.
    rest_wanted: bool,
    /// Encoder readings, newest last.
    readings: VecDeque<(Stamp, Joints)>,
    wrong_readings: u32,
    faults: Vec<Fault>,
}

impl World {
    pub(super) fn new(
        names: Vec<String>,
        limits: &[JointLimit],
        units: &[f64],
        start: &Joints,
        settings: SimSettings,
    ) -> Result<Self, SimError> {
        settings.check()?;
        let units = Joints::from_slice(units).map_err(|_| SimError::Joints {
            given: units.len(),
            expected: MAX_JOINTS,
        })?;
        for given in [start.len(), names.len()] {
            if given != limits.len() {
                let expected = limits.len();
                return Err(SimError::Joints { given, expected });
            }
        }
        for ((name, limit), q) in names.iter().zip(limits).zip(start.iter()) {
            if !(limit.lower..=limit.upper).contains(q) {
                return Err(SimError::Start {
                    joint: name.clone(),
                    position_rad: *q,
                    lower_rad: limit.lower,
                    upper_rad: limit.upper,
                });
            }
        }
        let servo = Servo::new(limits, start, settings.servo_lag)?;
        let mut world = Self {
            description: ArmDescription {
                name: settings.name.clone(),
                joint_names: names,
                limits: limits.to_vec(),
                period: settings.period,
            },
            settings,
            units,
            servo,
            tick: Stamp::ZERO,
            now: Stamp::ZERO,
            mode: ArmMode::Connected,
            target: start.zeroed(),
            pending: VecDeque::new(),
            last_command: None,
            renewed: Stamp::ZERO,
            rest_wanted: true,
            readings: VecDeque::new(),
            wrong_readings: 0,
            faults: Vec::new(),
        };
        world.read_encoders();
        Ok(world)
    }

    pub(super) fn now(&self) -> Stamp {
        self.now
    }

    pub(super) fn mode(&self) -> ArmMode {
        self.mode
    }

    pub(super) fn advance_to(&mut self, stamp: Stamp) {
        while self.tick < stamp {
            self.step();
        }
        self.now = self.now.max(stamp);
    }

    pub(super) fn true_joints(&self) -> Joints {
        let (after, before) = self.servo.actual();
        let left = self.tick.secs_since(self.now) / TICK.as_secs_f64();
        after.zip(before, |after, before| after - (after - before) * left)
    }

    pub(super) fn true_rates(&self) -> Joints {
        let (after, before) = self.servo.actual();
        after.zip(before, |after, before| {
            (after - before) / TICK.as_secs_f64()
        })
    }

    fn step(&mut self) {
        let begin = self.tick;
        self.tick = begin + TICK;
        while let Some((due, rates)) = self.pending.front().copied() {
            if due > begin {
                break;
            }
            self.pending.pop_front();
            self.target = rates;
        }
        self.age_command();
        if !matches!(self.mode, ArmMode::Moving) {
            self.target = self.target.zeroed();
            self.pending.clear();
        }
        self.servo.tick(&self.target, &self.faults);
        let idle = self.servo.is_rest() && self.pending.is_empty() && self.target.max_abs() == 0.0;
        let done =
            self.mode == ArmMode::Stopping || self.mode == ArmMode::Moving && self.rest_wanted;
        if idle && done {
            self.mode = ArmMode::Enabled;
        }
        let period = u64::try_from(self.settings.period.as_nanos()).unwrap_or(u64::MAX);
        if self.tick.as_nanos().is_multiple_of(period) {
            self.read_encoders();
        }
        self.watch_feedback();
    }

    fn age_command(&mut self) {
        if self.mode != ArmMode::Moving {
            return;
        }
        let age = self.tick.since(self.renewed);
        if age > self.settings.command_fault {
            self.fault(FaultReason::StaleCommand);
        } else if age > self.settings.command_expiry {
            self.target = self.target.zeroed();
            self.pending.clear();
        }
    }

    fn read_encoders(&mut self) {
        if self.has(|fault| matches!(fault, Fault::FeedbackFrozen | Fault::ConnectionLost)) {
            return;
        }
        let step = self.settings.encoder_step;
        let (actual, _) = self.servo.actual();
        let reading = actual.zip(&self.units, |q, unit| {
            if step > 0.0 {
                (q / (step * unit)).round() * (step * unit)
            } else {
                q
            }
        });
        self.readings.push_back((self.tick, reading));
        // Enough for the longest latency of a frozen feedback plus one difference.
        if self.readings.len() > 64 {
            self.readings.pop_front();
        }
        let off = reading.zip(self.servo.expected(), |a, b| a - b);
        let distance = off.zip(&self.units, |off, unit| off / unit).max_abs();
        let resting = self.servo.is_rest() && self.mode != ArmMode::Moving;
        if distance > self.settings.tracking_fault {
            self.wrong_readings += 1;
        } else {
            self.wrong_readings = 0;
        }
        if self.wrong_readings >= WRONG_READINGS {
            self.fault(FaultReason::TrackingError);
        } else if resting && distance > UNCOMMANDED {
            self.fault(FaultReason::UncommandedMotion);
        }
    }

    fn watch_feedback(&mut self) {
        let newest = self.newest().map_or(Stamp::ZERO, |(stamp, _)| stamp);
        if self.tick.since(newest) > self.settings.feedback_fault {
            self.fault(FaultReason::StaleFeedback);
        }
    }

    fn newest(&self) -> Option<(Stamp, Joints)> {
        self.readings.back().copied()
    }

    /// Latches the first fault.
    fn fault(&mut self, reason: FaultReason) {
        if !matches!(self.mode, ArmMode::Faulted(_)) {
            self.mode = ArmMode::Faulted(reason);
        }
        self.target = self.target.zeroed();
        self.pending.clear();
    }

    pub(super) fn inject(&mut self, fault: Fault) {
        self.clear(fault);
        self.faults.push(fault);
        if let Some(reason) = fault.immediate() {
            self.fault(reason);
        }
    }

    pub(super) fn clear(&mut self, fault: Fault) {
        self.faults.retain(|present| !present.is_same_kind(&fault));
    }

    fn has(&self, which: impl Fn(&Fault) -> bool) -> bool {
        self.faults.iter().any(which)
    }

    pub(super) fn is_connected(&self) -> bool {
        !self.has(|fault| matches!(fault, Fault::ConnectionLost))
    }

    pub(super) fn state(&self) -> Option<ArmState> {
        let latency = self.settings.feedback_latency;
        let arrived = |(stamp, _): &&(Stamp, Joints)| *stamp + latency <= self.now;
        let mut newest_first = self.readings.iter().rev().filter(arrived);
        // Before the first reading has arrived, it is known from connecting.
        let (stamp, positions) = newest_first.next().or(self.readings.front())?;
        let rates = match newest_first.next() {
            Some((earlier, before)) => {
                let dt = stamp.secs_since(*earlier);
                positions.zip(before, |after, before| (after - before) / dt)
            }
            None => positions.zeroed(),
        };
        Some(ArmState {
            stamp: *stamp,
            positions: *positions,
            rates,
            mode: self.mode,
        })
    }

    pub(super) fn enable(&mut self) -> Result<(), Refusal> {
        match self.mode {
            ArmMode::Connected => {
                self.mode = ArmMode::Enabled;
                self.last_command = None;
                Ok(())
            }
            mode => Err(Refusal::Mode(mode)),
        }
    }

    pub(super) fn command(&mut self, command: &RateCommand) -> Result<(), Refusal> {
        if !matches!(self.mode, ArmMode::Enabled | ArmMode::Moving) {
            return Err(Refusal::Mode(self.mode));
        }
        let expected = self.description.limits.len();
        if command.rates.len() != expected {
            let given = command.rates.len();
            return Err(Refusal::Joints { given, expected });
        }
        if !command.rates.is_finite() {
            self.fault(FaultReason::NonFiniteCommand);
            return Err(Refusal::NonFinite);
        }
        let age = self.now.secs_since(command.stamp);
        let late = self.settings.command_expiry.as_secs_f64();
        if !(-late..=late).contains(&age) {
            return Err(Refusal::Late { age_s: age });
        }
        if let Some((sequence, stamp)) = self.last_command
            && (command.sequence <= sequence || command.stamp < stamp)
        {
            return Err(Refusal::Old {
                sequence: command.sequence,
                last: sequence,
            });
        }
        self.last_command = Some((command.sequence, command.stamp));
        self.rest_wanted = command.rates.max_abs() == 0.0;
        let lost = self.has(|fault| matches!(fault, Fault::CommandsLost));
        if !lost || self.mode == ArmMode::Enabled {
            self.renewed = command.stamp;
        }
        self.mode = ArmMode::Moving;
        if !lost {
            let due = self.now + self.settings.command_latency;
            self.pending.push_back((due, command.rates));
        }
        Ok(())
    }

    pub(super) fn stop(&mut self) {
        self.target = self.target.zeroed();
        self.pending.clear();
        if self.mode == ArmMode::Moving {
            self.mode = ArmMode::Stopping;
        }
    }

    pub(super) fn reset(&mut self) -> Result<(), Refusal> {
        let ArmMode::Faulted(_) = self.mode else {
            return Ok(());
        };
        let cause = self
            .faults
            .iter()
            .find(|fault| fault.immediate().is_some() || matches!(fault, Fault::FeedbackFrozen));
        if let Some(cause) = cause {
            return Err(Refusal::CauseRemains { cause: *cause });
        }
        if !self.servo.is_rest() {
            return Err(Refusal::StillMoving);
        }
        self.servo.settle();
        self.wrong_readings = 0;
        self.mode = ArmMode::Connected;
        self.read_encoders();
        Ok(())
    }
}
