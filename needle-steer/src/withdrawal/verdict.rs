//! How a withdrawal ended.

use hal::{ArmMode, FaultReason};
use serde::Serialize;

use super::path::OffPath;
use crate::supervisor::in_words;

/// The verdict of a withdrawal.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// The base is back where the insertion began.
    Retracted,
    /// It was there already; nothing moved.
    AtStart,
    /// The base is there, and the tip still in the tissue.
    TipInside {
        /// Depth of the tip below the surface \[mm\].
        depth_mm: f64,
    },
    /// It did not begin.
    Refused(Refusal),
    /// It was stopped on its way.
    Stopped(Stop),
    /// The operator stopped it.
    Interrupted,
}

impl Verdict {
    /// Whether the needle is out.
    pub const fn is_success(&self) -> bool {
        matches!(self, Self::Retracted | Self::AtStart)
    }
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Retracted => f.write_str("retracted"),
            Self::AtStart => f.write_str("already at the start: nothing to withdraw"),
            Self::TipInside { depth_mm } => write!(
                f,
                "the base is back where it began, the tip is still {depth_mm:.0} mm below the surface: \
                 the needle is bent, broken or loose in its holder; leave the arm, free it by hand"
            ),
            Self::Refused(reason) => write!(f, "withdrawal refused: {reason}"),
            Self::Stopped(reason) => write!(f, "withdrawal stopped: {reason}"),
            Self::Interrupted => f.write_str("interrupted"),
        }
    }
}

impl Serialize for Verdict {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Why a withdrawal does not begin; nothing moves.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The arm does not report, or cannot be made to move.
    #[error("the arm is not ready: {0}")]
    Arm(String),
    /// The base is elsewhere.
    #[error("{0}; the needle is not where this path leads")]
    OffPath(#[from] OffPath),
    /// No path was recorded.
    #[error("no path of the base is recorded")]
    NoPath,
    /// A hand pushed the needle; no joint can draw it back.
    #[error(
        "a hand pushed this needle (insertion.by = \"hand\"), no joint did: draw it out by hand along \
         its guide; the device stands still"
    )]
    ByHand,
}

/// Why a withdrawal was stopped. Its bounds are its own: no measurement of the needle counts.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Stop {
    /// The arm faulted.
    #[error("the arm faulted: {}", in_words(*.0, .1.as_deref()))]
    ArmFault(FaultReason, Option<String>),
    /// The arm left its enabled state.
    #[error("the arm is not enabled but {0:?}")]
    ArmNotEnabled(ArmMode),
    /// The ROS node was asked to end, or lost its name.
    #[error("{0}")]
    NodeEnded(String),
    /// The arm refused a command, or its feedback failed.
    #[error("{0}")]
    Device(String),
    /// No encoder reading for too long.
    #[error("no encoder reading for {age_s:.3} s")]
    EncoderTimeout {
        /// Age of the newest reading \[s\].
        age_s: f64,
    },
    /// A joint position or rate is no number.
    #[error("a joint position or rate is not finite")]
    NonFinite,
    /// The base is faster than it was told to be.
    #[error("the base moves at {speed_mm_s:.1} mm/s, bound {bound_mm_s:.1} mm/s")]
    TooFast {
        /// Measured speed \[mm/s\].
        speed_mm_s: f64,
        /// The bound \[mm/s\].
        bound_mm_s: f64,
    },
    /// The base left the recorded path.
    #[error("the base left the recorded path by {distance_mm:.1} mm and {tilt_deg:.1} deg")]
    OffPath {
        /// Distance from the leg that is driven \[mm\].
        distance_mm: f64,
        /// Tilt from it \[deg\].
        tilt_deg: f64,
    },
    /// The base does not come back.
    #[error("the base came no further back for {seconds:.0} s, {left_mm:.1} mm before the start")]
    NoProgress {
        /// For how long \[s\].
        seconds: f64,
        /// Way left to the start \[mm\].
        left_mm: f64,
    },
}

/// The figures of a withdrawal, as `withdraw --json` prints them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The verdict.
    pub ended: Verdict,
    /// Log of the insertion, where there is one.
    pub insertion: Option<String>,
    /// Way that the base drove back \[mm\].
    pub withdrawn_mm: f64,
    /// Way left to the start \[mm\].
    pub left_mm: f64,
    /// Part of the way that was not recorded, and was driven straight \[mm\].
    pub gap_mm: f64,
    /// Largest distance of the base from the recorded path \[mm\].
    pub off_path_mm: f64,
    /// True depth of the tip below the surface at the end \[mm\], negative above it; null
    /// without truth.
    pub tip_depth_mm: Option<f64>,
    /// Duration \[s\].
    pub duration_s: f64,
    /// Commands computed.
    pub steps: u64,
    /// Whether all of it could be logged.
    pub log_complete: bool,
    /// Folder of the results, where they were written.
    pub out: Option<String>,
    /// The log, where one was written.
    pub log: Option<String>,
}
