//! Calibration from boards of known size.
//!
//! Zhang's closed form starts two monocular fits, these start the joint bundle over both
//! cameras, their relative pose and every board pose \[Zhang2000\]. Corners and views that do not
//! fit are rejected by name. All parameters come with a covariance.

mod bundle;
mod determined;
mod mono;
mod monocular;
mod normal;
mod rectify;
mod stereo;
mod zhang;

pub use mono::{BoardView, MonoCalibration, calibrate_mono};
pub use rectify::{Rectification, RectifiedDy, rectified_dy, rectify};
pub use stereo::{
    BoardPair, CalibrationError, Influence, RejectReason, Rejected, StereoCalibration,
    StereoOptions, ViewFit, assumed_covariance, calibrate_stereo,
};

use nalgebra::Point2;

use crate::detect::{BoardKind, BoardSize};

/// Sides that a board's squares have \[mm\]: from those under a microscope to those on a wall. A side
/// outside is most likely in another unit.
pub const SQUARES_MM: (f64, f64) = (0.2, 500.0);

/// How a board's points lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// In columns and rows.
    #[default]
    Square,
    /// Every other row shifted by half the distance of its points, which is two rows' distance.
    Staggered,
}

/// A board's points.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Board {
    /// Its columns and rows of points: a chessboard's inner corners.
    pub size: BoardSize,
    /// Distance of its rows \[m\]: a square's side.
    pub square: f64,
    /// How they lie.
    #[serde(default)]
    pub layout: Layout,
}

/// Width and height of the left and the right camera's images \[px\].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageSizes(pub [(usize, usize); 2]);

impl From<(usize, usize)> for ImageSizes {
    fn from(both: (usize, usize)) -> Self {
        Self([both; 2])
    }
}

impl From<[(usize, usize); 2]> for ImageSizes {
    fn from(sizes: [(usize, usize); 2]) -> Self {
        Self(sizes)
    }
}

impl Board {
    /// A board of a kind, with its rows' distance \[m\].
    pub const fn new(kind: &BoardKind, square: f64) -> Self {
        Self {
            size: kind.size(),
            square,
            layout: match kind {
                BoardKind::Circles(_) => Layout::Staggered,
                BoardKind::Chessboard(_) | BoardKind::Charuco(_) => Layout::Square,
            },
        }
    }

    /// Points in the board's plane, row-major \[m\].
    pub fn points(&self) -> Vec<Point2<f64>> {
        let at = |k: usize| k as f64 * self.square;
        let column = |c: usize, r: usize| match self.layout {
            Layout::Square => c,
            Layout::Staggered => 2 * c + r % 2,
        };
        self.size
            .indices()
            .map(|(c, r)| Point2::new(at(column(c, r)), at(r)))
            .collect()
    }
}
