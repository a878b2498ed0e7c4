//! The guard as a decorator of an arm.

use core::time::Duration;

use super::{Guard, Motion};
use crate::telemetry::Limit;
use crate::{Arm, ArmDescription, ArmMode, ArmState, Error, ErrorKind, RateCommand, Stamp};

/// An arm behind a [`Guard`].
///
/// Positions come from the arm's feedback, carried on to the command's stamp with the rates let
/// through last. The arm's own lag has to fit into the limiter's margin.
#[derive(Debug)]
pub struct Guarded<A> {
    arm: A,
    guard: Guard,
    last: Option<Stamp>,
    acted: Vec<Limit>,
}

impl<A: Arm> Guarded<A> {
    /// Puts `guard` in front of `arm`.
    ///
    /// # Errors
    /// [`ErrorKind::Configuration`] if the guard is for another number of joints.
    pub fn new(arm: A, guard: Guard) -> Result<Self, Error> {
        if arm.description().limits.len() != guard.limiter.limits().len() {
            let device = arm.description().name.clone();
            return Err(Error::new(device, ErrorKind::Configuration));
        }
        Ok(Self {
            arm,
            guard,
            last: None,
            acted: Vec::new(),
        })
    }

    /// Limits that acted on the newest command.
    pub fn acted(&self) -> &[Limit] {
        &self.acted
    }

    /// The arm behind the guard.
    pub fn inner(&self) -> &A {
        &self.arm
    }

    /// Takes the guard away.
    pub fn into_inner(self) -> A {
        self.arm
    }

    fn period(&self, stamp: Stamp) -> Duration {
        let hold = Duration::from_secs_f64(self.guard.limiter.hold());
        self.last
            .map(|last| stamp.since(last))
            .filter(|dt| !dt.is_zero() && *dt <= hold)
            .unwrap_or(self.arm.description().period)
    }
}

impl<A: Arm> Arm for Guarded<A> {
    fn description(&self) -> &ArmDescription {
        self.arm.description()
    }

    fn state(&mut self) -> Result<ArmState, Error> {
        self.arm.state()
    }

    fn enable(&mut self) -> Result<(), Error> {
        self.arm.enable()
    }

    fn command(&mut self, command: &RateCommand) -> Result<(), Error> {
        self.acted.clear();
        let state = self.arm.state()?;
        let joints = self.guard.limiter.limits().len();
        let obeyable = command.rates.is_finite() && command.rates.len() == joints;
        if !obeyable || state.mode != ArmMode::Moving && state.mode != ArmMode::Enabled {
            // The arm itself says why not.
            return self.arm.command(command);
        }
        let hold = self.guard.limiter.hold();
        let lapsed = self
            .last
            .is_none_or(|last| command.stamp.secs_since(last) > hold);
        if state.mode == ArmMode::Enabled {
            self.guard.assume(Motion::steady(state.rates.zeroed()));
        } else if lapsed {
            self.guard.assume(Motion::steady(state.rates));
        }
        let age = command.stamp.secs_since(state.stamp).clamp(0.0, hold);
        let before = *self.guard.motion();
        let positions = state.positions.zip(&before.rates, |q, rate| q + rate * age);
        let dt = self.period(command.stamp).as_secs_f64();
        let limited = self.guard.step(&positions, &command.rates, dt);
        let result = self.arm.command(&RateCommand {
            rates: limited.rates,
            ..*command
        });
        match result {
            Ok(()) => {
                self.last = Some(command.stamp);
                self.acted = limited.limits;
            }
            Err(_) => self.guard.assume(before),
        }
        result
    }

    fn stop(&mut self) -> Result<(), Error> {
        self.last = None;
        self.arm.stop()
    }

    fn reset(&mut self) -> Result<(), Error> {
        self.last = None;
        self.arm.reset()
    }

    fn explanation(&self) -> Option<String> {
        self.arm.explanation()
    }
}
