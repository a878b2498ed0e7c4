//! How a run ended.

use serde::Serialize;

use hal::telemetry::Telemetry;

use crate::config::Config;
use crate::score::TrueFigures;
use crate::supervisor::StopReason;

/// The verdict of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum Ended {
    /// The target is no longer in front of the tip.
    TargetPassed,
    /// The target went out of reach by this much \[m\].
    Unreachable(f64),
    /// The needle came no nearer for this long \[s\].
    NoProgress(f64),
    /// The supervisor stopped the run.
    Stopped(StopReason),
    /// The needle was withdrawn to its start on request.
    Retracted,
    /// The user stopped the run.
    Interrupted,
    /// The longest duration passed.
    TimedOut,
    /// Nothing was to be moved.
    DryRun,
}

impl Ended {
    /// Whether the run did what it was asked to.
    pub const fn is_success(&self) -> bool {
        matches!(self, Self::TargetPassed | Self::DryRun)
    }
}

impl std::fmt::Display for Ended {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::TargetPassed => f.write_str("target passed"),
            Self::Unreachable(shortfall) => {
                write!(f, "target out of reach by {:.1} mm", shortfall * 1e3)
            }
            Self::NoProgress(seconds) => write!(f, "no progress for {seconds:.0} s"),
            Self::Stopped(reason) => write!(f, "stopped: {reason}"),
            Self::Retracted => f.write_str("retracted"),
            Self::Interrupted => f.write_str("interrupted"),
            Self::TimedOut => f.write_str("timed out"),
            Self::DryRun => f.write_str("dry run"),
        }
    }
}

impl Serialize for Ended {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// The figures of one run, as `run --json` prints them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The verdict.
    pub ended: Ended,
    /// Name of the law.
    pub law: String,
    /// Preset of the phantom.
    pub phantom: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Distance of the true target from the true tip axis when O's plane passes it \[mm\]; at the
    /// end for a run that ends earlier. Null without truth.
    pub true_error_mm: Option<f64>,
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
}

impl Summary {
    /// The figures of a run whose last state is `telemetry`; `duration` since the start of
    /// steering \[s\].
    pub fn new(
        config: &Config,
        ended: Ended,
        telemetry: &Telemetry,
        figures: Option<TrueFigures>,
        duration: f64,
    ) -> Self {
        let mm = |value: f64| value.is_finite().then_some(value * 1e3);
        Self {
            ended,
            law: config.run.law.clone(),
            phantom: config.run.phantom.clone(),
            seed: config.run.seed,
            true_error_mm: figures.and_then(|f| mm(f.lateral)),
            measured_error_mm: mm(telemetry.lateral_error),
            axial_error_mm: figures.and_then(|f| mm(f.axial)),
            max_stretch_mm: figures.map_or(0.0, |f| f.max_stretch * 1e3),
            mean_stretch_mm: figures.map_or(0.0, |f| f.mean_stretch * 1e3),
            duration_s: duration,
            steps: telemetry.step,
            out: None,
            log: None,
        }
    }
}
