//! Stereo calibration from photographs of a board.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context;
use hal::GrayImage;
use nalgebra::{Matrix4, Point2};
use serde::Serialize;
use vision::calibrate::{
    Board, BoardPair, RejectReason, Rejected, StereoCalibration, StereoOptions, calibrate_stereo,
};
use vision::camera::{Camera, LensModel};
use vision::detect::{BoardKind, RefineOptions};
use vision::files::{
    Pixels, StereoFile, camchain, camera_info, read_images, stereo_yml, write_all,
};
use vision::report::calibration_report;

use crate::config::in_other_unit;

/// Names of the lens models.
pub const LENSES: [&str; 4] = ["plumb_bob", "radtan", "rational_polynomial", "equidistant"];

/// What to calibrate from.
#[derive(Clone, Debug)]
pub struct Request {
    /// Images of the left camera.
    pub left: Vec<PathBuf>,
    /// Images of the right camera, in the same order.
    pub right: Vec<PathBuf>,
    /// The board, as `calibrate stereo --board` has it.
    pub board: String,
    /// Side of a square, of circles the distance of two rows \[mm\].
    pub square_mm: f64,
    /// Model of both lenses, of [`LENSES`].
    pub lens: String,
    /// What the images' pixels are.
    pub pixels: Pixels,
}

/// A request that gives no calibration.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct StereoError(String);

/// Finds the board in all images and calibrates.
///
/// # Errors
/// What was asked for cannot be used, images cannot be read, or do not calibrate.
pub fn calibrate(request: &Request) -> Result<StereoCalibration, StereoError> {
    let wrong = |e: &dyn std::fmt::Display| StereoError(e.to_string());
    let kind: BoardKind = request
        .board
        .parse()
        .map_err(|e| StereoError(format!("--board {e}")))?;
    let square_mm = check_square(request.square_mm)?;
    if !LENSES.contains(&request.lens.as_str()) {
        let known = LENSES.join(", ");
        let found = &request.lens;
        return Err(StereoError(format!(
            "--lens {found}: expected one of {known}"
        )));
    }
    let board = Board::new(&kind, square_mm * 1e-3);
    let (names_left, names_right) = (&request.left, &request.right);
    if names_left.len() != names_right.len() {
        return Err(StereoError(format!(
            "--left names {} images, --right {}: every pair needs both",
            names_left.len(),
            names_right.len()
        )));
    }
    let read = |files: &[PathBuf]| read_images(files, request.pixels).map_err(|e| wrong(&e));
    let (left, right) = (read(names_left)?, read(names_right)?);
    let sizes = [&left, &right].map(|images| {
        let first = images.first();
        first.map_or((0, 0), |image| (image.width(), image.height()))
    });
    let (mut pairs, mut rejected) = (Vec::new(), Vec::new());
    for (k, (left_image, right_image)) in left.iter().zip(&right).enumerate() {
        let names = [names_left, names_right].map(|list| name(list.get(k)));
        match corners([left_image, right_image], &kind, &names) {
            Ok([left, right]) => {
                let [left_name, right_name] = names;
                pairs.push(BoardPair {
                    left_name,
                    right_name,
                    left,
                    right,
                });
            }
            Err(reason) => {
                let [left, right] = names;
                rejected.push(Rejected {
                    left,
                    right,
                    reason,
                });
            }
        }
    }
    let options = StereoOptions {
        lens: lens(&request.lens),
        ..StereoOptions::default()
    };
    calibrate_stereo(&board, &pairs, sizes, rejected, &options).map_err(|e| wrong(&e))
}

/// The side of a square as it was given, where it is one \[mm\].
///
/// # Errors
/// No board has such squares.
pub(crate) fn check_square(square_mm: f64) -> Result<f64, StereoError> {
    let (least, most) = vision::calibrate::SQUARES_MM;
    if (least..=most).contains(&square_mm) {
        return Ok(square_mm);
    }
    Err(StereoError(format!(
        "--square-mm {square_mm}: expected millimetres from {least} to {most}{}",
        in_other_unit(square_mm, least, most)
    )))
}

/// The lens model of a name of [`LENSES`].
pub fn lens(name: &str) -> LensModel {
    match name {
        "radtan" => LensModel::RadTan,
        "rational_polynomial" => LensModel::RationalPolynomial,
        "equidistant" => LensModel::Equidistant,
        _ => LensModel::PlumbBob,
    }
}

fn name(path: Option<&PathBuf>) -> String {
    path.and_then(|p| p.file_name())
        .map_or_else(String::new, |n| n.to_string_lossy().into_owned())
}

