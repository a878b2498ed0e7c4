//! Whether an insertion may start: answered before it is promised.

use hal::frame::LeftCamera;
use hal::{Arm, Position};

use crate::aim::{Aimed, TargetRefused};
use crate::config::{Config, TargetKind};
use crate::rig::Rig;
use crate::run::{RunError, check_target};

/// Makes the arm ready for an insertion to `given`, or to the configuration's target where none is
/// given, or says why it cannot be.
pub(super) fn prepare(
    config: &Config,
    rig: &mut Rig,
    given: Option<Position<LeftCamera>>,
) -> Result<(), String> {
    let state = rig.arm.state().map_err(|error| words(&error))?;
    target(config, rig, given).map_err(|reason| format!("target refused: {reason}"))?;
    if config.run.dry_run {
        return Ok(());
    }
    rig.check_start(&state).map_err(|away| away.to_string())?;
    if let Some(blind) = rig.blind() {
        return Err(blind.to_string());
    }
    rig.enable().map_err(|error| words(&error))
}

/// Whether an insertion from where the arm stands may go there.
pub(super) fn target(
    config: &Config,
    rig: &mut Rig,
    given: Option<Position<LeftCamera>>,
) -> Result<Aimed, String> {
    if given.is_some() && config.target.kind == TargetKind::Marker {
        return Err(TargetRefused::Marker.to_string());
    }
    check_target(config, rig, given).map_err(|error| match error {
        RunError::Target(refused) => refused.to_string(),
        RunError::Device(error) => words(&error),
        error => error.to_string(),
    })
}

/// An error of the arm with its causes.
pub(super) fn words(error: &hal::Error) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::ErrorKind;

    #[test]
    fn an_error_is_told_with_its_causes() {
        let error = hal::Error::with_source("viper", ErrorKind::Disconnected, "link silent");
        assert_eq!(words(&error), "viper: not connected: link silent");
    }
}
