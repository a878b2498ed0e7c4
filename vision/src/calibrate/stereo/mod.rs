//! From labelled corners of both cameras to a calibrated rig.

mod assumed;
mod joint;
mod outcome;
mod reject;

pub use assumed::assumed_covariance;
pub use outcome::{Influence, RejectReason, Rejected, StereoCalibration, ViewFit};

pub(super) use reject::{plain, too_many};

use core::fmt::Write as _;

use hal::Transform;
use nalgebra::{Isometry3, Point2};

use super::bundle::{Minimum, NoMinimum, minimise};
use super::determined::{no_fit, well_posed};
use super::monocular::{Monocular, fit};
use super::normal::{INTRINSICS, Observed};
use super::{Board, ImageSizes, Layout, rectified_dy};
use crate::camera::{LensModel, StereoRig};
use crate::detect::irregular_corner;
use joint::Joint;

/// The corners of one board in a pair of images.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardPair {
    /// What the left image is called in reports: its file.
    pub left_name: String,
    /// What the right image is called in reports.
    pub right_name: String,
    /// Corners in the left image, row-major \[px\]; NaN where one is not seen.
    pub left: Vec<Point2<f64>>,
    /// Corners in the right image, row-major \[px\]; NaN where one is not seen.
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
    /// The model of both lenses.
    pub lens: LensModel,
}

impl Default for StereoOptions {
    fn default() -> Self {
        Self {
            huber_px: 1.0,
            corner_limit_px: 1.0,
            view_limit_px: 0.5,
            lens: LensModel::PlumbBob,
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
    /// Fewer images of a single camera than a calibration needs.
    #[error(
        "{usable} usable images of boards, at least 3 are needed{}",
        rejected.iter().fold(String::new(), |list, r| list + "; " + r)
    )]
    TooFewImages {
        /// Usable images.
        usable: usize,
        /// Images that were rejected, and why.
        rejected: Vec<String>,
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
    #[error(
        "the {stage} fit found no minimum: the corners contradict each other{}; look at the \
         board in that image, leave it out, or take more views",
        suspect.as_ref().map_or_else(String::new, |name| format!(", most in {name}"))
    )]
    NoMinimum {
        /// `left`, `right` or `joint`.
        stage: &'static str,
        /// The image without which there is a minimum, or else the one a plane explains worst.
        suspect: Option<String>,
    },
    /// Both cameras stand at one place.
    #[error(
        "the cameras stand at one place (baseline {:.3} mm, boards {:.0} mm away): were the \
         images of one camera given twice?",
        baseline_m * 1e3,
        distance_m * 1e3
    )]
    SamePlace {
        /// Distance of the cameras.
        baseline_m: f64,
        /// Median distance of the boards.
        distance_m: f64,
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
    image_sizes: impl Into<ImageSizes>,
    already_rejected: Vec<Rejected>,
    options: &StereoOptions,
) -> Result<StereoCalibration, CalibrationError> {
    let ImageSizes(sizes) = image_sizes.into();
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
        let kept = [0, 1].map(|s: usize| {
            used.iter()
                .map(|&k| observed[s][k].clone())
                .collect::<Vec<_>>()
        });
        let mono = |s: usize, stage| {
            fit(&points, &kept[s], sizes[s], options.lens, options.huber_px).map_err(
                |_: NoMinimum| {
                    let name = |k: usize| {
                        let pair = &pairs[used[k]];
                        [&pair.left_name, &pair.right_name][s].clone()
                    };
                    no_fit(stage, &points, &kept[s], sizes[s], options, name)
                },
            )
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
        .map_err(|_| CalibrationError::NoMinimum {
            stage: "joint",
            suspect: None,
        })?;
        let found = reject::reject(&joint.bundle, &used, &pairs, &mut observed, options);
        if found.rejected.is_empty() {
            apart(&joint.bundle)?;
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
            .ok_or(CalibrationError::NoMinimum {
                stage: "joint",
                suspect: None,
            });
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
            if board.layout == Layout::Square
                && corners.iter().all(seen)
                && let Some(false_corner) = irregular_corner(corners, size, 2.0)
            {
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
        .map(|c| c.iter().map(|p| seen(p).then_some(*p)).collect())
        .collect()
}

/// Whether a corner of a pair is there.
pub(super) fn seen(corner: &Point2<f64>) -> bool {
    corner.x.is_finite() && corner.y.is_finite()
}

/// Cameras nearer to each other than this part of the boards' distance are one camera: the
/// depth that such a pair sees is noise.
const LEAST_BASELINE: f64 = 1e-3;

/// Refuses a rig without a baseline.
fn apart(joint: &Joint<'_>) -> Result<(), CalibrationError> {
    let mut distances: Vec<f64> = joint
        .left_from_board
        .iter()
        .map(|pose| pose.translation.vector.norm())
        .collect();
    distances.sort_by(f64::total_cmp);
    let distance_m = distances.get(distances.len() / 2).copied().unwrap_or(0.0);
    let baseline_m = joint.right_from_left.translation.vector.norm();
    if baseline_m < LEAST_BASELINE * distance_m {
        return Err(CalibrationError::SamePlace {
            baseline_m,
            distance_m,
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
