//! A recorded run through this build: the same measurements must give the same commands.
//!
//! [`Cycle::step`](crate::cycle::Cycle::step) is a function of its state and its inputs, and the
//! log holds every input bit by bit. What the log says once (registration, start, target) is set
//! once; what follows from the course of the phases (the step's duration, the resumption of a
//! law) is derived here as [`run`](mod@crate::run) derives it.

use std::io::Read;
use std::path::Path;

use hal::frame::LeftCamera;
use hal::telemetry::{Phase, Telemetry};
use hal::{ArmState, Joints, Position, SensedMarker, SensedShape, Stamp};
use rosbridge::log::{LogReader, ReadError, Record, RunInfo, same_step};
use serde::Serialize;

use crate::clock::WallTime;
use crate::config::{self, Config, ConfigError, SensorKind, TargetKind};
use crate::cycle::{Cycle, CycleError, Snapshot};
use crate::journal::marker_of;
use crate::rig::{self, RigBuildError};
use crate::run::PREDICTION;

/// A log that cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The log.
    #[error(transparent)]
    Log(#[from] ReadError),
    /// Its configuration, or a change to it.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The arm of its configuration.
    #[error(transparent)]
    Rig(#[from] RigBuildError),
    /// The controller of its configuration.
    #[error(transparent)]
    Cycle(#[from] CycleError),
    /// A step without the measurements that it read.
    #[error("step {step}: no reading of the arm stands before it, so it cannot be replayed")]
    NoInputs {
        /// Number of the step.
        step: u64,
    },
}

/// Where two courses of commands part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Parting {
    /// Number of the step.
    pub step: u64,
    /// Its time \[s\].
    pub time_s: f64,
    /// Needle in the tissue \[mm\].
    pub depth_mm: f64,
    /// Joint rates in the log \[rad/s\].
    pub recorded: Joints,
    /// Joint rates of the replay \[rad/s\].
    pub replayed: Joints,
}

/// What a replay found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReplayReport {
    /// Law of the replay.
    pub law: String,
    /// Version that wrote the log.
    pub recorded_by: String,
    /// Steps replayed.
    pub steps: u64,
    /// Steps whose joint rates differ in any bit.
    pub differing: u64,
    /// Steps whose telemetry differs in any bit, limits behind the law and truth apart.
    pub differing_reports: u64,
    /// The first step whose joint rates differ.
    pub first: Option<Parting>,
    /// Largest difference of a joint's rate \[rad/s\].
    pub largest_rate: f64,
    /// Whether the log is complete; a killed run's is not.
    pub complete: bool,
}

/// Replays the log in `file`, with `overrides` (`key=value`) applied to its configuration.
///
/// # Errors
/// See [`ReplayError`].
pub fn replay(file: &Path, overrides: &[String]) -> Result<ReplayReport, ReplayError> {
    replay_log(LogReader::open(file)?, file, overrides)
}

/// As [`replay`], from an open log; `name` is what errors call it.
///
/// # Errors
/// See [`ReplayError`].
pub fn replay_log<R: Read>(
    mut log: LogReader<R>,
    name: &Path,
    overrides: &[String],
) -> Result<ReplayReport, ReplayError> {
    let info = log.run().clone();
    let config = config::parse(&info.config, name, overrides)?;
    let recorded_by = info.versions.get("needle-steer").cloned();
    let mut report = ReplayReport {
        law: config.run.law.clone(),
        recorded_by: recorded_by.unwrap_or_else(|| "unknown".into()),
        steps: 0,
        differing: 0,
        differing_reports: 0,
        first: None,
        largest_rate: 0.0,
        complete: false,
    };
    let mut tape = Tape::new(&config, &info);
    for record in log.by_ref() {
        if let Some((recorded, replayed)) = tape.play(record?)? {
            report.compare(&recorded, replayed);
        }
    }
    report.complete = log.is_complete();
    Ok(report)
}

/// Time that each step of the log in `file` takes on this machine \[s\].
///
/// # Errors
/// See [`ReplayError`].
pub fn step_times(file: &Path) -> Result<Vec<f64>, ReplayError> {
    let mut log = LogReader::open(file)?;
    let info = log.run().clone();
    let config = config::parse(&info.config, file, &[])?;
    let mut tape = Tape::new(&config, &info);
    let clock = WallTime::start();
    let mut times = Vec::new();
    for record in log.by_ref() {
        let record = record?;
        let before = clock.now();
        if tape.play(record)?.is_some() {
            times.push(clock.now().secs_since(before));
        }
    }
    Ok(times)
}

impl ReplayReport {
    fn compare(&mut self, recorded: &Telemetry, replayed: &Telemetry) {
        self.steps += 1;
        if !same_report(recorded, replayed) {
            self.differing_reports += 1;
        }
        if same_bits(&recorded.joint_rates, &replayed.joint_rates) {
            return;
        }
        self.differing += 1;
        let difference = recorded
            .joint_rates
            .zip(&replayed.joint_rates, |a, b| a - b)
            .max_abs();
        self.largest_rate = self.largest_rate.max(difference);
        self.first.get_or_insert_with(|| Parting {
            step: recorded.step,
            time_s: recorded.stamp.as_secs(),
            depth_mm: recorded.depth * 1e3,
            recorded: recorded.joint_rates,
            replayed: replayed.joint_rates,
        });
    }
}

