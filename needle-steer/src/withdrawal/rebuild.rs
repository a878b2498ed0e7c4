//! A simulated world lives as long as its process. For a withdrawal in another one its log is
//! replayed: the same commands at the same times move the same arm and the same tissue again.

use hal::{Arm, Stamp};

use super::conduct::told;
use super::recording::Recording;
use crate::bearings::base_pose;
use crate::config::Config;
use crate::rig::{Pace, Rig, RigBuildError, blind};

/// A rebuilt base may stand so far from the recorded one \[m\]: feedback is some periods old.
const AGREES: f64 = 0.5e-3;

/// A world that cannot be rebuilt.
#[derive(Debug, thiserror::Error)]
pub enum RebuildError {
    /// The devices.
    #[error(transparent)]
    Rig(#[from] RigBuildError),
    /// A device refuses what it took then.
    #[error("replaying the log at {at_s:.2} s: {problem}")]
    Replay {
        /// Time in the log \[s\].
        at_s: f64,
        /// What was refused.
        problem: String,
    },
    /// The arm ends elsewhere.
    #[error(
        "the replayed log leaves the needle's base {:.2} mm from where it was logged last: \
         written by another version, or with an arm moved by hand before",
        distance * 1e3
    )]
    Differs {
        /// How far \[m\].
        distance: f64,
    },
}

/// The rig at the end of the recording, at rest.
///
/// # Errors
/// See [`RebuildError`].
pub fn rebuild(config: &Config, recording: &Recording) -> Result<Rig, RebuildError> {
    let mut rig = Rig::simulated(&blind(config), Pace::Free)?;
    rig.bearings.world_from_left_camera = recording.world_from_left_camera;
    let period = rig.arm.description().period;
    rig.clock.wait_until(recording.start.stamp);
    for leg in &recording.commands {
        let Some(first) = leg.first() else { continue };
        rig.clock.wait_until(first.stamp);
        rig.enable().map_err(|error| refused(first.stamp, &error))?;
        for command in leg {
            rig.clock.wait_until(command.stamp);
            // As then: the guard works on what the arm reports.
            rig.arm
                .state()
                .and_then(|_| rig.arm.command(command))
                .map_err(|error| refused(command.stamp, &error))?;
            rig.advance_sequence(command.sequence);
        }
        let next = rig.clock.now() + period;
        rig.clock.wait_until(next);
        rig.come_to_rest().map_err(|error| refused(next, &error))?;
    }
    let failed = |error: hal::Error| refused(recording.last.stamp, &error);
    let place = |state| base_pose(&rig.bearings, state).translation.vector;
    let logged = place(&recording.last);
    let state = rig.arm.state().map_err(failed)?;
    let distance = (base_pose(&rig.bearings, &state).translation.vector - logged).norm();
    let speed = config.run.insertion_speed_mm_s * 1e-3;
    // The log's last reading may be older than its last command by one chunk.
    if distance > AGREES + speed * 0.5 {
        return Err(RebuildError::Differs { distance });
    }
    Ok(rig)
}

fn refused(at: Stamp, error: &hal::Error) -> RebuildError {
    RebuildError::Replay {
        at_s: at.as_secs(),
        problem: told(error),
    }
}
