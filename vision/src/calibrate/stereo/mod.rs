//! From labelled corners of both cameras to a calibrated rig.

mod joint;
mod outcome;
mod reject;

pub use outcome::{Influence, RejectReason, Rejected, StereoCalibration, ViewFit};

use core::fmt::Write as _;

use hal::Transform;
use nalgebra::{Isometry3, Point2, SMatrix};

use super::bundle::{Minimum, NoMinimum, minimise};
use super::monocular::{Monocular, fit};
use super::normal::{INTRINSICS, Observed};
use super::{Board, bundle, rectified_dy, zhang};
use crate::camera::StereoRig;
use crate::detect::irregular_corner;
use joint::Joint;

/// The corners of one board in a pair of images.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardPair {
    /// What the left image is called in reports: its file.
    pub left_name: String,
    /// What the right image is called in reports.
    pub right_name: String,
    /// Corners in the left image, row-major \[px\].
    pub left: Vec<Point2<f64>>,
    /// Corners in the right image, row-major \[px\].
    pub right: Vec<Point2<f64>>,
}

/// Settings of a stereo calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoOptions {
    /// Residual beyond which a corner counts linearly instead of squared (Huber) \[px\]. Good
    /// corners stay well below, so that the result is their least squares.
    pub huber_px: f64,
    /// A corner is rejected when its residual exceeds this \[px\] and eight robust sigmas.
    pub corner_limit_px: f64,
    /// A view is rejected when its RMS exceeds this \[px\] and three times the median view's.
    pub view_limit_px: f64,
}

impl Default for StereoOptions {
    fn default() -> Self {
        Self {
            huber_px: 1.0,
            corner_limit_px: 1.0,
            view_limit_px: 0.5,
        }
    }
}

/// Why there is no calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// Fewer pairs than a calibration needs.
    #[error(
        "{usable} usable pairs of boards, at least 3 are needed{}",
        listed(rejected)
    )]
    TooFewViews {
        /// Usable pairs.
        usable: usize,
        /// Pairs that were rejected, and why.
        rejected: Vec<Rejected>,
    },
    /// The square's side is no length, or the board has too few corners.
    #[error("a board of {cols} x {rows} inner corners with squares of {square_m} m")]
    Board {
        /// Corners along a row.
        cols: usize,
        /// Corners along a column.
        rows: usize,
        /// Side of a square.
        square_m: f64,
    },
    /// A list of corners that is not the board's.
    #[error("{name}: {found} corners, the board has {expected}")]
    CornerCount {
        /// The image.
        name: String,
        /// Corners given.
        found: usize,
        /// Corners of the board.
        expected: usize,
    },
    /// The left and the right list begin at different ends of the board.
    #[error(
        "{left} and {right}: the boards are labelled differently (the relative pose of the \
         cameras differs by {difference_deg:.0} degrees from the other pairs')"
    )]
    Flipped {
        /// Left image.
        left: String,
        /// Right image.
        right: String,
        /// Angle to the other pairs' relative pose.
        difference_deg: f64,
    },
    /// The boards' orientations do not determine the cameras.
    #[error(
        "degenerate views: the {camera} camera saw the board tilted by at most {spread_deg:.1} \
         degrees between views (focal length known to {focal_sigma_percent:.1} %); tilt it by \
         20 to 45 degrees about both axes"
    )]
    Degenerate {
        /// `left` or `right`.
        camera: &'static str,
        /// Greatest angle between two boards' normals.
        spread_deg: f64,
        /// Standard deviation of the focal length over its value.
        focal_sigma_percent: f64,
    },
    /// The fit did not settle.
    #[error("the {stage} fit found no minimum: the corners contradict each other")]
    NoMinimum {
        /// `left`, `right` or `joint`.
        stage: &'static str,
    },
}

fn listed(rejected: &[Rejected]) -> String {
    rejected.iter().fold(String::new(), |mut list, r| {
        let _ = write!(list, "; {r}");
        list
    })
}

