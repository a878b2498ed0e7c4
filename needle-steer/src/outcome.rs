//! How a run ended.

use serde::Serialize;

use hal::Stamp;
use hal::telemetry::{Telemetry, TruthEvent, TruthReport};

use crate::config::Config;
use crate::score::TrueFigures;
use crate::supervisor::StopReason;
use crate::withdrawal;

/// Why a run did not pass its target: a closed list, each with its test on the truth in
/// docs/HAZARDS.md.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// The base advanced, the tip did not.
    Stall,
    /// The shaft gave way outside the tissue.
    Buckling,
    /// The tissue was about to tear, or loaded beyond its bound.
    Tear,
    /// The target cannot be reached.
    OutOfReach,
    /// The sensor does not see the needle, or sees what cannot be it.
    NeedleLost,
    /// Measurements come too late, too seldom, or with stamps that cannot be right.
    MeasurementsLate,
    /// The tissue moves more than can be followed.
    TissueMotion,
    /// The model or the estimate failed, or disagrees with the measurements.
    ModelFailed,
    /// The arm, its link or its workspace.
    Device,
    /// The user, or the time that the user allowed.
    Operator,
}

impl std::fmt::Display for Cause {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Stall => "stall",
            Self::Buckling => "buckling",
            Self::Tear => "tear",
            Self::OutOfReach => "out of reach",
            Self::NeedleLost => "needle lost",
            Self::MeasurementsLate => "measurements late",
            Self::TissueMotion => "tissue motion",
            Self::ModelFailed => "model failed",
            Self::Device => "device",
            Self::Operator => "operator",
        })
    }
}

/// The verdict of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum Ended {
    /// The plane of the measured tip has passed the target.
    TargetPassed,
    /// The measured tip is farther beyond the target than counts as passed, by this much \[m\].
    Overrun(f64),
    /// The target went out of reach by this much \[m\].
    Unreachable(f64),
    /// The needle came no nearer.
    NoProgress {
        /// For this long \[s\].
        for_s: f64,
        /// What kept it.
        cause: Cause,
    },
    /// The supervisor stopped the run.
    Stopped(StopReason),
    /// A device failed: which one, and why.
    Device(String),
    /// The needle was withdrawn to its start on request.
    Retracted,
    /// It was to be withdrawn, and is not at its start.
    NotRetracted(withdrawal::Verdict),
    /// The user stopped the run.
    Interrupted,
    /// The ROS node was asked to end, or lost its name: in words.
    NodeEnded(String),
    /// The longest duration passed; what kept the needle most.
    TimedOut(Cause),
    /// Nothing was to be moved.
    DryRun,
}

impl Ended {
    /// Whether the run did what it was asked to.
    pub const fn is_success(&self) -> bool {
        matches!(self, Self::TargetPassed | Self::DryRun)
    }

    /// Why the target was not passed; nothing where it was, or where nothing was to be moved.
    pub const fn cause(&self) -> Option<Cause> {
        match self {
            Self::TargetPassed | Self::DryRun => None,
            Self::Overrun(_) => Some(Cause::ModelFailed),
            Self::Unreachable(_) => Some(Cause::OutOfReach),
            Self::NoProgress { cause, .. } | Self::TimedOut(cause) => Some(*cause),
            Self::Stopped(reason) => Some(reason.cause()),
            Self::Device(_) => Some(Cause::Device),
            Self::Retracted | Self::NotRetracted(_) | Self::Interrupted | Self::NodeEnded(_) => {
                Some(Cause::Operator)
            }
        }
    }

    /// The verdict of a run whose device failed.
    pub fn device(error: &hal::Error) -> Self {
        Self::Device(withdrawal::told(error))
    }
}

impl From<withdrawal::Verdict> for Ended {
    fn from(verdict: withdrawal::Verdict) -> Self {
        match verdict {
            withdrawal::Verdict::Retracted | withdrawal::Verdict::AtStart => Self::Retracted,
            withdrawal::Verdict::Interrupted => Self::Interrupted,
            verdict => Self::NotRetracted(verdict),
        }
    }
}

impl std::fmt::Display for Ended {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::TargetPassed => f.write_str("target passed"),
            Self::Unreachable(shortfall) => {
                write!(f, "target out of reach by {:.1} mm", shortfall * 1e3)
            }
            Self::Overrun(by) => write!(f, "target overrun by {:.1} mm", by * 1e3),
            Self::NoProgress { for_s, cause } => {
                write!(f, "no progress for {for_s:.0} s: {cause}")
            }
            Self::Stopped(reason) => write!(f, "stopped: {reason}"),
            Self::Device(error) => write!(f, "stopped: device failed: {error}"),
            Self::Retracted => f.write_str("retracted"),
            Self::NotRetracted(verdict) => verdict.fmt(f),
            Self::Interrupted => f.write_str("interrupted"),
            Self::NodeEnded(why) => write!(f, "stopped: {why}"),
            Self::TimedOut(Cause::Operator) => f.write_str("timed out"),
            Self::TimedOut(cause) => write!(f, "timed out: {cause}"),
            Self::DryRun => f.write_str("dry run"),
        }
    }
}

