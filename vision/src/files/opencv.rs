//! OpenCV `FileStorage` YAML (`stereo.yml`): the rig, its rectification, its covariance, and the
//! container where there is one.

use core::fmt::Write as _;
use std::path::Path;

use nalgebra::{DMatrix, Matrix3, Unit, Vector3};

use super::calibration::{Affix, Keys, NEITHER, ReadOptions, read_calibration};
use super::camera_info::camera_info;
use super::{FileError, digits, list};
use crate::calibrate::StereoCalibration;
use crate::camera::{Camera, Container, FlatWindow, StereoRig};

/// A stereo rig as its file holds it.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoFile {
    /// The rig.
    pub rig: StereoRig,
    /// Covariance of its parameters (24 of two Brown-Conrady lenses), in the order of
    /// [`StereoCalibration::covariance`]; `None` in files of other programs.
    pub covariance: Option<DMatrix<f64>>,
    /// Standard deviation of a corner, per axis \[px\].
    pub corner_sigma_px: Option<f64>,
}

impl From<&StereoCalibration> for StereoFile {
    fn from(c: &StereoCalibration) -> Self {
        Self {
            rig: c.rig,
            covariance: Some(c.covariance.clone()),
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
        self.check_sizes(path, [(width, height); 2])
    }

    /// The same with a size for each camera, left first.
    ///
    /// # Errors
    /// Width or height differ.
    pub fn check_sizes(&self, path: &Path, sizes: [(usize, usize); 2]) -> Result<(), FileError> {
        for (c, (width, height)) in [&self.rig.left, &self.rig.right].into_iter().zip(sizes) {
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
    let row = |d: Vec<f64>| DMatrix::from_row_slice(1, d.len(), &d);
    let projection = |k: usize| DMatrix::from_column_slice(3, 4, info[k].projection.as_slice());
    let mut text = String::from("%YAML:1.0\n---\n");
    let _ = writeln!(text, "image_width: {}", rig.left.width);
    let _ = writeln!(text, "image_height: {}", rig.left.height);
    if (rig.right.width, rig.right.height) != (rig.left.width, rig.left.height) {
        let _ = writeln!(text, "right_image_width: {}", rig.right.width);
        let _ = writeln!(text, "right_image_height: {}", rig.right.height);
    }
    let models = [&rig.left, &rig.right].map(|c| c.distortion.model.name());
    if models[0] == models[1] {
        let _ = writeln!(text, "distortion_model: {}", models[0]);
    } else {
        let _ = writeln!(text, "distortion_model1: {}", models[0]);
        let _ = writeln!(text, "distortion_model2: {}", models[1]);
    }
    for (key, m) in [
        ("M1", square(&rig.left.matrix())),
        ("D1", row(rig.left.distortion.coefficients())),
        ("M2", square(&rig.right.matrix())),
        ("D2", row(rig.right.distortion.coefficients())),
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
        text += &matrix("covariance", c);
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

/// Reads a stereo calibration from one file: ours, or another program's
/// (see [`read_calibration`](super::read_calibration)), in metres.
///
/// # Errors
/// As [`read_calibration`](super::read_calibration).
pub fn read_stereo(path: &Path) -> Result<StereoFile, FileError> {
    let read = read_calibration(&[path.to_owned()], &ReadOptions::default())?;
    Ok(read.file)
}

/// Covariance, corner noise and container.
type Extras = (Option<DMatrix<f64>>, Option<f64>, Option<Container>);

/// What only our own files hold.
pub(super) fn extras(keys: &Keys, rig: &StereoRig) -> Result<Extras, FileError> {
    let used = |camera: &Camera| camera.distortion.model.used().len();
    let size = used(&rig.left) + used(&rig.right) + 6;
    let covariance = keys
        .find(NEITHER, &["covariance"])
        .map(|found| {
            let m = found.matrix()?;
            if m.shape() == (size, size) {
                Ok(m)
            } else {
                Err(found.wrong(&format!("a matrix of {size} x {size}")))
            }
        })
        .transpose()?;
    let sigma = keys
        .find(NEITHER, &["cornersigmapx"])
        .map(|found| {
            let sigma = found.node.number();
            sigma.ok_or_else(|| found.wrong("a finite number"))
        })
        .transpose()?;
    let window = |group: &'static str| -> Result<Option<FlatWindow>, FileError> {
        let there = |part: &str| keys.find(Affix(group, ""), &[part]);
        let Some(normal) = there("normal") else {
            return Ok(None);
        };
        let m = normal.matrix()?;
        let direction = (m.len() == 3).then(|| Vector3::from_column_slice(m.as_slice()));
        let direction = direction.and_then(|d| Unit::try_new(d, 1e-6));
        let number = |part: &str| {
            let found = there(&part.replace('_', ""));
            let found = found.ok_or_else(|| keys.missing(part, "of the window"))?;
            let number = found.node.number();
            number.ok_or_else(|| found.wrong("a finite number"))
        };
        FlatWindow {
            normal: direction.ok_or_else(|| normal.wrong("a direction"))?,
            distance: number("distance_m")?,
            thickness: number("thickness_m")?,
            wall_index: number("wall_index")?,
            gel_index: number("gel_index")?,
        }
        .validated()
        .map(Some)
        .map_err(|source| FileError::Window {
            path: keys.path().to_owned(),
            source,
        })
    };
    let container = match (window("leftwindow")?, window("rightwindow")?) {
        (Some(left), Some(right)) => Some(Container { left, right }),
        (None, None) => None,
        (Some(_), None) => return Err(keys.missing("right_window", "a window for each camera")),
        (None, Some(_)) => return Err(keys.missing("left_window", "a window for each camera")),
    };
    Ok((covariance, sigma, container))
}