/// Calibrates both cameras and what lies between them.
///
/// `pairs` holds the labelled corners; `already_rejected` are pairs without them (a board that
/// was not found), carried into the report.
///
/// # Errors
/// See [`CalibrationError`].
pub fn calibrate_stereo(
    board: &Board,
    pairs: &[BoardPair],
    image_size: (usize, usize),
    already_rejected: Vec<Rejected>,
    options: &StereoOptions,
) -> Result<StereoCalibration, CalibrationError> {
    let mut rejected = already_rejected;
    let pairs = checked(board, pairs, &mut rejected)?;
    let points = board.points();
    let sides = [
        pairs.iter().map(|p| p.left.as_slice()).collect::<Vec<_>>(),
        pairs.iter().map(|p| p.right.as_slice()).collect(),
    ];
    let mut observed = [all_of(&sides[0]), all_of(&sides[1])];
    let mut used: Vec<usize> = (0..pairs.len()).collect();
    loop {
        if used.len() < 3 {
            return Err(CalibrationError::TooFewViews {
                usable: used.len(),
                rejected,
            });
        }
        let corners = [0, 1].map(|s: usize| used.iter().map(|&k| sides[s][k]).collect::<Vec<_>>());
        let kept = [0, 1].map(|s: usize| {
            used.iter()
                .map(|&k| observed[s][k].clone())
                .collect::<Vec<_>>()
        });
        let mono = |s: usize, stage| {
            fit(&points, &corners[s], &kept[s], image_size, options.huber_px)
                .map_err(|_: NoMinimum| no_fit(stage, &points, &corners[s], image_size))
        };
        let (left, right) = (mono(0, "left")?, mono(1, "right")?);
        well_posed("left", &left)?;
        well_posed("right", &right)?;
        let relative = relative_pose(&left, &right, &used, &pairs)?;
        let joint = minimise(Joint {
            left: left.bundle.camera,
            right: right.bundle.camera,
            right_from_left: relative,
            left_from_board: left.bundle.camera_from_board.clone(),
            board: &points,
            observed: [&kept[0], &kept[1]],
            huber_px: options.huber_px,
        })
        .map_err(|_| CalibrationError::NoMinimum { stage: "joint" })?;
        let found = reject::reject(&joint.bundle, &used, &pairs, &mut observed, options);
        if found.rejected.is_empty() {
            let rig = StereoRig {
                left: joint.bundle.left,
                right: joint.bundle.right,
                right_from_left: Transform::assume(joint.bundle.right_from_left),
                container: None,
            };
            let used_pairs: Vec<&BoardPair> = used.iter().map(|&k| &pairs[k]).collect();
            let dy = rectified_dy(&rig, used_pairs.iter().copied());
            return outcome::outcome(
                board,
                &rig,
                &joint,
                [&left, &right],
                &used_pairs,
                dy,
                rejected,
            )
            .ok_or(CalibrationError::NoMinimum { stage: "joint" });
        }
        rejected.extend(found.rejected);
        used.retain(|k| !found.views.contains(k));
    }
}

/// Refuses what is no board and sets aside pairs with a false corner.
fn checked(
    board: &Board,
    pairs: &[BoardPair],
    rejected: &mut Vec<Rejected>,
) -> Result<Vec<BoardPair>, CalibrationError> {
    let size = board.size;
    if size.cols < 3 || size.rows < 3 || !(board.square > 0.0 && board.square.is_finite()) {
        return Err(CalibrationError::Board {
            cols: size.cols,
            rows: size.rows,
            square_m: board.square,
        });
    }
    let mut good = Vec::with_capacity(pairs.len());
    'pairs: for pair in pairs {
        for (name, corners) in [
            (&pair.left_name, &pair.left),
            (&pair.right_name, &pair.right),
        ] {
            if corners.len() != size.count() {
                return Err(CalibrationError::CornerCount {
                    name: name.clone(),
                    found: corners.len(),
                    expected: size.count(),
                });
            }
            // Detection has its own, tighter check; corners may come from elsewhere.
            if let Some(false_corner) = irregular_corner(corners, size, 2.0) {
                rejected.push(Rejected {
                    left: pair.left_name.clone(),
                    right: pair.right_name.clone(),
                    reason: RejectReason::FalseCorner {
                        image: name.clone(),
                        corner: false_corner.corner,
                        distance_px: false_corner.distance_px,
                    },
                });
                continue 'pairs;
            }
        }
        good.push(pair.clone());
    }
    Ok(good)
}