impl Serialize for Ended {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// An event of the simulated world, at its onset.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Happened {
    /// What happened.
    pub kind: TruthEvent,
    /// When, on the run's clock \[s\].
    pub t_s: f64,
}

/// Rest between two events of a kind from which the second counts as another one \[s\].
const APART: f64 = 1.0;
/// Events kept of one run.
const MOST_EVENTS: usize = 100;

/// The events of a simulated world so far: onsets, not every exposure at which they lasted.
#[derive(Clone, Debug, Default)]
pub struct Events {
    onsets: Vec<Happened>,
    lasting: Vec<(TruthEvent, Stamp)>,
}

impl Events {
    /// Takes in the truth of a step at `now`.
    pub fn note(&mut self, now: Stamp, truth: &TruthReport) {
        for kind in &truth.events {
            let last = self.lasting.iter_mut().find(|(known, _)| known == kind);
            let is_new = last
                .as_ref()
                .is_none_or(|(_, last)| now.secs_since(*last) > APART);
            match last {
                Some((_, last)) => *last = now,
                None => self.lasting.push((*kind, now)),
            }
            if is_new && self.onsets.len() < MOST_EVENTS {
                self.onsets.push(Happened {
                    kind: *kind,
                    t_s: now.as_secs(),
                });
            }
        }
    }

    /// The onsets, in order.
    pub fn onsets(&self) -> &[Happened] {
        &self.onsets
    }
}

/// The figures of one run, as `run --json` prints them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The verdict.
    pub ended: Ended,
    /// Why the target was not passed; null where it was.
    pub cause: Option<Cause>,
    /// Whether the target was passed, by measurement, within the goal.
    pub hit: bool,
    /// The goal: `target.goal_mm` \[mm\].
    pub goal_mm: f64,
    /// What happened in the simulated world, by onset.
    pub events: Vec<Happened>,
    /// Whether, in truth, the shaft buckled or yielded, the tissue tore, or the simulated world was
    /// out of balance: such a run is counted apart.
    pub spoilt: bool,
    /// Name of the law.
    pub law: String,
    /// Preset of the phantom.
    pub phantom: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Distance of the true target from the true tip axis when O's plane passes it \[mm\]; at the
    /// end for a run that ends earlier. Null without truth.
    pub true_error_mm: Option<f64>,
    /// The same less the bias that an electromagnetic sensor's field has there \[mm\]; null with
    /// another sensor or without truth.
    pub true_error_less_bias_mm: Option<f64>,
    /// The same by the sensor's last measurement \[mm\].
    pub measured_error_mm: Option<f64>,
    /// True distance along the tip axis between O's plane and the target at the stop \[mm\];
    /// positive: the target is ahead.
    pub axial_error_mm: Option<f64>,
    /// Largest true tissue displacement of the run \[mm\].
    pub max_stretch_mm: f64,
    /// True tissue displacement, averaged over the needle and the run \[mm\].
    pub mean_stretch_mm: f64,
    /// Duration of the insertion, from the start of steering \[s\].
    pub duration_s: f64,
    /// Law steps computed.
    pub steps: u64,
    /// Folder of the results, where they were written.
    pub out: Option<String>,
    /// The log, where one was written.
    pub log: Option<String>,
    /// Whether the log holds the whole run; null where none was written, and in the log itself.
    pub log_complete: Option<bool>,
}

impl Summary {
    /// The figures of a run whose last state is `telemetry`; `duration` since the start of
    /// steering \[s\].
    pub fn new(
        config: &Config,
        ended: Ended,
        telemetry: &Telemetry,
        figures: Option<TrueFigures>,
        events: &Events,
        duration: f64,
    ) -> Self {
        let mm = |value: f64| value.is_finite().then_some(value * 1e3);
        let goal_mm = config.target.goal_mm;
        let events = events.onsets().to_vec();
        Self {
            cause: ended.cause(),
            hit: ended == Ended::TargetPassed && telemetry.lateral_error * 1e3 <= goal_mm,
            goal_mm,
            spoilt: events.iter().any(|event| event.kind.spoils()),
            events,
            ended,
            law: config.run.law.clone(),
            phantom: config.run.phantom.clone(),
            seed: config.run.seed,
            true_error_mm: figures.and_then(|f| mm(f.lateral)),
            true_error_less_bias_mm: figures.and_then(|f| mm(f.lateral_less_bias?)),
            measured_error_mm: mm(telemetry.lateral_error),
            axial_error_mm: figures.and_then(|f| mm(f.axial)),
            max_stretch_mm: figures.map_or(0.0, |f| f.max_stretch * 1e3),
            mean_stretch_mm: figures.map_or(0.0, |f| f.mean_stretch * 1e3),
            duration_s: duration,
            steps: telemetry.step,
            out: None,
            log: None,
            log_complete: None,
        }
    }
}
