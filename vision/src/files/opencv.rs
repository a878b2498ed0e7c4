//! OpenCV `FileStorage` YAML (`stereo.yml`): the rig, its rectification, its covariance, and the
//! container where there is one.

use core::fmt::Write as _;
use std::path::Path;

use hal::Transform;
use nalgebra::{DMatrix, Isometry3, Matrix3, Rotation3, SMatrix, Unit, UnitQuaternion, Vector3};

use super::FileError;
use super::camera_info::{camera, camera_info, distortion};
use super::yaml::{Document, digits, list};
use crate::calibrate::StereoCalibration;
use crate::camera::{Container, FlatWindow, StereoRig};

/// A stereo rig as its file holds it.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoFile {
    /// The rig.
    pub rig: StereoRig,
    /// Covariance of its 24 parameters, in the order of
    /// [`StereoCalibration::covariance`]; `None` in files of other programs.
    pub covariance: Option<SMatrix<f64, 24, 24>>,
    /// Standard deviation of a corner, per axis \[px\].
    pub corner_sigma_px: Option<f64>,
}

impl From<&StereoCalibration> for StereoFile {
    fn from(c: &StereoCalibration) -> Self {
        Self {
            rig: c.rig,
            covariance: Some(c.covariance),
            corner_sigma_px: Some(c.corner_sigma_px),
        }
    }
}

impl StereoFile {
    /// Refuses images of another size than the calibrated ones; `path` is the file's, for the
    /// message.
    ///
    /// # Errors
    /// Width or height differ.
    pub fn check_size(&self, path: &Path, width: usize, height: usize) -> Result<(), FileError> {
        for c in [&self.rig.left, &self.rig.right] {
            if (c.width, c.height) != (width, height) {
                return Err(FileError::OtherCamera {
                    path: path.to_owned(),
                    calibrated_width: c.width,
                    calibrated_height: c.height,
                    width,
                    height,
                });
            }
        }
        Ok(())
    }
}

/// The file's text. Lengths are metres; `R`, `T` take the left camera's coordinates to the
/// right's.
pub fn stereo_yml(file: &StereoFile) -> String {
    let rig = &file.rig;
    let pose = rig.right_from_left.isometry();
    let r: Matrix3<f64> = *pose.rotation.to_rotation_matrix().matrix();
    let t = pose.translation.vector;
    // Points of both images: x_r^T E x_l = 0, and the same of pixels with F.
    let essential = t.cross_matrix() * r;
    let inverse = |k: Matrix3<f64>| k.try_inverse().unwrap_or_else(Matrix3::identity);
    let mut fundamental =
        inverse(rig.right.matrix()).transpose() * essential * inverse(rig.left.matrix());
    if fundamental[(2, 2)] != 0.0 {
        fundamental /= fundamental[(2, 2)];
    }
    let info = camera_info(rig);
    let square = |m: &Matrix3<f64>| DMatrix::from_column_slice(3, 3, m.as_slice());
    let row = |d: [f64; 5]| DMatrix::from_row_slice(1, 5, &d);
    let projection = |k: usize| DMatrix::from_column_slice(3, 4, info[k].projection.as_slice());
    let mut text = String::from("%YAML:1.0\n---\n");
    let _ = writeln!(text, "image_width: {}", rig.left.width);
    let _ = writeln!(text, "image_height: {}", rig.left.height);
    for (key, m) in [
        ("M1", square(&rig.left.matrix())),
        ("D1", row(rig.left.distortion.to_array())),
        ("M2", square(&rig.right.matrix())),
        ("D2", row(rig.right.distortion.to_array())),
        ("R", square(&r)),
        ("T", DMatrix::from_column_slice(3, 1, t.as_slice())),
        ("E", square(&essential)),
        ("F", square(&fundamental)),
        ("R1", square(&info[0].rectification)),
        ("R2", square(&info[1].rectification)),
        ("P1", projection(0)),
        ("P2", projection(1)),
    ] {
        text += &matrix(key, &m);
    }
    if let Some(sigma) = file.corner_sigma_px {
        let _ = writeln!(text, "corner_sigma_px: {}", digits(sigma));
    }
    if let Some(c) = &file.covariance {
        text += &matrix(
            "covariance",
            &DMatrix::from_column_slice(24, 24, c.as_slice()),
        );
    }
    if let Some(c) = &rig.container {
        text += &window("left_window", &c.left);
        text += &window("right_window", &c.right);
    }
    text
}

