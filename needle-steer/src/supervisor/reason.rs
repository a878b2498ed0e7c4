//! Why a run was stopped.

use hal::{ArmMode, FaultReason};
use serde::Serialize;

use crate::monitor::Stalled;
use crate::monitor::plausibility::Implausible;
use crate::outcome::Cause;

/// Why the supervisor stopped the run; latched until the run ends.
#[derive(Clone, Debug, PartialEq, Serialize, thiserror::Error)]
#[serde(tag = "reason", rename_all = "snake_case")]
pub enum StopReason {
    /// The arm faulted.
    #[error("the arm faulted: {}", in_words(*fault, words.as_deref()))]
    ArmFault {
        /// The arm's own reason.
        fault: FaultReason,
        /// The same with its figures, where the arm knows them.
        words: Option<String>,
    },
    /// The arm left its enabled state.
    #[error("the arm is not enabled but {mode:?}")]
    ArmNotEnabled {
        /// The arm's mode.
        mode: ArmMode,
    },
    /// No encoder reading for too long.
    #[error("no encoder reading for {age_s:.3} s")]
    EncoderTimeout {
        /// Age of the newest reading \[s\].
        age_s: f64,
    },
    /// No image for too long.
    #[error("no image for {age_s:.3} s{}", problem.as_ref().map(|p| format!(": {p}")).unwrap_or_default())]
    ImageTimeout {
        /// Age of the newest image \[s\].
        age_s: f64,
        /// What keeps images from coming, where the cameras know it.
        problem: Option<String>,
    },
    /// Images came, but no needle was found in them for too long.
    #[error("the needle was not found in the images for {age_s:.3} s: {problem}")]
    NeedleLost {
        /// Age of the newest image in which it was \[s\].
        age_s: f64,
        /// Why it was not found in the newest image.
        problem: String,
    },
    /// Every measurement comes too late.
    #[error(
        "measurements are {age_s:.2} s old when they arrive; the bound is {bound_s:.2} s (supervisor.image_age_ms)"
    )]
    MeasurementsLate {
        /// Age of the newest at its arrival \[s\].
        age_s: f64,
        /// The bound \[s\].
        bound_s: f64,
    },
    /// Every measurement is stamped ahead of the run's clock.
    #[error(
        "measurements are stamped {by_s:.2} s ahead of this machine's clock: set the clocks of both machines"
    )]
    MeasurementsAhead {
        /// How far ahead \[s\].
        by_s: f64,
    },
    /// The measurements cannot be of this needle.
    #[error("{problem}")]
    Implausible {
        /// What is wrong with the newest.
        problem: Implausible,
    },
    /// The tip stays behind the base.
    #[error(
        "the base advanced by {:.1} mm, the measured tip by {:.1} mm: the shaft buckles or the tip is held",
        stalled.base_m * 1e3,
        stalled.tip_m * 1e3
    )]
    Stall {
        /// What was measured.
        #[serde(flatten)]
        stalled: Stalled,
    },
    /// The springs model has no equilibrium.
    #[error("the needle model has no equilibrium for {for_s:.1} s: {problem}")]
    ModelFailed {
        /// For how long \[s\].
        for_s: f64,
        /// The model's words.
        problem: String,
    },
    /// The measured shaft lies elsewhere than the model's: its load of the tissue cannot be told.
    #[error(
        "the measured shaft lies {:.1} mm beside the model's: that the tissue is stretched by {:.1} mm cannot be told",
        off_m * 1e3,
        stretch_m * 1e3
    )]
    ModelContradicted {
        /// Distance of the measured shaft from the model's \[m\].
        off_m: f64,
        /// The model's largest stretch \[m\].
        stretch_m: f64,
    },
    /// Estimate and measurement disagree about where the tip is.
    #[error(
        "the estimated tip has passed the target, the measured one is {:.1} mm in front of it",
        ahead_m * 1e3
    )]
    Disagreement {
        /// Target ahead of the measured tip \[m\].
        ahead_m: f64,
    },
    /// The tip is measured elsewhere than it is estimated where the target is passed.
    #[error("the measured tip lies {:.1} mm from the estimated one at the target", off_m * 1e3)]
    TipApart {
        /// How far \[m\].
        off_m: f64,
    },
    /// The needle is not in the tissue where it passes the target.
    #[error("the needle passed the target outside the tissue")]
    OutsideTissue,
    /// The tissue moves more than is known of it: its load cannot be told.
    #[error("the tissue carries the tip by {:.1} mm and more than can be followed", by_m * 1e3)]
    TissueMotion {
        /// Way of the tip that only moving tissue explains \[m\].
        by_m: f64,
    },
    /// Tissue stretched too far.
    #[error("tissue stretched by {:.2} mm, bound {:.2} mm", value_m * 1e3, bound_m * 1e3)]
    TissueStretch {
        /// The model's largest stretch \[m\].
        value_m: f64,
        /// The bound \[m\].
        bound_m: f64,
    },
    /// The shaft left the path that its tip cut.
    #[error(
        "the measured shaft lies {:.1} mm beside where its tip went, bound {:.1} mm: the tissue is stretched or torn",
        off_m * 1e3,
        bound_m * 1e3
    )]
    ShaftAside {
        /// Its largest distance from that, less what the tissue moves by itself \[m\].
        off_m: f64,
        /// The bound \[m\].
        bound_m: f64,
    },
    /// Lateral force at the entry too high.
    #[error("lateral force at the entry {value_n:.2} N, bound {bound_n:.2} N")]
    EntryForce {
        /// The model's force \[N\].
        value_n: f64,
        /// The bound \[N\].
        bound_n: f64,
    },
    /// The needle's base left the workspace.
    #[error(
        "needle base {:.1} mm from the nominal axis, bound {:.1} mm",
        distance_m * 1e3,
        bound_m * 1e3
    )]
    Workspace {
        /// Distance of the base from the axis \[m\].
        distance_m: f64,
        /// The bound \[m\].
        bound_m: f64,
    },
    /// The needle's base swings, whatever it was sent.
    #[error(
        "needle base moves across its axis at {:.1} mm/s, bound {:.1} mm/s",
        speed_m_s * 1e3,
        bound_m_s * 1e3
    )]
    BaseSpeed {
        /// Its speed by the encoders \[m/s\].
        speed_m_s: f64,
        /// The bound \[m/s\].
        bound_m_s: f64,
    },
    /// The dead-man's switch was let go.
    #[error("dead-man's switch released for {age_s:.3} s")]
    DeadMan {
        /// Age of the newest token \[s\].
        age_s: f64,
    },
    /// The needle's base was held at the box that it may use.
    #[error("held at the workspace box for {held_s:.1} s")]
    WorkspaceBox {
        /// For how long \[s\].
        held_s: f64,
    },
    /// A non-finite number in the state or the command.
    #[error("a non-finite number in {place}")]
    NonFinite {
        /// Where it was.
        place: &'static str,
    },
}

