//! The program's side of the simulated arm.

use hal::{Arm, ArmDescription, ArmMode, ArmState, Error, ErrorKind, RateCommand};

use super::SimulatedArm;
use super::fault::Fault;

/// Why the simulated driver refuses.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// Not in this mode.
    #[error("not while {0:?}")]
    Mode(ArmMode),
    /// The command has the wrong number of joints.
    #[error("{given} rates for {expected} joints")]
    Joints {
        /// Rates given.
        given: usize,
        /// Joints of the arm.
        expected: usize,
    },
    /// The command holds NaN or infinity.
    #[error("a rate is not finite")]
    NonFinite,
    /// The command was computed too long ago, or in the future.
    #[error("the command is {age_s} s old")]
    Late {
        /// Its age \[s\].
        age_s: f64,
    },
    /// The command is not newer than the last one.
    #[error("command {sequence} after command {last}")]
    Old {
        /// Its number.
        sequence: u64,
        /// Number of the last command.
        last: u64,
    },
    /// The cause of a fault is still there.
    #[error("the cause is still there: {cause:?}")]
    CauseRemains {
        /// The cause.
        cause: Fault,
    },
    /// The arm is not at rest yet.
    #[error("the arm still moves")]
    StillMoving,
    /// No connection.
    #[error("no connection")]
    NoConnection,
}

impl Refusal {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Mode(ArmMode::Faulted(_)) | Self::CauseRemains { .. } => ErrorKind::Faulted,
            Self::Mode(_) | Self::StillMoving => ErrorKind::WrongMode,
            Self::NoConnection => ErrorKind::Disconnected,
            Self::Joints { .. } | Self::NonFinite | Self::Late { .. } | Self::Old { .. } => {
                ErrorKind::Rejected
            }
        }
    }
}

/// The program's side of a [`SimulatedArm`]; dropping it stops the arm.
#[derive(Debug)]
pub struct SimulatedDriver {
    arm: SimulatedArm,
    description: ArmDescription,
}

impl SimulatedDriver {
    pub(super) fn new(arm: SimulatedArm) -> Self {
        let description = arm.lock().description.clone();
        Self { arm, description }
    }

    fn error(&self, refusal: Refusal) -> Error {
        Error::with_source(self.description.name.as_str(), refusal.kind(), refusal)
    }

    fn connected(&self) -> Result<(), Error> {
        if self.arm.lock().is_connected() {
            return Ok(());
        }
        Err(self.error(Refusal::NoConnection))
    }
}

impl Arm for SimulatedDriver {
    fn description(&self) -> &ArmDescription {
        &self.description
    }

    fn state(&mut self) -> Result<ArmState, Error> {
        self.connected()?;
        let state = self.arm.lock().state();
        state.ok_or_else(|| self.error(Refusal::NoConnection))
    }

    fn enable(&mut self) -> Result<(), Error> {
        self.connected()?;
        let result = self.arm.lock().enable();
        result.map_err(|refusal| self.error(refusal))
    }

    fn command(&mut self, command: &RateCommand) -> Result<(), Error> {
        self.connected()?;
        let result = self.arm.lock().command(command);
        result.map_err(|refusal| self.error(refusal))
    }

    fn stop(&mut self) -> Result<(), Error> {
        self.arm.lock().stop();
        Ok(())
    }

    fn reset(&mut self) -> Result<(), Error> {
        self.connected()?;
        let result = self.arm.lock().reset();
        result.map_err(|refusal| self.error(refusal))
    }
}

impl Drop for SimulatedDriver {
    fn drop(&mut self) {
        self.arm.lock().stop();
    }
}
