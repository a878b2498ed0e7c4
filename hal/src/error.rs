//! The error of devices.

use core::fmt;

use serde::{Deserialize, Serialize};

/// What went wrong, for callers that act on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ErrorKind {
    /// The device is not connected.
    Disconnected,
    /// The device did not answer in time.
    Timeout,
    /// The device answered nonsense.
    Protocol,
    /// The command was refused: non-finite, late, duplicate or of the wrong size.
    Rejected,
    /// The state of the device does not allow the command (for instance: not enabled).
    WrongMode,
    /// The device has a latched fault; `reset`, then `enable`.
    Faulted,
    /// The device's description or configuration does not fit.
    Configuration,
    /// The device's clock is not the run's.
    ClockSkew,
}

impl fmt::Display for ErrorKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Disconnected => "not connected",
            Self::Timeout => "no answer in time",
            Self::Protocol => "protocol violated",
            Self::Rejected => "command rejected",
            Self::WrongMode => "not allowed in this mode",
            Self::Faulted => "faulted",
            Self::Configuration => "wrong configuration",
            Self::ClockSkew => "clocks differ",
        })
    }
}

/// Failure of a device: which one, what kind, and the driver's own error.
#[derive(Debug, thiserror::Error)]
#[error("{device}: {kind}")]
pub struct Error {
    /// Name of the device, as its configuration calls it.
    pub device: String,
    /// What went wrong.
    pub kind: ErrorKind,
    /// The driver's own error.
    pub source: Option<Box<dyn std::error::Error + Send + Sync>>,
}

impl Error {
    /// An error without further cause.
    pub fn new(device: impl Into<String>, kind: ErrorKind) -> Self {
        Self {
            device: device.into(),
            kind,
            source: None,
        }
    }

    /// An error with the driver's own error as cause.
    pub fn with_source(
        device: impl Into<String>,
        kind: ErrorKind,
        source: impl Into<Box<dyn std::error::Error + Send + Sync>>,
    ) -> Self {
        Self {
            device: device.into(),
            kind,
            source: Some(source.into()),
        }
    }

    /// What went wrong.
    pub const fn kind(&self) -> ErrorKind {
        self.kind
    }
}