fn all_of(corners: &[&[Point2<f64>]]) -> Vec<Observed> {
    corners
        .iter()
        .map(|c| c.iter().copied().map(Some).collect())
        .collect()
}

/// With less than five degrees between all boards, focal length and distance are hardly
/// separable \[rad\].
const LEAST_SPREAD: f64 = 0.087;

/// Greatest angle between two boards' normals.
fn normal_spread(camera_from_board: &[Isometry3<f64>]) -> f64 {
    let normal = |p: &Isometry3<f64>| p.rotation * nalgebra::Vector3::z();
    let mut spread = 0.0_f64;
    for (k, a) in camera_from_board.iter().enumerate() {
        for b in &camera_from_board[..k] {
            spread = spread.max(normal(a).angle(&normal(b)));
        }
    }
    spread
}

/// Why a monocular fit found no minimum: parallel views leave it a valley.
fn no_fit(
    camera: &'static str,
    board: &[Point2<f64>],
    corners: &[&[Point2<f64>]],
    image_size: (usize, usize),
) -> CalibrationError {
    let spread = zhang::start(board, corners, image_size)
        .map(|s| normal_spread(&s.camera_from_board))
        .filter(|&s| s < 2.0 * LEAST_SPREAD);
    match spread {
        Some(spread) => CalibrationError::Degenerate {
            camera,
            spread_deg: spread.to_degrees(),
            focal_sigma_percent: f64::INFINITY,
        },
        None => CalibrationError::NoMinimum { stage: camera },
    }
}

/// Refuses views that do not determine a camera.
fn well_posed(
    camera: &'static str,
    fit: &Minimum<Monocular<'_>, INTRINSICS>,
) -> Result<(), CalibrationError> {
    let spread = normal_spread(&fit.bundle.camera_from_board);
    let information = fit
        .blocks
        .iter()
        .try_fold(SMatrix::<f64, INTRINSICS, INTRINSICS>::zeros(), |sum, b| {
            Some(sum + bundle::reduced(b)?.0)
        });
    let corners: usize = fit.bundle.observed.iter().flatten().flatten().count();
    let freedom = (2 * corners)
        .saturating_sub(INTRINSICS + 6 * fit.blocks.len())
        .max(1);
    let variance = fit.cost / freedom as f64;
    let sigma = information
        .and_then(|i| bundle::inverse(&i))
        .map_or(f64::INFINITY, |c| {
            (c[(0, 0)].max(c[(1, 1)]) * variance).sqrt()
        });
    let focal_sigma_percent = 100.0 * sigma / fit.bundle.camera.fx;
    if spread < LEAST_SPREAD || focal_sigma_percent.is_nan() || focal_sigma_percent > 5.0 {
        return Err(CalibrationError::Degenerate {
            camera,
            spread_deg: spread.to_degrees(),
            focal_sigma_percent,
        });
    }
    Ok(())
}

/// The relative pose of the pair that agrees best with all others.
fn relative_pose(
    left: &Minimum<Monocular<'_>, INTRINSICS>,
    right: &Minimum<Monocular<'_>, INTRINSICS>,
    used: &[usize],
    pairs: &[BoardPair],
) -> Result<Isometry3<f64>, CalibrationError> {
    let poses: Vec<_> = right
        .bundle
        .camera_from_board
        .iter()
        .zip(&left.bundle.camera_from_board)
        .map(|(r, l)| r * l.inverse())
        .collect();
    let distance = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        let length = a.translation.vector.norm() + b.translation.vector.norm();
        a.rotation.angle_to(&b.rotation)
            + (a.translation.vector - b.translation.vector).norm() / length.max(1e-9)
    };
    let total = |a: &Isometry3<f64>| poses.iter().map(|b| distance(a, b).min(1.0)).sum::<f64>();
    let best = poses
        .iter()
        .min_by(|a, b| total(a).total_cmp(&total(b)))
        .copied()
        .unwrap_or_else(Isometry3::identity);
    for (pose, &k) in poses.iter().zip(used) {
        let angle = pose.rotation.angle_to(&best.rotation);
        if angle > 0.5 {
            return Err(CalibrationError::Flipped {
                left: pairs[k].left_name.clone(),
                right: pairs[k].right_name.clone(),
                difference_deg: angle.to_degrees(),
            });
        }
    }
    Ok(best)
}
