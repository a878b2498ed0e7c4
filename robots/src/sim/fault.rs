//! Faults to inject.

use hal::FaultReason;

/// Something that goes wrong in the simulated arm or in its connection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// Emergency stop pressed.
    EmergencyStop,
    /// Drives without power.
    DrivesOff,
    /// Controller switched to manual mode.
    Manual,
    /// The controller reports an error.
    ControllerError,
    /// The connection is gone.
    ConnectionLost,
    /// Any fault of the driver.
    Injected,
    /// Feedback no longer arrives.
    FeedbackFrozen,
    /// Commands are accepted and lost.
    CommandsLost,
    /// A joint (from 0) no longer moves.
    Jammed(usize),
    /// A joint (from 0) creeps by itself.
    Creeping {
        /// The joint.
        joint: usize,
        /// How fast \[rad/s\].
        rate: f64,
    },
}

impl Fault {
    /// Whether `self` and `other` are the same fault of the same joint.
    pub(super) fn is_same_kind(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Creeping { joint: a, .. }, Self::Creeping { joint: b, .. })
            | (Self::Jammed(a), Self::Jammed(b)) => a == b,
            _ => core::mem::discriminant(self) == core::mem::discriminant(other),
        }
    }

    /// The fault that the driver sees at once; the others are found by its watchdogs.
    pub(super) fn immediate(&self) -> Option<FaultReason> {
        match self {
            Self::EmergencyStop => Some(FaultReason::EmergencyStop),
            Self::DrivesOff => Some(FaultReason::DrivesOff),
            Self::Manual => Some(FaultReason::NotAutomatic),
            Self::ControllerError => Some(FaultReason::ControllerError),
            Self::ConnectionLost => Some(FaultReason::ConnectionLost),
            Self::Injected => Some(FaultReason::Injected),
            Self::FeedbackFrozen | Self::CommandsLost | Self::Jammed(_) | Self::Creeping { .. } => {
                None
            }
        }
    }
}
