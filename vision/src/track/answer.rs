//! What the tracker is told and what it answers.

use hal::frame::LeftCamera;
use hal::telemetry::Tracking;
use hal::{Position, SensedShape, SensedTip, Stamp};
use nalgebra::{Isometry3, Matrix3, Point3, Vector2, Vector3};

use super::curve::Curve2;
use super::single::Flaw;

/// Points of the shaft that are handed on.
pub(super) const POINTS: usize = 24;

/// What is known of the needle when a pair arrives.
#[derive(Clone, Copy, Debug, Default)]
pub struct Context<'a> {
    /// Rigid motion of the needle's base since the previous pair, in the stereo frame.
    pub base_motion: Option<Isometry3<f64>>,
    /// Advance along the needle since the previous pair \[m\]; without, it is estimated.
    pub insertion: Option<f64>,
    /// Direction in which the bevel's point lies off the axis, in the stereo frame; without, it
    /// is found in the images.
    pub bevel: Option<Vector3<f64>>,
    /// The needle as predicted, from where it comes into sight to its tip, in the stereo frame;
    /// used to start and after losses. Empty: not in sight yet, what is seen is background.
    /// Without, images are searched.
    pub guess: Option<&'a [Point3<f64>]>,
}

/// Why the needle is not tracked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// It was not found yet, or not again.
    NotFound,
    /// An image shows no band that could be a needle.
    NoBand {
        /// Which image: 0 for the left, 1 for the right.
        image: usize,
    },
    /// Both images show bands, of which no two are of one needle.
    NoMatch {
        /// Bands in the left and in the right image.
        bands: [usize; 2],
    },
    /// The bands that match stand out too little to be a needle.
    Faint {
        /// How far, relative to the most that their surroundings allow.
        share: f64,
    },
    /// The band that is most like a needle is none.
    Start {
        /// Which image: 0 for the left, 1 for the right.
        image: usize,
        /// What is wrong with it.
        flaw: Flaw,
    },
    /// In the left image.
    Left(Flaw),
    /// In the right image.
    Right(Flaw),
    /// The images disagree about the tip, by so much along the needle \[px\].
    Disagreement {
        /// Half the difference \[px\].
        px: f64,
    },
    /// Rays of the two images do not meet in a needle.
    NoCurve,
}

/// The tracker's answer to a pair.
#[derive(Clone, Debug)]
pub struct Tracked {
    /// Whether the needle was measured, carried on by prediction, or lost.
    pub status: Tracking,
    /// What is wrong, if it was not measured.
    pub loss: Option<Loss>,
    /// Shape in space; as last known if the needle is lost.
    pub shape: SensedShape,
    /// The sharp point, where a bevel is modelled and its turn known; else O.
    pub point: Position<LeftCamera>,
    /// Curves in the left and the right image; nothing before the first start.
    pub curves: [Option<Curve2>; 2],
    /// Bands in the left and the right image that were considered, as polygons \[px\]; nothing where
    /// the needle was measured without a search.
    pub considered: [Vec<Vec<Vector2<f64>>>; 2],
}

/// Before anything was seen.
pub(super) fn unseen() -> Tracked {
    Tracked {
        status: Tracking::None,
        loss: Some(Loss::NotFound),
        shape: SensedShape {
            stamp: Stamp::ZERO,
            sequence: 0,
            points: Vec::with_capacity(POINTS),
            tip: SensedTip {
                position: Position::new(Point3::origin()),
                covariance: Matrix3::identity(),
                direction: Vector3::z_axis(),
                direction_sigma: core::f64::consts::PI,
            },
        },
        point: Position::new(Point3::origin()),
        curves: [None; 2],
        considered: [Vec::new(), Vec::new()],
    }
}
