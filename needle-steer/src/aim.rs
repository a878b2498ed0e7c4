//! Where a run goes: the target of a configuration, and the answer to one that somebody gives.

use hal::frame::{LeftCamera, World};
use hal::{Position, Transform};
use hybrid_control::{Reach, Unreachable};
use nalgebra::{Isometry3, Vector3};

use crate::config::{Config, TargetKind};
use crate::rig::Misfit;
use crate::world::place_target;

/// How a target that is taken lies to the tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aimed {
    /// Ahead of the tip along its axis \[m\].
    pub ahead: f64,
    /// Beside that axis \[m\].
    pub aside: f64,
    /// What steering has to give, and can; nothing where that was not asked.
    pub reach: Option<Reach>,
}

impl std::fmt::Display for Aimed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (ahead, aside) = (self.ahead * 1e3, self.aside * 1e3);
        write!(
            f,
            "aiming there: {ahead:.1} mm ahead of the tip, {aside:.1} mm beside its axis"
        )
    }
}

/// Why a target is refused. The run keeps the one that it has.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TargetRefused {
    /// No point, behind the tip, or out of reach from where needle and base are.
    #[error(transparent)]
    Unreachable(#[from] Unreachable),
    /// The needle's base would have to leave the box that it may use.
    #[error(
        "the needle's base would have to leave its box by {by_mm:.1} mm to get there \
         (supervisor.workspace_min_mm, workspace_max_mm)"
    )]
    Workspace {
        /// How far \[mm\].
        by_mm: f64,
    },
    /// The arm comes to an end on the way.
    #[error(transparent)]
    Arm(Misfit),
    /// The target is the marker of the tissue.
    #[error(
        "the target is the marker of the tissue (target.kind = \"marker\"), which the run follows"
    )]
    Marker,
    /// No insertion is under way that could go there.
    #[error("the insertion has ended")]
    Ended,
}

/// What becomes of a target that was given.
pub type Answer = Result<Aimed, TargetRefused>;

/// The configuration's target in the stereo frame, where it is given as a point.
pub(crate) fn given_target(
    config: &Config,
    left_from_world: &Transform<LeftCamera, World>,
) -> Option<Position<LeftCamera>> {
    let point = config.target.point();
    match config.target.kind {
        TargetKind::Stereo => Some(Position::new(point)),
        TargetKind::World => Some(*left_from_world * Position::new(point)),
        TargetKind::Aligned | TargetKind::Shifted | TargetKind::Marker => None,
    }
}

/// Aligned or shifted target from a tip and the holder's pose, World \[m\].
pub(crate) fn nominal_target(
    config: &Config,
    tip: &Vector3<f64>,
    world_from_holder: &Isometry3<f64>,
) -> Vector3<f64> {
    let t = &config.target;
    let offset = if t.kind == TargetKind::Aligned {
        0.0
    } else {
        t.offset_mm * 1e-3
    };
    place_target(
        tip,
        &Transform::assume(*world_from_holder),
        t.depth_mm * 1e-3,
        offset,
        t.angle_deg.to_radians(),
    )
}
