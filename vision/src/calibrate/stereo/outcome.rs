//! What a calibration says about itself.

use core::fmt;

use hal::Transform;
use hal::frame::{Board as BoardFrame, LeftCamera};
use nalgebra::{DMatrix, DVector, Isometry3, SMatrix, SVector, Vector2};

use super::super::bundle::{Minimum, inverse, reduced};
use super::super::monocular::Monocular;
use super::super::normal::{INTRINSICS, Observed, residuals};
use super::super::{Board, RectifiedDy};
use super::BoardPair;
use super::joint::{Joint, SHARED};
use super::reject::rms;
use crate::camera::StereoRig;

/// A calibrated rig and how well it is known.
#[derive(Clone, Debug)]
pub struct StereoCalibration {
    /// The rig, without a container.
    pub rig: StereoRig,
    /// The board.
    pub board: Board,
    /// Covariance of the parameters: left fx fy cx cy and the lens model's coefficients
    /// (k1 k2 p1 p2 k3), the right camera's, translation \[m\] and rotation \[rad\] of
    /// right-from-left, both along the right camera's axes.
    pub covariance: DMatrix<f64>,
    /// Standard deviation of a corner, per axis, that the residuals imply \[px\].
    pub corner_sigma_px: f64,
    /// RMS over the corners of both cameras of their distance from the joint fit \[px\].
    pub joint_rms_px: f64,
    /// The same of the left camera fitted alone \[px\].
    pub left_rms_px: f64,
    /// The same of the right camera fitted alone \[px\].
    pub right_rms_px: f64,
    /// Vertical differences of corresponding corners in rectified images.
    pub rectified_dy: RectifiedDy,
    /// The pairs that count.
    pub views: Vec<ViewFit>,
    /// What does not count, and why.
    pub rejected: Vec<Rejected>,
    /// Iterations of the left, right and joint fits.
    pub iterations: [usize; 3],
}

/// One pair in the joint fit.
#[derive(Clone, Debug)]
pub struct ViewFit {
    /// Left image.
    pub left_name: String,
    /// Right image.
    pub right_name: String,
    /// The board's pose.
    pub left_from_board: Transform<LeftCamera, BoardFrame>,
    /// Corners of the left and right image, row-major \[px\]; NaN where one is not seen.
    pub corners: [Vec<nalgebra::Point2<f64>>; 2],
    /// Observed minus fitted, left and right, row-major; `None` for rejected corners \[px\].
    pub residuals: [Vec<Option<Vector2<f64>>>; 2],
    /// RMS of the corners' distances, left and right \[px\].
    pub rms_px: [f64; 2],
    /// What leaving this pair out would change.
    pub influence: Influence,
}

/// How far one pair pulls the result (first order), in sigmas of the result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Influence {
    /// Greatest change of an intrinsic parameter over its sigma.
    pub intrinsics_sigmas: f64,
    /// Greatest change of the relative pose over its sigma.
    pub extrinsics_sigmas: f64,
}

/// A pair, or one corner of it, that does not count.
#[derive(Clone, Debug, PartialEq)]
pub struct Rejected {
    /// Left image.
    pub left: String,
    /// Right image.
    pub right: String,
    /// Why.
    pub reason: RejectReason,
}

/// Why something does not count.
#[derive(Clone, Debug, PartialEq)]
pub enum RejectReason {
    /// An image shows no whole board.
    NoBoard {
        /// The image.
        image: String,
        /// What the detection said.
        why: String,
    },
    /// A corner is not where the others of its board put it.
    FalseCorner {
        /// The image.
        image: String,
        /// Index of the corner, row-major.
        corner: usize,
        /// Distance from where it should be.
        distance_px: f64,
    },
    /// A view that the others contradict: by its RMS, or by many corners beyond their limit.
    View {
        /// RMS of the worse of its two images.
        rms_px: f64,
        /// Limit of that RMS.
        limit_px: f64,
    },
    /// A corner that the fit contradicts; the rest of the pair counts.
    Corner {
        /// The image.
        image: String,
        /// Index of the corner, row-major.
        corner: usize,
        /// Its residual.
        distance_px: f64,
        /// Limit that it exceeds.
        limit_px: f64,
    },
}

impl fmt::Display for Rejected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.reason {
            RejectReason::NoBoard { image, why } => write!(f, "{image}: {why}"),
            RejectReason::FalseCorner {
                image,
                corner,
                distance_px,
            } => write!(
                f,
                "{image}: corner {corner} lies {distance_px:.2} px from where the others put it"
            ),
            RejectReason::View { rms_px, limit_px } => write!(
                f,
                "{} and {}: the others contradict them (RMS {rms_px:.2} px, limit {limit_px:.2} px)",
                self.left, self.right
            ),
            RejectReason::Corner {
                image,
                corner,
                distance_px,
                limit_px,
            } => write!(
                f,
                "{image}: corner {corner} misses the fit by {distance_px:.2} px, more than \
                 {limit_px:.2} px"
            ),
        }
    }
}