/// Whether two joint vectors are the same bit by bit.
pub fn same_bits(a: &Joints, b: &Joints) -> bool {
    a.len() == b.len()
        && a.iter()
            .zip(b.iter())
            .all(|(a, b)| a.to_bits() == b.to_bits())
}

/// Whether a replayed step says what the recorded one said. Truth and the limits of the arm's
/// guard joined the record behind the cycle.
fn same_report(recorded: &Telemetry, replayed: &Telemetry) -> bool {
    let mut recorded = recorded.clone();
    recorded.truth = None;
    recorded.law.limits.truncate(replayed.law.limits.len());
    same_step(&recorded, replayed)
}

/// A log's records in their order, and the controller that they feed.
struct Tape<'a> {
    config: &'a Config,
    info: &'a RunInfo,
    player: Option<Player>,
    inputs: Inputs,
    withdraws: bool,
}

impl<'a> Tape<'a> {
    fn new(config: &'a Config, info: &'a RunInfo) -> Self {
        Self {
            config,
            info,
            player: None,
            inputs: Inputs::default(),
            withdraws: false,
        }
    }

    /// Takes in a record; at a step, answers what was recorded and what is replayed.
    fn play(
        &mut self,
        record: Record,
    ) -> Result<Option<(Box<Telemetry>, &Telemetry)>, ReplayError> {
        match record {
            Record::Arm(state) => {
                if self.player.is_none() {
                    self.player = Some(Player::new(self.config, self.info, &state)?);
                }
                self.inputs.arm = Some(state);
            }
            Record::Shape(shape) => self.inputs.shape = Some(shape),
            // A withdrawal has no law, and no law follows it.
            Record::Step(recorded) if self.withdraws || recorded.phase == Phase::Retracting => {
                self.withdraws = true;
            }
            Record::Step(recorded) => {
                let inputs = std::mem::take(&mut self.inputs);
                let (Some(player), Some(arm)) = (&mut self.player, inputs.arm) else {
                    return Err(ReplayError::NoInputs {
                        step: recorded.step,
                    });
                };
                let replayed = player.step(&arm, &inputs, &recorded);
                return Ok(Some((recorded, replayed)));
            }
            Record::Note { text, .. } => {
                self.inputs.marker = marker_of(&text).or(self.inputs.marker);
            }
            Record::Stereo(_) | Record::Command(_) | Record::Document { .. } => {}
        }
        Ok(None)
    }
}

/// What a step read.
#[derive(Default)]
struct Inputs {
    arm: Option<ArmState>,
    shape: Option<SensedShape>,
    marker: Option<SensedMarker>,
}

/// A cycle that is fed from a log.
struct Player {
    cycle: Cycle,
    /// Whether the target is a marker that the cycle follows by itself.
    follows: bool,
    /// Whether the run saw images, of which a log keeps only what was tracked.
    images: bool,
    target: Option<Position<LeftCamera>>,
    last: Option<(Stamp, Phase)>,
    seen: Option<Stamp>,
}

impl Player {
    fn new(config: &Config, info: &RunInfo, start: &ArmState) -> Result<Self, ReplayError> {
        let bearings = rig::bearings(config, info.world_from_left_camera)?;
        Ok(Self {
            cycle: Cycle::new(config, bearings, start)?,
            follows: config.target.kind == TargetKind::Marker,
            images: config.run.sensor == SensorKind::Images,
            target: None,
            last: None,
            seen: None,
        })
    }

    fn step(&mut self, arm: &ArmState, inputs: &Inputs, recorded: &Telemetry) -> &Telemetry {
        let origin = Position::new(nalgebra::Point3::origin());
        // A marker's own motion is not a new target.
        let new = match self.target {
            None => recorded.target != origin,
            Some(before) => !self.follows && recorded.target != before,
        };
        if new {
            self.target = Some(recorded.target);
            self.cycle.set_target(recorded.target);
        }
        let (now, phase) = (recorded.stamp, recorded.phase);
        let dt = match self.last {
            Some((last, before)) if !by_wish(before, phase) => now.secs_since(last),
            _ => PREDICTION,
        };
        if self.last.is_some_and(|(_, before)| resumes(before, phase)) {
            self.cycle.resume();
        }
        self.last = Some((now, phase));
        // A tracked curve may stand in the log again where a step had no new image.
        let shape = inputs.shape.as_ref().filter(|s| self.seen != Some(s.stamp));
        self.seen = shape.map(|s| s.stamp).or(self.seen);
        self.cycle.step(&Snapshot {
            now,
            dt,
            arm,
            shape,
            // What was tracked in images is logged as a shape.
            pair: None,
            marker: inputs.marker,
            phase,
        });
        let telemetry = self.cycle.telemetry_mut();
        if self.images && shape.is_none() {
            // What the tracker said of a pair without a needle is in no other record.
            telemetry.tracking = recorded.tracking;
        }
        telemetry
    }
}

/// Whether the user changed the phase; from the straight start to steering it changes by itself.
fn by_wish(before: Phase, after: Phase) -> bool {
    before != after && (before, after) != (Phase::PreInsertion, Phase::Steering)
}

/// Whether an interrupted insertion goes on.
fn resumes(before: Phase, after: Phase) -> bool {
    before == Phase::Paused && matches!(after, Phase::PreInsertion | Phase::Steering)
}
