//! Stereo calibration from chessboards of known size.
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
    StereoOptions, ViewFit, calibrate_stereo,
};

use nalgebra::Point2;

use crate::detect::BoardSize;

/// A chessboard.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Board {
    /// Its inner corners.
    pub size: BoardSize,
    /// Side of a square \[m\].
    pub square: f64,
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
    /// Corners in the board's plane, row-major \[m\].
    pub fn points(&self) -> Vec<Point2<f64>> {
        let at = |k: usize| k as f64 * self.square;
        self.size
            .indices()
            .map(|(c, r)| Point2::new(at(c), at(r)))
            .collect()
    }
}