/// A camera in OpenCV's terms.
#[derive(Clone, Debug, Serialize)]
pub struct CameraOutput {
    camera_matrix: [[f64; 3]; 3],
    distortion: Vec<f64>,
}

/// A calibration in short, as `calibrate stereo --json` prints it.
#[derive(Clone, Debug, Serialize)]
pub struct StereoOutput<'a> {
    left_rms_px: f64,
    right_rms_px: f64,
    joint_rms_px: f64,
    rectified_dy_rms_px: f64,
    left: CameraOutput,
    right: CameraOutput,
    right_from_left: [[f64; 4]; 4],
    corners_px: BTreeMap<&'a str, Vec<Option<[f64; 2]>>>,
    rejected: Vec<String>,
    sigma: Vec<f64>,
}

/// A corner that an image does not show.
const MISSING: Point2<f64> = Point2::new(f64::NAN, f64::NAN);

/// Corners of the board in both images, or which image has none and why.
fn corners(
    images: [&GrayImage; 2],
    kind: &BoardKind,
    names: &[String; 2],
) -> Result<[Vec<Point2<f64>>; 2], RejectReason> {
    let find = |side: usize| {
        images
            .get(side)
            .map(|image| kind.detect(image, &RefineOptions::default()))
            .transpose()
            .map(|found| found.into_iter().flatten())
            .map(|found| found.map(|p| p.unwrap_or(MISSING)).collect())
            .map_err(|e| RejectReason::NoBoard {
                image: names.get(side).cloned().unwrap_or_default(),
                why: e.to_string(),
            })
    };
    Ok([find(0)?, find(1)?])
}

/// Names of the files that [`write`] may write.
const FILES: [&str; 5] = [
    "report.html",
    "left.yaml",
    "right.yaml",
    "stereo.yml",
    "camchain.yaml",
];

/// Refuses a folder with files of an earlier calibration, before a new one is made.
///
/// # Errors
/// One is there.
pub(crate) fn check_free(out: &Path) -> Result<(), crate::results::ResultsError> {
    FILES
        .iter()
        .try_for_each(|name| crate::results::check_free(&out.join(name)))
}

/// Writes report and calibration files to the folder `out`, made if missing.
///
/// # Errors
/// One of them is there already, and nothing is written over; or the system refused.
pub fn write(out: &Path, calibration: &StereoCalibration) -> anyhow::Result<()> {
    check_free(out)?;
    let report = calibration_report(calibration)?;
    let [left, right] = camera_info(&calibration.rig);
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let texts = [
        Some(report),
        Some(left.to_yaml()),
        Some(right.to_yaml()),
        Some(stereo_yml(&StereoFile::from(calibration))),
        camchain(&calibration.rig),
    ];
    let files = FILES.iter().zip(texts);
    let files = files.filter_map(|(name, text)| Some((out.join(name), text?)));
    write_all(&files.collect::<Vec<_>>())?;
    Ok(())
}

/// A corner; `None` where it is missing.
fn place(corner: &Point2<f64>) -> Option<[f64; 2]> {
    corner.x.is_finite().then_some([corner.x, corner.y])
}

/// The calibration in short.
pub fn output(c: &StereoCalibration) -> StereoOutput<'_> {
    let mut corners_px = BTreeMap::new();
    for view in &c.views {
        for (name, corners) in [&view.left_name, &view.right_name]
            .into_iter()
            .zip(&view.corners)
        {
            corners_px.insert(name.as_str(), corners.iter().map(place).collect());
        }
    }
    StereoOutput {
        left_rms_px: c.left_rms_px,
        right_rms_px: c.right_rms_px,
        joint_rms_px: c.joint_rms_px,
        rectified_dy_rms_px: c.rectified_dy.rms_px,
        left: camera_output(&c.rig.left),
        right: camera_output(&c.rig.right),
        right_from_left: rows(&c.rig.right_from_left.to_homogeneous()),
        corners_px,
        rejected: c.rejected.iter().map(ToString::to_string).collect(),
        sigma: c.sigmas().iter().copied().collect(),
    }
}

/// A camera in OpenCV's terms.
pub fn camera_output(camera: &Camera) -> CameraOutput {
    let k = camera.matrix();
    CameraOutput {
        camera_matrix: core::array::from_fn(|i| core::array::from_fn(|j| k[(i, j)])),
        distortion: camera.distortion.coefficients(),
    }
}

/// Row by row.
fn rows(m: &Matrix4<f64>) -> [[f64; 4]; 4] {
    core::array::from_fn(|i| core::array::from_fn(|j| m[(i, j)]))
}