impl StereoCalibration {
    /// Standard deviations of the parameters, in the covariance's order.
    pub fn sigmas(&self) -> DVector<f64> {
        self.covariance.diagonal().map(f64::sqrt)
    }

    /// Correlation of two parameters of the covariance.
    pub fn correlation(&self, i: usize, j: usize) -> f64 {
        let c = &self.covariance;
        c[(i, j)] / (c[(i, i)] * c[(j, j)]).sqrt()
    }

    /// RMS of the worst image \[px\].
    pub fn worst_image_rms_px(&self) -> f64 {
        self.views.iter().flat_map(|v| v.rms_px).fold(0.0, f64::max)
    }
}

/// Collects the outcome; `None` if the covariance does not exist.
pub(super) fn outcome(
    board: &Board,
    rig: &StereoRig,
    joint: &Minimum<Joint<'_>, SHARED>,
    mono: [&Minimum<Monocular<'_>, INTRINSICS>; 2],
    pairs: &[&BoardPair],
    rectified_dy: RectifiedDy,
    rejected: Vec<Rejected>,
) -> Option<StereoCalibration> {
    let bundle = &joint.bundle;
    let mut information = SMatrix::<f64, SHARED, SHARED>::zeros();
    let mut per_view = Vec::with_capacity(pairs.len());
    for block in &joint.blocks {
        let one = reduced(block)?;
        information += one.0;
        per_view.push(one);
    }
    let unit = inverse(&information)?;
    let corners = count(bundle.observed[0]) + count(bundle.observed[1]);
    let parameters = used_parameters(rig).len() + 6 * pairs.len();
    let freedom = (2 * corners).checked_sub(parameters).filter(|&f| f > 0)?;
    let variance = joint.cost / freedom as f64;
    let covariance = unit * variance;
    let sigma = covariance.diagonal().map(f64::sqrt);
    let used = used_parameters(rig);

    let mut views = Vec::with_capacity(pairs.len());
    for (k, pair) in pairs.iter().enumerate() {
        let pose = &bundle.left_from_board[k];
        let right: Isometry3<f64> = bundle.right_from_left * pose;
        let fitted = [
            kept(
                residuals(&bundle.left, pose, bundle.board, &pair.left),
                &bundle.observed[0][k],
            ),
            kept(
                residuals(&bundle.right, &right, bundle.board, &pair.right),
                &bundle.observed[1][k],
            ),
        ];
        let rms_px = [0, 1].map(|s: usize| {
            let lengths: Vec<f64> = fitted[s].iter().flatten().map(Vector2::norm).collect();
            rms(lengths.iter())
        });
        // The others' minimum to first order: what remains of the gradient without this view.
        let without = inverse(&(information - per_view[k].0));
        let change = without.map_or_else(
            || SVector::repeat(f64::INFINITY),
            |c| {
                let change = c * -per_view[k].1;
                // Parameters that the lens model does not use neither change nor vary.
                change.zip_map(&sigma, |c, s| if s > 0.0 { c / s } else { 0.0 })
            },
        );
        views.push(ViewFit {
            left_name: pair.left_name.clone(),
            right_name: pair.right_name.clone(),
            left_from_board: Transform::assume(*pose),
            corners: [pair.left.clone(), pair.right.clone()],
            residuals: fitted,
            rms_px,
            influence: Influence {
                intrinsics_sigmas: change.fixed_rows::<{ 2 * INTRINSICS }>(0).amax(),
                extrinsics_sigmas: change.fixed_rows::<6>(2 * INTRINSICS).amax(),
            },
        });
    }
    let mono_rms = |m: &Minimum<Monocular<'_>, INTRINSICS>| {
        (m.cost / count(m.bundle.observed).max(1) as f64).sqrt()
    };
    Some(StereoCalibration {
        rig: *rig,
        board: *board,
        covariance: DMatrix::from_fn(used.len(), used.len(), |i, j| {
            covariance[(used[i], used[j])]
        }),
        corner_sigma_px: variance.sqrt(),
        joint_rms_px: (joint.cost / corners.max(1) as f64).sqrt(),
        left_rms_px: mono_rms(mono[0]),
        right_rms_px: mono_rms(mono[1]),
        rectified_dy,
        views,
        rejected,
        iterations: [mono[0].iterations, mono[1].iterations, joint.iterations],
    })
}

/// Which of the joint fit's parameters the lens models use, and the six of the relative pose.
pub(super) fn used_parameters(rig: &StereoRig) -> Vec<usize> {
    let left = rig.left.distortion.model.used().iter().copied();
    let right = rig.right.distortion.model.used().iter();
    left.chain(right.map(|k| INTRINSICS + k))
        .chain(2 * INTRINSICS..SHARED)
        .collect()
}

fn kept(residuals: Vec<Vector2<f64>>, observed: &Observed) -> Vec<Option<Vector2<f64>>> {
    residuals
        .into_iter()
        .zip(observed)
        .map(|(r, o)| o.map(|_| r))
        .collect()
}

fn count(observed: &[Observed]) -> usize {
    observed.iter().flatten().flatten().count()
}
