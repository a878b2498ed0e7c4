//! An arm without hardware: the joints of a URDF behind a servo, moved by a virtual clock.
//!
//! [`SimulatedArm`] is the world's side (time, truth, faults), [`SimulatedDriver`] the
//! program's side, an [`hal::Arm`]. The same calls at the same stamps give the same motion to
//! the last bit, however time is cut into pieces.

mod driver;
mod fault;
mod servo;
mod world;

use core::time::Duration;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use hal::guarded::LimiterError;
use hal::{ArmMode, JointLimit, Joints, Stamp};

pub use driver::{Refusal, SimulatedDriver};
pub use fault::Fault;

use crate::kinematics::Chain;
use servo::TICK;
use world::World;

/// What the simulated arm is like. The default is a good industrial servo; the figures are
/// assumed, not measured on an arm.
#[derive(Clone, Debug, PartialEq)]
pub struct SimSettings {
    /// Name for messages.
    pub name: String,
    /// Period of commands and of encoder readings.
    pub period: Duration,
    /// Time constant with which the joints follow their set points \[s\]; 0 follows at once.
    pub servo_lag: f64,
    /// From a command to its effect.
    pub command_latency: Duration,
    /// From an encoder reading to its arrival.
    pub feedback_latency: Duration,
    /// Step of the encoders \[rad\]; 0 reads exactly. This and other angles are a tenth in metres for
    /// joints that slide ([`crate::kinematics::SLIDE_OF_A_RADIAN`]).
    pub encoder_step: f64,
    /// Age at which a command is no longer executed: the arm ramps to zero.
    pub command_expiry: Duration,
    /// Age at which a missing command is a fault.
    pub command_fault: Duration,
    /// Age at which missing feedback is a fault.
    pub feedback_fault: Duration,
    /// Distance between expected and measured position that is a fault when three readings in
    /// a row show it \[rad\].
    pub tracking_fault: f64,
}

impl Default for SimSettings {
    fn default() -> Self {
        Self {
            name: "simulated arm".to_owned(),
            period: Duration::from_millis(16),
            servo_lag: 0.010,
            command_latency: Duration::from_millis(4),
            feedback_latency: Duration::from_millis(2),
            encoder_step: 1e-5,
            command_expiry: Duration::from_millis(48),
            command_fault: Duration::from_millis(200),
            feedback_fault: Duration::from_millis(350),
            tracking_fault: 0.05,
        }
    }
}

impl SimSettings {
    /// No lag, no latency, exact encoders.
    #[must_use]
    pub fn ideal() -> Self {
        Self {
            servo_lag: 0.0,
            command_latency: Duration::ZERO,
            feedback_latency: Duration::ZERO,
            encoder_step: 0.0,
            ..Self::default()
        }
    }

    fn check(&self) -> Result<(), SimError> {
        let non_negative = [
            ("servo_lag", self.servo_lag),
            ("encoder_step", self.encoder_step),
        ];
        for (setting, value) in non_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(SimError::Setting { setting });
            }
        }
        if self.tracking_fault.is_nan() || self.tracking_fault <= 0.0 {
            let setting = "tracking_fault";
            return Err(SimError::Setting { setting });
        }
        if self.period.is_zero() || !self.period.as_nanos().is_multiple_of(TICK.as_nanos()) {
            // Encoders are read at ticks.
            return Err(SimError::Setting { setting: "period" });
        }
        if self.command_expiry > self.command_fault {
            let setting = "command_expiry";
            return Err(SimError::Setting { setting });
        }
        Ok(())
    }
}

/// Why a simulated arm cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimError {
    /// The limits are no limits.
    #[error("limits of the simulated arm: {0}")]
    Limits(#[from] LimiterError),
    /// The number of joints at the start, or of names, is not that of the limits.
    #[error("{given} joints given, {expected} expected")]
    Joints {
        /// The number given.
        given: usize,
        /// The number of limits.
        expected: usize,
    },
    /// A joint starts outside its limits or not at a number.
    #[error("joint {joint} starts at {position_rad} rad, outside {lower_rad} to {upper_rad} rad")]
    Start {
        /// Name of the joint.
        joint: String,
        /// Where it would start \[rad\].
        position_rad: f64,
        /// Lower limit \[rad\].
        lower_rad: f64,
        /// Upper limit \[rad\].
        upper_rad: f64,
    },
    /// A setting is negative, not finite, or a period of zero.
    #[error("settings of the simulated arm: {setting} is out of range")]
    Setting {
        /// The setting.
        setting: &'static str,
    },
}

/// The world's side of a simulated arm; clones are the same arm.
#[derive(Clone, Debug)]
pub struct SimulatedArm {
    world: Arc<Mutex<World>>,
}

impl SimulatedArm {
    /// An arm with the joints and limits of `chain`, at rest at `start` \[rad\] at time zero,
    /// connected and not enabled.
    ///
    /// # Errors
    /// The start is outside the limits, or a setting is out of range.
    pub fn new(chain: &Chain, start: &Joints, settings: SimSettings) -> Result<Self, SimError> {
        let units: Vec<f64> = chain.kinds().iter().map(|kind| kind.unit()).collect();
        Self::build(
            chain.names().to_vec(),
            chain.limits(),
            &units,
            start,
            settings,
        )
    }

    /// The same without a chain, all joints turning.
    ///
    /// # Errors
    /// As [`SimulatedArm::new`].
    pub fn from_limits(
        names: Vec<String>,
        limits: &[JointLimit],
        start: &Joints,
        settings: SimSettings,
    ) -> Result<Self, SimError> {
        let units = vec![1.0; limits.len()];
        Self::build(names, limits, &units, start, settings)
    }

    fn build(
        names: Vec<String>,
        limits: &[JointLimit],
        units: &[f64],
        start: &Joints,
        settings: SimSettings,
    ) -> Result<Self, SimError> {
        let world = World::new(names, limits, units, start, settings)?;
        Ok(Self {
            world: Arc::new(Mutex::new(world)),
        })
    }

    /// The program's side. Dropping it stops the arm.
    pub fn driver(&self) -> SimulatedDriver {
        SimulatedDriver::new(self.clone())
    }

    /// Moves the arm to `stamp`; does nothing if that has passed.
    pub fn advance_to(&self, stamp: Stamp) {
        self.lock().advance_to(stamp);
    }

    /// The time to which the arm was moved.
    pub fn now(&self) -> Stamp {
        self.lock().now()
    }

    /// Where the joints really are now \[rad\].
    pub fn true_joints(&self) -> Joints {
        self.lock().true_joints()
    }

    /// How fast the joints really turn now \[rad/s\].
    pub fn true_rates(&self) -> Joints {
        self.lock().true_rates()
    }

    /// State of the driver.
    pub fn mode(&self) -> ArmMode {
        self.lock().mode()
    }

    /// Makes `fault` happen now, until it is cleared.
    pub fn inject(&self, fault: Fault) {
        self.lock().inject(fault);
    }

    /// Takes the cause of `fault` away. What it has done stays until `reset`.
    pub fn clear(&self, fault: Fault) {
        self.lock().clear(fault);
    }

    /// Forgets a fault, as the driver's `reset` does.
    ///
    /// # Errors
    /// A cause is still there, or the arm still moves.
    pub fn reset(&self) -> Result<(), Refusal> {
        self.lock().reset()
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, World> {
        // A panic elsewhere must not keep anybody from stopping the arm.
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
