//! The moving part: set points within the limits, followed by lagging joints.

use core::time::Duration;

use hal::guarded::{Limiter, LimiterError, Motion};
use hal::{JointLimit, Joints};

use super::fault::Fault;

/// Step of the simulation.
pub(super) const TICK: Duration = Duration::from_millis(1);
const TICK_S: f64 = 1e-3;

/// Set points, joints, and joints as they would be without faults.
#[derive(Clone, Debug)]
pub(super) struct Servo {
    limiter: Limiter,
    motion: Motion,
    set_point: Joints,
    /// Part of the distance to the set point covered in a tick: at a constant rate, the joints
    /// are late by exactly the lag.
    share: f64,
    expected: Joints,
    actual: Joints,
    before: Joints,
}

impl Servo {
    pub(super) fn new(
        limits: &[JointLimit],
        start: &Joints,
        lag: f64,
    ) -> Result<Self, LimiterError> {
        Ok(Self {
            limiter: Limiter::new(limits, 0.0, TICK)?,
            motion: Motion::steady(start.zeroed()),
            set_point: *start,
            share: TICK_S / (lag + TICK_S),
            expected: *start,
            actual: *start,
            before: *start,
        })
    }

    /// One tick towards the rates `target`.
    pub(super) fn tick(&mut self, target: &Joints, faults: &[Fault]) {
        let rates = self
            .limiter
            .step(&self.set_point, &self.motion, target, TICK_S)
            .rates;
        self.motion = Motion {
            rates,
            accelerations: rates.zip(&self.motion.rates, |new, old| (new - old) / TICK_S),
        };
        self.set_point = self.set_point.zip(&rates, |q, rate| q + rate * TICK_S);
        let share = self.share;
        let follow = |q: f64, set: f64| q + (set - q) * share;
        self.expected = self.expected.zip(&self.set_point, follow);
        self.before = self.actual;
        self.actual = self.actual.zip(&self.set_point, follow);
        for fault in faults {
            match *fault {
                Fault::Jammed(joint) => {
                    if let (Some(q), Some(before)) =
                        (self.actual.get_mut(joint), self.before.get(joint))
                    {
                        *q = *before;
                    }
                }
                Fault::Creeping { joint, rate } => {
                    if let (Some(q), Some(before)) =
                        (self.actual.get_mut(joint), self.before.get(joint))
                    {
                        *q = before + rate * TICK_S;
                    }
                }
                _ => {}
            }
        }
    }

    /// The set points follow the joints where a fault has left them.
    pub(super) fn settle(&mut self) {
        self.set_point = self.actual;
        self.expected = self.actual;
        self.motion = Motion::steady(self.motion.rates.zeroed());
    }

    /// Whether the set points stand still.
    pub(super) fn is_rest(&self) -> bool {
        self.motion.is_rest()
    }

    /// Joints now and one tick ago.
    pub(super) fn actual(&self) -> (&Joints, &Joints) {
        (&self.actual, &self.before)
    }

    pub(super) fn expected(&self) -> &Joints {
        &self.expected
    }
}
