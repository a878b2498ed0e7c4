//! One camera alone: intrinsics and how well they are known.

use nalgebra::{Isometry3, Point2, SMatrix, Vector2};

use super::bundle::{inverse, reduced};
use super::determined::{no_fit, well_posed};
use super::monocular::fit;
use super::normal::{INTRINSICS, Observed, residuals};
use super::stereo::{CalibrationError, StereoOptions, plain, too_many};
use crate::camera::Camera;

/// A board in one image.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardView {
    /// What the image is called in reports: its file.
    pub name: String,
    /// The board's points in the image, in the order of the board \[px\]; `None` where one is not
    /// seen.
    pub corners: Vec<Option<Point2<f64>>>,
}

/// A calibrated camera.
#[derive(Clone, Debug, PartialEq)]
pub struct MonoCalibration {
    /// The camera.
    pub camera: Camera,
    /// Standard deviations of fx fy cx cy and the lens model's coefficients.
    pub sigmas: Vec<f64>,
    /// RMS distance of the corners from the fit \[px\].
    pub rms_px: f64,
    /// The images that count, and the RMS of each \[px\].
    pub views: Vec<(String, f64)>,
    /// Images, and single corners, that do not count, and why.
    pub rejected: Vec<String>,
}

/// Calibrates one camera from images of a flat board. `points` are the board's \[m\];
/// `already_rejected` is carried into the result.
///
/// # Errors
/// Fewer than three views, views that do not determine the camera, no minimum.
pub fn calibrate_mono(
    points: &[Point2<f64>],
    views: &[BoardView],
    image_size: (usize, usize),
    already_rejected: Vec<String>,
    options: &StereoOptions,
) -> Result<MonoCalibration, CalibrationError> {
    let mut rejected = already_rejected;
    let mut used: Vec<&BoardView> = views.iter().collect();
    let mut observed: Vec<Observed> = views.iter().map(|v| v.corners.clone()).collect();
    loop {
        if used.len() < 3 {
            return Err(CalibrationError::TooFewImages {
                usable: used.len(),
                rejected,
            });
        }
        let found = fit(
            points,
            &observed,
            image_size,
            options.lens,
            options.huber_px,
        )
        .map_err(|_| {
            let name = |k: usize| used[k].name.clone();
            no_fit("only", points, &observed, image_size, options, name)
        })?;
        well_posed("only", &found)?;
        let camera = found.bundle.camera;
        let poses = &found.bundle.camera_from_board;
        let misses = misses(&camera, poses, points, &observed);
        // The median length of a plane's Gaussian is 1.177 sigma.
        let sigma = median(misses.iter().flatten().flatten().copied().collect()) / 1.177;
        let corner_limit = options.corner_limit_px.max(8.0 * sigma);
        let of_view: Vec<f64> = misses.iter().map(|m| rms(plain(m, corner_limit))).collect();
        let limit = options.view_limit_px.max(3.0 * median(of_view.clone()));
        let spoils = |m: &Vec<_>| too_many(m, corner_limit) || rms(plain(m, corner_limit)) > limit;
        let spoiled: Vec<bool> = misses.iter().map(spoils).collect();
        if spoiled.contains(&true) {
            for ((view, miss), _) in used.iter().zip(&misses).zip(&spoiled).filter(|(_, s)| **s) {
                let rms = rms(miss.iter().flatten());
                rejected.push(format!(
                    "{}: the others contradict it (RMS {rms:.2} px, limit {limit:.2} px)",
                    view.name
                ));
            }
            let kept = |k: &usize| !spoiled[*k];
            let indices: Vec<usize> = (0..used.len()).filter(kept).collect();
            observed = indices.iter().map(|&k| observed[k].clone()).collect();
            used = indices.iter().map(|&k| used[k]).collect();
            continue;
        }
        let mut outliers = Vec::new();
        for (k, view) in misses.iter().enumerate() {
            for (corner, miss) in view.iter().enumerate() {
                if let Some(miss) = miss.filter(|m| *m > corner_limit) {
                    outliers.push((k, corner, miss));
                }
            }
        }
        if !outliers.is_empty() {
            for (k, corner, miss) in outliers {
                observed[k][corner] = None;
                rejected.push(format!(
                    "{}: corner {corner} misses the fit by {miss:.2} px, more than \
                     {corner_limit:.2} px",
                    used[k].name
                ));
            }
            continue;
        }
        let information = found
            .blocks
            .iter()
            .try_fold(SMatrix::<f64, INTRINSICS, INTRINSICS>::zeros(), |sum, b| {
                Some(sum + reduced(b)?.0)
            });
        let covariance = information.and_then(|i| inverse(&i)).ok_or_else(|| {
            let name = |k: usize| used[k].name.clone();
            no_fit("only", points, &observed, image_size, options, name)
        })?;
        let corners = misses.iter().flatten().flatten().count();
        let parameters = camera.distortion.model.used();
        let freedom = (2 * corners).saturating_sub(parameters.len() + 6 * used.len());
        let variance = found.cost / freedom.max(1) as f64;
        return Ok(MonoCalibration {
            camera,
            sigmas: parameters
                .iter()
                .map(|&k| (covariance[(k, k)] * variance).sqrt())
                .collect(),
            rms_px: rms(misses.iter().flatten().flatten()),
            views: used.iter().map(|v| v.name.clone()).zip(of_view).collect(),
            rejected,
        });
    }
}

/// Distance of every corner from the fit \[px\].
fn misses(
    camera: &Camera,
    poses: &[Isometry3<f64>],
    points: &[Point2<f64>],
    observed: &[Observed],
) -> Vec<Vec<Option<f64>>> {
    let all = observed.iter().zip(poses);
    all.map(|(seen, pose)| {
        let pixels: Vec<Point2<f64>> = seen.iter().map(|p| p.unwrap_or_default()).collect();
        let lengths = residuals(camera, pose, points, &pixels);
        let lengths = lengths.iter().map(Vector2::norm);
        lengths.zip(seen).map(|(l, s)| s.map(|_| l)).collect()
    })
    .collect()
}

fn rms<'a>(values: impl Iterator<Item = &'a f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0_f64), |(s, n), v| (s + v * v, n + 1.0));
    (sum / count.max(1.0)).sqrt()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