fn matrix(key: &str, m: &DMatrix<f64>) -> String {
    let (rows, cols) = m.shape();
    let data = list(m.transpose().iter().copied());
    format!(
        "{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n"
    )
}

fn window(key: &str, w: &FlatWindow) -> String {
    let normal = DMatrix::from_column_slice(3, 1, w.normal.as_slice());
    let inner = matrix("normal", &normal).replace('\n', "\n   ");
    format!(
        "{key}:\n   {}\n   distance_m: {}\n   thickness_m: {}\n   wall_index: {}\n   gel_index: {}\n",
        inner.trim_end(),
        digits(w.distance),
        digits(w.thickness),
        digits(w.wall_index),
        digits(w.gel_index),
    )
}

/// Reads a `stereo.yml`: ours, or another program's with the keys `image_width`,
/// `image_height`, `M1`, `D1`, `M2`, `D2`, `R`, `T` (metres).
///
/// # Errors
/// The file cannot be read, is no YAML, a key is missing or wrong, or the values make no rig.
pub fn read_stereo(path: &Path) -> Result<StereoFile, FileError> {
    let doc = Document::read(path)?;
    let size = (doc.count("image_width")?, doc.count("image_height")?);
    let one = |k: &str, d: &str| {
        let matrix = doc.sized(k, 3, 3)?;
        camera(&doc, &matrix, distortion(&doc, d)?, size)
    };
    let (left, right) = (one("M1", "D1")?, one("M2", "D2")?);
    let r = doc.sized("R", 3, 3)?;
    let r = Matrix3::from_column_slice(r.as_slice());
    if (r * r.transpose() - Matrix3::identity()).amax() > 1e-6 || r.determinant() < 0.0 {
        return Err(doc.wrong("R", "a rotation matrix"));
    }
    let t = doc.matrix("T")?;
    if t.len() != 3 {
        return Err(doc.wrong("T", "three numbers"));
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(r));
    let pose = Isometry3::from_parts(Vector3::from_column_slice(t.as_slice()).into(), rotation);
    let covariance = if doc.has("covariance") {
        let c = doc.sized("covariance", 24, 24)?;
        Some(SMatrix::<f64, 24, 24>::from_column_slice(c.as_slice()))
    } else {
        None
    };
    let corner_sigma_px = if doc.has("corner_sigma_px") {
        Some(doc.number("corner_sigma_px")?)
    } else {
        None
    };
    let container = match (doc.has("left_window"), doc.has("right_window")) {
        (false, false) => None,
        _ => Some(Container {
            left: read_window(&doc, "left_window")?,
            right: read_window(&doc, "right_window")?,
        }),
    };
    Ok(StereoFile {
        rig: StereoRig {
            left,
            right,
            right_from_left: Transform::assume(pose),
            container,
        },
        covariance,
        corner_sigma_px,
    })
}

fn read_window(doc: &Document<'_>, key: &str) -> Result<FlatWindow, FileError> {
    let at = |part: &str| format!("{key}.{part}");
    let n = doc.sized(&at("normal"), 3, 1)?;
    let normal = Vector3::from_column_slice(n.as_slice());
    let normal =
        Unit::try_new(normal, 1e-6).ok_or_else(|| doc.wrong(&at("normal"), "a direction"))?;
    FlatWindow {
        normal,
        distance: doc.number(&at("distance_m"))?,
        thickness: doc.number(&at("thickness_m"))?,
        wall_index: doc.number(&at("wall_index"))?,
        gel_index: doc.number(&at("gel_index"))?,
    }
    .validated()
    .map_err(|source| FileError::Window {
        path: doc.path().to_owned(),
        source,
    })
}
