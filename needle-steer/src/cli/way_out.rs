//! The command that takes a needle out, named where one is found inside.

use std::path::{Path, PathBuf};

use hal::{ArmState, Joints};

use crate::cycle::base_pose;
use crate::host::HostError;
use crate::rig::{self, RigBuildError};
use crate::withdrawal::{Place, Recording};

/// Logs that are looked into, the newest first: reading one takes a moment.
const LOOKED_INTO: usize = 8;

/// `error`, and where an arm does not stand at its start the command that withdraws the needle.
/// `out` is the folder that the new run was to write.
pub(super) fn with_way_out(error: RigBuildError, out: Option<&Path>) -> anyhow::Error {
    let (RigBuildError::Host(HostError::NotAtStart { source, .. })
    | RigBuildError::NotAtStart(source)) = &error
    else {
        return error.into();
    };
    let way_out = log_of(&source.found, out).map_or_else(
        || {
            "if a needle is still inside: `needle-steer withdraw LOG` takes it out, LOG the \
             run.mcap of its insertion"
                .to_owned()
        },
        |log| {
            format!(
                "the needle of an earlier insertion is still inside: `needle-steer withdraw {}` \
                 takes it out",
                log.display()
            )
        },
    );
    anyhow::anyhow!("{error}; {way_out}")
}

/// The newest log on whose path an arm at `found` stands.
fn log_of(found: &Joints, out: Option<&Path>) -> Option<PathBuf> {
    let mut logs = Vec::new();
    let beside = out.and_then(Path::parent);
    for folder in [Some(Path::new("out")), beside, Some(Path::new("."))] {
        let Some(Ok(entries)) = folder.map(std::fs::read_dir) else {
            continue;
        };
        for entry in entries.flatten() {
            let log = entry.path().join("run.mcap");
            if let Ok(changed) = log.metadata().and_then(|found| found.modified()) {
                logs.push((changed, log));
            }
        }
    }
    logs.sort();
    let mut newest = logs.into_iter().rev().take(LOOKED_INTO);
    newest
        .find(|(_, log)| stands_on(log, found))
        .map(|(_, log)| log)
}

/// Whether an arm at `found` stands on the path of this log, and not at its start.
fn stands_on(log: &Path, found: &Joints) -> bool {
    let Ok(mut recording) = Recording::read(log, &[]) else {
        return false;
    };
    let registered = recording.world_from_left_camera;
    let Ok(bearings) = rig::bearings(&recording.config, registered) else {
        return false;
    };
    let state = ArmState {
        positions: *found,
        ..recording.last
    };
    let lead = recording.lead();
    let place = recording
        .path
        .rejoin(&base_pose(&bearings, &state), found, lead);
    matches!(place, Ok(Place::On { .. }))
}
