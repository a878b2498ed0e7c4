//! What the log of an insertion says about the way out.

use std::path::{Path, PathBuf};

use hal::frame::{LeftCamera, World};
use hal::telemetry::Phase;
use hal::{ArmState, Joints, RateCommand, Stamp, Transform};
use nalgebra::Isometry3;
use rosbridge::log::{LogReader, ReadError, Record};

use super::path::{BasePath, Lead};
use crate::bearings::entry_point;
use crate::config::{self, Config, ConfigError};
use crate::cycle::Bearings;
use crate::journal::WITHDRAWAL_OF;
use crate::rig::{self, RigBuildError};

/// Withdrawals of withdrawals that are followed back to their insertion.
const GENERATIONS: u32 = 100;
/// A log without a way out.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The log.
    #[error("{}: {source}", log.display())]
    Log {
        /// Its file.
        log: PathBuf,
        /// Why.
        source: ReadError,
    },
    /// Its configuration, or a change to it.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The arm of its configuration.
    #[error(transparent)]
    Rig(#[from] RigBuildError),
    /// Nothing moved.
    #[error("{}: no reading of the arm, so nothing was inserted", log.display())]
    Empty {
        /// The log.
        log: PathBuf,
    },
    /// The log of a withdrawal whose insertion is not known.
    #[error(
        "{}: the log of a withdrawal without that of its insertion: name the insertion's log",
        log.display()
    )]
    NoInsertion {
        /// The log.
        log: PathBuf,
    },
}

/// The course of an insertion, with the withdrawals that followed it.
#[derive(Debug)]
pub struct Recording {
    /// Its configuration.
    pub config: Config,
    /// Registration of the stereo frame.
    pub world_from_left_camera: Transform<World, LeftCamera>,
    /// Log of the insertion.
    pub insertion: PathBuf,
    /// Where the arm stood at the start.
    pub start: ArmState,
    /// Where it stood last.
    pub last: ArmState,
    /// Base poses of the insertion.
    pub path: BasePath,
    /// Commands that went out, in their order; between two of these lists the arm was stopped.
    pub commands: Vec<Vec<RateCommand>>,
    /// Number of the last step.
    pub last_step: u64,
    /// Whether all logs are complete; a killed process leaves one that is not.
    pub complete: bool,
}

impl Recording {
    /// Reads the log in `file`, with `overrides` (`key=value`) applied to its configuration. The
    /// log of a withdrawal is read with that of its insertion.
    ///
    /// # Errors
    /// See [`RecordingError`].
    pub fn read(file: &Path, overrides: &[String]) -> Result<Self, RecordingError> {
        let mut files = vec![file.to_owned()];
        loop {
            let last = files.last().map_or(file, PathBuf::as_path);
            let Some(before) = insertion_of(last)? else {
                break;
            };
            if before.as_os_str().is_empty() || files.len() > GENERATIONS as usize {
                return Err(RecordingError::NoInsertion {
                    log: last.to_owned(),
                });
            }
            files.push(before);
        }
        files.reverse();
        let mut tape = Tape::default();
        let mut read = None;
        for log in &files {
            let mut reader = open(log)?;
            let info = reader.run().clone();
            let (config, bearings) = if let Some(read) = read.take() {
                read
            } else {
                let config = config::parse(&info.config, log, overrides)?;
                let bearings = rig::bearings(&config, info.world_from_left_camera)?;
                (config, bearings)
            };
            tape.commands.push(Vec::new());
            for record in reader.by_ref() {
                match record {
                    Ok(record) => tape.take(record, &bearings),
                    // As a power failure leaves it: what stands before leads out.
                    Err(ReadError::Damaged { .. }) if tape.last.is_some() => tape.broken = true,
                    Err(error) => return Err(in_log(log)(error)),
                }
            }
            tape.broken |= !reader.is_complete();
            read = Some((config, bearings));
        }
        let (Some((config, bearings)), Some(start), Some(last)) = (read, tape.start, tape.last)
        else {
            return Err(RecordingError::Empty {
                log: file.to_owned(),
            });
        };
        Ok(Self {
            config,
            world_from_left_camera: bearings.world_from_left_camera,
            insertion: files.swap_remove(0),
            start,
            last,
            path: tape.path,
            commands: tape.commands,
            last_step: tape.last_step,
            complete: !tape.broken,
        })
    }

    /// Where the arm may stand beyond the recorded end.
    pub fn lead(&self) -> Lead {
        match self.path.start() {
            Some(start) if !self.complete => Lead::broken_off(entry_point(&self.config, start)),
            _ => Lead::BRAKED,
        }
    }
}

/// The log before that of a withdrawal; nothing for an insertion's.
fn insertion_of(log: &Path) -> Result<Option<PathBuf>, RecordingError> {
    let reader = open(log)?;
    Ok(reader.run().labels.get(WITHDRAWAL_OF).map(|name| {
        let named = PathBuf::from(name);
        // Folders are moved and read from elsewhere: the log of the folder above is as good.
        let above = log.parent().and_then(Path::parent);
        match (named.exists(), above.map(|folder| folder.join("run.mcap"))) {
            (false, Some(beside)) if beside.exists() => beside,
            _ => named,
        }
    }))
}

fn open(log: &Path) -> Result<LogReader<std::io::BufReader<std::fs::File>>, RecordingError> {
    LogReader::open(log).map_err(in_log(log))
}

fn in_log(log: &Path) -> impl FnOnce(ReadError) -> RecordingError + '_ {
    move |source| RecordingError::Log {
        log: log.to_owned(),
        source,
    }
}

#[derive(Default)]
struct Tape {
    start: Option<ArmState>,
    last: Option<ArmState>,
    path: BasePath,
    commands: Vec<Vec<RateCommand>>,
    last_step: u64,
    withdraws: bool,
    broken: bool,
    /// Poses since the last step: of the insertion if that is what the step says.
    waiting: Vec<(Isometry3<f64>, Joints)>,
}

impl Tape {
    fn take(&mut self, record: Record, bearings: &Bearings) {
        match record {
            Record::Arm(state) => {
                let pose = crate::bearings::base_pose(bearings, &state);
                if self.start.is_none() {
                    self.start = Some(state);
                    self.path.note(&pose, &state.positions);
                }
                self.last = Some(state);
                self.waiting.push((pose, state.positions));
            }
            Record::Step(step) => {
                if step.phase == Phase::Retracting && !self.withdraws {
                    self.withdraws = true;
                    self.commands.push(Vec::new());
                }
                self.last_step = step.step;
                for (pose, joints) in self.waiting.drain(..) {
                    if !self.withdraws {
                        self.path.note(&pose, &joints);
                    }
                }
            }
            // A withdrawal within a run stands in both logs.
            Record::Command(command) if self.is_new(command.stamp) => {
                if let Some(leg) = self.commands.last_mut() {
                    leg.push(command);
                }
            }
            _ => {}
        }
    }

    /// Whether a command of `stamp` was not read yet. The first one of a simulated run has stamp zero.
    fn is_new(&self, stamp: Stamp) -> bool {
        let last = self.commands.iter().rev().find_map(|leg| leg.last());
        last.is_none_or(|command| stamp > command.stamp)
    }
}
