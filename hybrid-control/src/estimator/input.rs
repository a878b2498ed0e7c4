//! What the estimator is told, and what it answers to that.

use hal::Stamp;
use nalgebra::{Isometry3, Point3, Unit, Vector3};

pub use super::unseen::TipSensor;
use crate::view::Entry;

/// What is known at the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Free length of the needle from its base to O \[m\].
    pub length: f64,
    /// Bending stiffness E I \[N m2\].
    pub bending_stiffness: f64,
    /// Distance from O to the cutting edge, the length of the bevel \[m\].
    pub cutting_edge: f64,
    /// Distance of a guide's exit from the surface along the insertion \[m\], where the needle slides
    /// in one; its direction and place across are the base's.
    pub guide_gap: Option<f64>,
    /// Where a sensor of the tip alone measures: its lasting errors. Support, stiffness and they are
    /// then estimated from the tip; else points of the shaft tell.
    pub tip_sensor: Option<TipSensor>,
    /// Whether the base's place along the needle is told by the tip, as where a hand pushes it: then the
    /// tip is a needle's length ahead of it, however the needle is bent.
    pub advance_by_tip: bool,
    /// The entry.
    pub entry: Entry,
    /// Pose of the base with the tip at the surface, or at the present depth.
    pub world_from_base: Isometry3<f64>,
}

/// Why an estimator cannot start.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum EstimatorError {
    /// A number is not positive and finite.
    #[error("{quantity} is {value}; a positive, finite number is needed")]
    NotPositive {
        /// What it is.
        quantity: &'static str,
        /// Its value.
        value: f64,
    },
    /// The needle does not point into the tissue.
    #[error(
        "the needle's axis is {angle_deg} degrees off the surface's normal; at most 60 are possible"
    )]
    Askew {
        /// Angle between needle and normal \[deg\].
        angle_deg: f64,
    },
}

/// One measurement of the needle, everything in World.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// Exposure.
    pub stamp: Stamp,
    /// Base pose at the exposure.
    pub world_from_base: Isometry3<f64>,
    /// The tip O \[m\].
    pub position: Point3<f64>,
    /// Its standard deviation across the axis \[m\].
    pub position_sigma: f64,
    /// Tip axis.
    pub direction: Unit<Vector3<f64>>,
    /// Its standard deviation, per axis \[rad\].
    pub direction_sigma: f64,
    /// Visible points of the shaft and their standard deviations \[m\]; may be empty.
    pub shaft: &'a [(Point3<f64>, f64)],
    /// Whether the tissue carries the tip, as far as the needle alone shows: what its motion leaves
    /// in the measurements says nothing about how the tip yields to forces.
    pub carried: bool,
}

/// What became of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Health {
    /// Taken in.
    Used,
    /// Not newer than the one before.
    Stale,
    /// Holds a number that is not finite, or no spread.
    Rejected,
}
