//! Whether views determine a camera, and why a fit found none.

use nalgebra::{Isometry3, Point2, SMatrix, Vector3};

use super::bundle::{self, Minimum};
use super::monocular::{Monocular, fit};
use super::normal::{INTRINSICS, Observed};
use super::stereo::{CalibrationError, StereoOptions};
use super::zhang;
use crate::homography::{homography, map};

/// With less than five degrees between all boards, focal length and distance are hardly
/// separable \[rad\].
const LEAST_SPREAD: f64 = 0.087;
/// A focal length less certain than this is not determined by the views \[%\].
const LARGEST_FOCAL_SIGMA: f64 = 5.0;

/// Greatest angle between two boards' normals.
fn normal_spread(camera_from_board: &[Isometry3<f64>]) -> f64 {
    let normal = |p: &Isometry3<f64>| p.rotation * Vector3::z();
    let mut spread = 0.0_f64;
    for (k, a) in camera_from_board.iter().enumerate() {
        for b in &camera_from_board[..k] {
            spread = spread.max(normal(a).angle(&normal(b)));
        }
    }
    spread
}

/// Why a monocular fit found no minimum: parallel views leave it a valley; else a view spoils it.
pub(super) fn no_fit(
    camera: &'static str,
    board: &[Point2<f64>],
    observed: &[Observed],
    image_size: (usize, usize),
    options: &StereoOptions,
    name: impl Fn(usize) -> String,
) -> CalibrationError {
    let spread = zhang::start(board, observed, image_size)
        .map(|s| normal_spread(&s.camera_from_board))
        .filter(|&s| s < 2.0 * LEAST_SPREAD);
    if let Some(spread) = spread {
        return CalibrationError::Degenerate {
            camera,
            spread_deg: spread.to_degrees(),
            focal_sigma_percent: f64::INFINITY,
        };
    }
    // Without which view is there a minimum?
    let spoiler = (0..observed.len())
        .filter(|_| observed.len() > 3)
        .find(|&k| {
            let mut rest = observed.to_vec();
            rest.remove(k);
            fit(board, &rest, image_size, options.lens, options.huber_px).is_ok()
        });
    let suspect = spoiler.or_else(|| least_planar(board, observed)).map(name);
    CalibrationError::NoMinimum {
        stage: camera,
        suspect,
    }
}

/// The view that a homography explains worst.
fn least_planar(board: &[Point2<f64>], observed: &[Observed]) -> Option<usize> {
    let miss = |view: &Observed| {
        let both = board.iter().zip(view);
        let (points, pixels): (Vec<_>, Vec<_>) =
            both.filter_map(|(p, px)| px.map(|px| (*p, px))).unzip();
        homography(&points, &pixels).map_or(f64::INFINITY, |h| {
            let all = points.iter().zip(&pixels);
            all.map(|(p, px)| (map(&h, p) - px).norm_squared()).sum()
        })
    };
    (0..observed.len()).max_by(|&a, &b| miss(&observed[a]).total_cmp(&miss(&observed[b])))
}

/// Refuses views that do not determine a camera.
pub(super) fn well_posed(
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
    let parameters = fit.bundle.camera.distortion.model.used().len();
    let freedom = (2 * corners)
        .saturating_sub(parameters + 6 * fit.blocks.len())
        .max(1);
    let variance = fit.cost / freedom as f64;
    let sigma = information
        .and_then(|i| bundle::inverse(&i))
        .map_or(f64::INFINITY, |c| {
            (c[(0, 0)].max(c[(1, 1)]) * variance).sqrt()
        });
    let focal_sigma_percent = 100.0 * sigma / fit.bundle.camera.fx;
    if spread < LEAST_SPREAD
        || focal_sigma_percent.is_nan()
        || focal_sigma_percent > LARGEST_FOCAL_SIGMA
    {
        return Err(CalibrationError::Degenerate {
            camera,
            spread_deg: spread.to_degrees(),
            focal_sigma_percent,
        });
    }
    Ok(())
}
