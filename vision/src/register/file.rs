//! Recorded poses and registrations as JSON.

use std::fs;
use std::path::Path;

use hal::Transform;
use nalgebra::{Isometry3, Matrix3, Matrix4, Point2, Point3, Rotation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use super::{RecordedPose, Registration, RegistrationOptions, Target};
use crate::calibrate::{Board, Layout, SQUARES_MM};
use crate::detect::BoardSize;
use crate::files::FileError;

/// Recorded poses as their file holds them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PosesFile {
    /// What the arm carried.
    pub target: TargetEntry,
    /// Standard deviation of a pixel, per axis; the default of [`RegistrationOptions`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixel_sigma_px: Option<f64>,
    /// Standard deviation of the flange's position, per axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arm_position_sigma_mm: Option<f64>,
    /// Standard deviation of the flange's orientation, per axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arm_rotation_sigma_mrad: Option<f64>,
    /// The poses.
    pub poses: Vec<PoseEntry>,
}

/// The target in a poses file: `{"point": {"flange_m": [x, y, z]}}`, `{"point": {}}` or
/// `{"board": {"cols": 9, "rows": 6, "square_mm": 10}}`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum TargetEntry {
    /// A point, at a known or unknown place on the flange.
    #[serde(rename_all = "snake_case")]
    Point {
        /// Its place \[m\].
        #[serde(default, skip_serializing_if = "Option::is_none")]
        flange_m: Option<[f64; 3]>,
    },
    /// A board.
    Board {
        /// Corners along a row.
        cols: usize,
        /// Corners along a column.
        rows: usize,
        /// Side of a square \[mm\].
        square_mm: f64,
    },
}

/// One pose in a poses file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseEntry {
    /// What it is called in messages.
    pub name: String,
    /// Rows of the homogeneous matrix \[m\].
    pub world_from_flange: [[f64; 4]; 4],
    /// Pixels of the left image.
    pub left_px: Vec<[f64; 2]>,
    /// Pixels of the right image.
    pub right_px: Vec<[f64; 2]>,
}

/// A registration as its file holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegistrationFile {
    /// Rows of the homogeneous matrix \[m\].
    pub world_from_left_camera: [[f64; 4]; 4],
    /// Covariance of translation \[m\] and rotation \[rad\] along World's axes.
    pub covariance: [[f64; 6]; 6],
    /// Fiducial registration error.
    pub fre_mm: f64,
    /// Predicted target error where the poses were, on average.
    pub predicted_tre_mm: f64,
    /// Weighted squared residuals over their degrees of freedom.
    pub chi2_per_freedom: f64,
    /// Residual between the two images.
    pub epipolar_rms_px: f64,
    /// Residual of each pose.
    pub residuals_mm: Vec<f64>,
    /// Whether the calibration's own errors were not known, and those of an ordinary one assumed.
    #[serde(default)]
    pub calibration_assumed: bool,
}

/// Reads recorded poses: the target, the poses, and the assumed errors.
///
/// # Errors
/// The file cannot be read, is no JSON of this form, or a pose is no rigid transform.
pub fn read_poses(
    path: &Path,
) -> Result<(Target, Vec<RecordedPose>, RegistrationOptions), FileError> {
    let file: PosesFile = read_json(path)?;
    plausible(path, &file)?;
    let target = match file.target {
        TargetEntry::Point { flange_m: None } => Target::Point,
        TargetEntry::Point {
            flange_m: Some([x, y, z]),
        } => Target::KnownPoint(Point3::new(x, y, z)),
        TargetEntry::Board {
            cols,
            rows,
            square_mm,
        } => Target::Board(Board {
            size: BoardSize { cols, rows },
            square: square_mm * 1e-3,
            layout: Layout::Square,
        }),
    };
    let defaults = RegistrationOptions::default();
    let scaled = |v: Option<f64>, scale: f64, default: f64| v.map_or(default, |v| v * scale);
    let options = RegistrationOptions {
        pixel_sigma_px: file.pixel_sigma_px.unwrap_or(defaults.pixel_sigma_px),
        arm_position_sigma: scaled(
            file.arm_position_sigma_mm,
            1e-3,
            defaults.arm_position_sigma,
        ),
        arm_rotation_sigma: scaled(
            file.arm_rotation_sigma_mrad,
            1e-3,
            defaults.arm_rotation_sigma,
        ),
    };
    let points = |list: Vec<[f64; 2]>| list.into_iter().map(|[x, y]| Point2::new(x, y)).collect();
    let mut poses = Vec::with_capacity(file.poses.len());
    for p in file.poses {
        let isometry = rigid(&p.world_from_flange).ok_or_else(|| FileError::Key {
            path: path.to_owned(),
            key: format!("poses.{}.world_from_flange", p.name),
            expected: "rows of a rigid 4x4 transform".to_owned(),
        })?;
        poses.push(RecordedPose {
            name: p.name,
            world_from_flange: Transform::assume(isometry),
            left: points(p.left_px),
            right: points(p.right_px),
        });
    }
    Ok((target, poses, options))
}