/// A fault of the arm with what the arm says of it.
pub(crate) fn in_words(fault: FaultReason, words: Option<&str>) -> String {
    words.map_or_else(
        || format!("{fault:?}"),
        |words| format!("{fault:?}: {words}"),
    )
}

impl StopReason {
    /// The same with the arm's words, if it is a fault of the arm.
    #[must_use]
    pub fn explained(self, by_arm: Option<String>, by_cameras: Option<String>) -> Self {
        match self {
            Self::ImageTimeout { age_s, problem } => Self::ImageTimeout {
                age_s,
                problem: problem.or(by_cameras),
            },
            Self::ArmFault { fault, words } => Self::ArmFault {
                fault,
                words: words.or(by_arm),
            },
            other => other,
        }
    }

    /// Which of the causes it is.
    pub const fn cause(&self) -> Cause {
        match self {
            Self::ArmFault { .. }
            | Self::ArmNotEnabled { .. }
            | Self::EncoderTimeout { .. }
            | Self::BaseSpeed { .. }
            | Self::Workspace { .. }
            | Self::WorkspaceBox { .. } => Cause::Device,
            Self::ImageTimeout { .. }
            | Self::MeasurementsLate { .. }
            | Self::MeasurementsAhead { .. } => Cause::MeasurementsLate,
            Self::Implausible {
                problem: Implausible::Snap { .. },
            } => Cause::Buckling,
            Self::NeedleLost { .. } | Self::Implausible { .. } => Cause::NeedleLost,
            Self::TissueStretch { .. } | Self::ShaftAside { .. } | Self::EntryForce { .. } => {
                Cause::Tear
            }
            Self::Stall { .. } => Cause::Stall,
            Self::TissueMotion { .. } => Cause::TissueMotion,
            Self::ModelFailed { .. }
            | Self::ModelContradicted { .. }
            | Self::NonFinite { .. }
            | Self::Disagreement { .. }
            | Self::TipApart { .. }
            | Self::OutsideTissue => Cause::ModelFailed,
            Self::DeadMan { .. } => Cause::Operator,
        }
    }
}
