//! The contract of an arm.

use core::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{Error, JointLimit, Joints, Stamp};

/// What an arm is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ArmDescription {
    /// Name of the device for messages and errors.
    pub name: String,
    /// Names of the joints, base to flange, as in the URDF.
    pub joint_names: Vec<String>,
    /// Limits of the joints, base to flange.
    pub limits: Vec<JointLimit>,
    /// Period at which the arm wants commands.
    pub period: Duration,
}

/// State of the arm's driver. Only `reset`, then `enable`, leads out of `Faulted`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ArmMode {
    /// No connection.
    Disconnected,
    /// Connected and read, but not allowed to move.
    Connected,
    /// Allowed to move, at rest.
    Enabled,
    /// Executing a command.
    Moving,
    /// Slowing down after `stop`.
    Stopping,
    /// Stopped by a fault, which stays until `reset`.
    Faulted(FaultReason),
}

/// Why an arm faulted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum FaultReason {
    /// A command had a non-finite value.
    NonFiniteCommand,
    /// No fresh command within the allowed time while moving.
    StaleCommand,
    /// No fresh feedback within the allowed time.
    StaleFeedback,
    /// No acknowledgement within the allowed time.
    StaleAcknowledgement,
    /// The arm is not where it was commanded to be.
    TrackingError,
    /// The arm moved without a command.
    UncommandedMotion,
    /// The first set point is not where the arm is.
    StartMismatch,
    /// A joint is outside its limits.
    JointLimit,
    /// The tool is outside its workspace.
    Workspace,
    /// Emergency stop pressed.
    EmergencyStop,
    /// Drives without power.
    DrivesOff,
    /// Controller in manual or unknown mode.
    NotAutomatic,
    /// The controller reports an error.
    ControllerError,
    /// The controller reports that motion is not possible.
    MotionImpossible,
    /// The stamps of the feedback do not fit the clock of the run.
    ClockSkew,
    /// Something else commands the same arm.
    SecondController,
    /// The connection was lost.
    ConnectionLost,
    /// The peer violates the protocol.
    Protocol,
    /// The dead-man token was not refreshed.
    DeadMan,
    /// Injected by a test.
    Injected,
}

/// Newest feedback of an arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ArmState {
    /// When the encoders were read.
    pub stamp: Stamp,
    /// Positions \[rad\].
    pub positions: Joints,
    /// Measured or estimated rates \[rad/s\].
    pub rates: Joints,
    /// State of the driver.
    pub mode: ArmMode,
}

/// Joint rates to execute from now on, until the next command or until it expires.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RateCommand {
    /// Strictly increasing; repeated or falling numbers are rejected.
    pub sequence: u64,
    /// When the command was computed.
    pub stamp: Stamp,
    /// Rates \[rad/s\].
    pub rates: Joints,
}

/// An arm that executes joint rates.
///
/// # Contract
/// * No method blocks longer than one period.
/// * `state` returns the newest feedback with the stamp of its encoder reading.
/// * `enable` works from `Connected` only, `command` from `Enabled` and `Moving` only; elsewhere
///   they fail with [`WrongMode`](crate::ErrorKind::WrongMode) or
///   [`Faulted`](crate::ErrorKind::Faulted).
/// * Rates of zero are always a legal command.
/// * A command with a non-finite value is rejected and faults; late, old and duplicate ones are
///   rejected and change nothing.
/// * A command not renewed for 48 ms ramps to zero while the mode stays `Moving`, so that a
///   fresh command resumes; not renewed for 200 ms it faults ([`FaultReason::StaleCommand`]),
///   unless the driver's configuration says otherwise. Nothing is ever extrapolated.
/// * A command of zero, once carried out, leads back to `Enabled` and needs no renewal.
/// * The stamp of a command may not be further from the present, before or after it, than the
///   time after which it expires.
/// * Commands beyond a limit are slowed in their direction, never bent.
/// * `stop` works in every mode, is idempotent, and brings the arm to rest; dropping the
///   driver stops too. After `stop` a moving arm is `Stopping`, then `Enabled`.
/// * `reset` clears a latched fault whose cause is gone and leaves `Connected`; reconnecting
///   or releasing an emergency stop never enables and never resumes motion.
pub trait Arm: Send {
    /// What this arm is.
    fn description(&self) -> &ArmDescription;

    /// Newest feedback.
    ///
    /// # Errors
    /// No connection, or feedback too old.
    fn state(&mut self) -> Result<ArmState, Error>;

    /// Allows motion.
    ///
    /// # Errors
    /// The mode does not allow it.
    fn enable(&mut self) -> Result<(), Error>;

    /// Executes joint rates.
    ///
    /// # Errors
    /// The command or the mode does not allow it; see the contract.
    fn command(&mut self, command: &RateCommand) -> Result<(), Error>;

    /// Brings the arm to rest.
    ///
    /// # Errors
    /// The stop could not be delivered; the driver keeps trying.
    fn stop(&mut self) -> Result<(), Error>;

    /// Clears a latched fault whose cause is gone.
    ///
    /// # Errors
    /// The cause is still there.
    fn reset(&mut self) -> Result<(), Error>;

    /// The latched fault in words, with its figures; nothing without a fault, or where the driver
    /// knows no more than its [`FaultReason`].
    fn explanation(&self) -> Option<String> {
        None
    }
}

impl<T: Arm + ?Sized> Arm for Box<T> {
    fn description(&self) -> &ArmDescription {
        (**self).description()
    }

    fn state(&mut self) -> Result<ArmState, Error> {
        (**self).state()
    }

    fn enable(&mut self) -> Result<(), Error> {
        (**self).enable()
    }

    fn command(&mut self, command: &RateCommand) -> Result<(), Error> {
        (**self).command(command)
    }

    fn stop(&mut self) -> Result<(), Error> {
        (**self).stop()
    }

    fn reset(&mut self) -> Result<(), Error> {
        (**self).reset()
    }

    fn explanation(&self) -> Option<String> {
        (**self).explanation()
    }
}