/// Longest way from World's origin to an arm's flange \[m\].
const FARTHEST_FLANGE: f64 = 20.0;
/// Longest way from a flange to what it carries \[m\].
const FARTHEST_POINT: f64 = 3.0;
/// No arm is known better \[mm\], \[mrad\].
const LEAST_SIGMA: f64 = 1e-3;

/// Lengths that can only be of another unit than the file's.
fn plausible(path: &Path, file: &PosesFile) -> Result<(), FileError> {
    let wrong = |key: String, expected: String| {
        let path = path.to_owned();
        Err(FileError::Key {
            path,
            key,
            expected,
        })
    };
    let (least, most) = SQUARES_MM;
    match file.target {
        TargetEntry::Board { square_mm, .. } if !(least..=most).contains(&square_mm) => {
            let expected = format!("millimetres from {least} to {most}, found {square_mm}");
            return wrong("target.board.square_mm".to_owned(), expected);
        }
        TargetEntry::Point { flange_m: Some(p) } if norm(&p) > FARTHEST_POINT => {
            let expected = format!("metres, found a point {:.0} m from the flange", norm(&p));
            return wrong("target.point.flange_m".to_owned(), expected);
        }
        _ => {}
    }
    let sigmas = [
        ("arm_position_sigma_mm", file.arm_position_sigma_mm),
        ("arm_rotation_sigma_mrad", file.arm_rotation_sigma_mrad),
    ];
    for (key, sigma) in sigmas {
        if let Some(sigma) = sigma.filter(|s| *s > 0.0 && *s < LEAST_SIGMA) {
            let unit = if key.ends_with("_mm") {
                "millimetres"
            } else {
                "milliradians"
            };
            let expected = format!("{unit}, {LEAST_SIGMA} and more, found {sigma}");
            return wrong(key.to_owned(), expected);
        }
    }
    for pose in &file.poses {
        let place = pose.world_from_flange.map(|row| row[3]);
        let away = norm(&[place[0], place[1], place[2]]);
        if away > FARTHEST_FLANGE {
            let key = format!("poses.{}.world_from_flange", pose.name);
            let expected = format!("metres, found a flange {away:.0} m from World's origin");
            return wrong(key, expected);
        }
    }
    Ok(())
}

fn norm(place: &[f64; 3]) -> f64 {
    place.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Reads a registration.
///
/// # Errors
/// The file cannot be read, is no JSON of this form, or holds no rigid transform.
pub fn read_registration(
    path: &Path,
) -> Result<Transform<hal::frame::World, hal::frame::LeftCamera>, FileError> {
    let file: RegistrationFile = read_json(path)?;
    rigid(&file.world_from_left_camera)
        .map(Transform::assume)
        .ok_or_else(|| FileError::Key {
            path: path.to_owned(),
            key: "world_from_left_camera".to_owned(),
            expected: "rows of a rigid 4x4 transform".to_owned(),
        })
}

impl RegistrationFile {
    /// The file of a registration; `where_used` are places in the left camera's frame at which
    /// the target error is predicted (root mean square).
    pub fn new(
        registration: &Registration,
        where_used: &[hal::Position<hal::frame::LeftCamera>],
    ) -> Self {
        let m = registration.world_from_left_camera.to_homogeneous();
        let n = where_used.len().max(1) as f64;
        let square: f64 = where_used
            .iter()
            .map(|p| registration.target_covariance(p).trace())
            .sum();
        Self {
            world_from_left_camera: core::array::from_fn(|i| core::array::from_fn(|j| m[(i, j)])),
            covariance: core::array::from_fn(|i| {
                core::array::from_fn(|j| registration.covariance[(i, j)])
            }),
            fre_mm: registration.fre * 1e3,
            predicted_tre_mm: (square / n).sqrt() * 1e3,
            chi2_per_freedom: registration.chi2_per_freedom,
            epipolar_rms_px: registration.epipolar_rms_px,
            residuals_mm: registration.residuals.iter().map(|r| r * 1e3).collect(),
            calibration_assumed: false,
        }
    }

    /// The file's text.
    ///
    /// # Errors
    /// A number is not finite.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(self)
    }
}

fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, FileError> {
    let text = fs::read_to_string(path).map_err(|source| FileError::Io {
        path: path.to_owned(),
        source,
    })?;
    serde_json::from_str(&text).map_err(|source| FileError::Json {
        path: path.to_owned(),
        source,
    })
}

fn rigid(rows: &[[f64; 4]; 4]) -> Option<Isometry3<f64>> {
    let m = Matrix4::from_fn(|i, j| rows[i][j]);
    let r: Matrix3<f64> = m.fixed_view::<3, 3>(0, 0).into_owned();
    let last = m.row(3) - nalgebra::RowVector4::new(0.0, 0.0, 0.0, 1.0);
    let orthogonal = (r * r.transpose() - Matrix3::identity()).amax() < 1e-5;
    let finite = m.iter().all(|x| x.is_finite());
    (finite && orthogonal && r.determinant() > 0.0 && last.amax() < 1e-9).then(|| {
        // Rounded text: the nearest rotation.
        let rotation = super::start::nearest_rotation(&r)
            .unwrap_or_else(|| UnitQuaternion::from_rotation_matrix(&Rotation3::identity()));
        Isometry3::from_parts(m.fixed_view::<3, 1>(0, 3).into_owned().into(), rotation)
    })
}
