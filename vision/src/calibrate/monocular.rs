//! One camera alone.

use nalgebra::{Isometry3, Point2, SVector, Vector6};

use super::bundle::{Block, Bundle, Minimum, NoMinimum, minimise};
use super::normal::{INTRINSICS, Observed, accumulate, stepped};
use super::zhang;
use crate::camera::{Camera, LensModel};

/// A camera and the boards that it saw.
#[derive(Clone, Debug)]
pub(super) struct Monocular<'a> {
    pub camera: Camera,
    pub camera_from_board: Vec<Isometry3<f64>>,
    pub board: &'a [Point2<f64>],
    pub observed: &'a [Observed],
    pub huber_px: f64,
}

impl Bundle<INTRINSICS> for Monocular<'_> {
    fn linearise(&self) -> Option<(Vec<Block<INTRINSICS>>, f64)> {
        let mut blocks = Vec::with_capacity(self.observed.len());
        let mut cost = 0.0;
        for (pose, observed) in self.camera_from_board.iter().zip(self.observed) {
            let n = accumulate(&self.camera, pose, self.board, observed, self.huber_px)?;
            cost += n.cost;
            blocks.push(Block {
                u: n.ii,
                w: n.ip,
                v: n.pp,
                gs: n.gi,
                gv: n.gp,
            });
        }
        Some((blocks, cost))
    }

    fn stepped(&self, shared: &SVector<f64, INTRINSICS>, poses: &[Vector6<f64>]) -> Self {
        Self {
            camera: moved(&self.camera, shared.as_slice()),
            camera_from_board: self
                .camera_from_board
                .iter()
                .zip(poses)
                .map(|(p, s)| stepped(p, s))
                .collect(),
            ..*self
        }
    }
}

/// A camera with its intrinsics moved by the first twelve of `step`.
pub(super) fn moved(camera: &Camera, step: &[f64]) -> Camera {
    let mut p = camera.intrinsics();
    for (value, s) in p.iter_mut().zip(step) {
        *value += s;
    }
    camera.with_intrinsics(&p)
}

/// Fits a camera to its boards: from Zhang's closed form, or a fisheye from the best of a few
/// focal lengths. The rational model starts where Brown-Conrady ends.
pub(super) fn fit<'a>(
    board: &'a [Point2<f64>],
    observed: &'a [Observed],
    image_size: (usize, usize),
    lens: LensModel,
    huber_px: f64,
) -> Result<Minimum<Monocular<'a>, INTRINSICS>, NoMinimum> {
    let start = match lens {
        LensModel::Equidistant => zhang::fisheye_start(board, observed, image_size),
        _ => zhang::start(board, observed, image_size),
    };
    let mut start = start.ok_or(NoMinimum::Singular)?;
    if lens == LensModel::RadTan {
        start.camera.distortion.model = lens;
    }
    let found = minimise(Monocular {
        camera: start.camera,
        camera_from_board: start.camera_from_board,
        board,
        observed,
        huber_px,
    })?;
    if lens != LensModel::RationalPolynomial {
        return Ok(found);
    }
    let mut rational = found.bundle;
    rational.camera.distortion.model = lens;
    minimise(rational)
}
