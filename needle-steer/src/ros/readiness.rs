//! Whether an insertion may start: answered before it is promised.

use hal::Arm;

use crate::config::Config;
use crate::rig::Rig;

/// Makes the arm ready for an insertion, or says why it cannot be.
pub(super) fn prepare(config: &Config, rig: &mut Rig) -> Result<(), String> {
    let state = rig.arm.state().map_err(|error| words(&error))?;
    if config.run.dry_run {
        return Ok(());
    }
    rig.check_start(&state).map_err(|away| away.to_string())?;
    rig.enable().map_err(|error| words(&error))
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
