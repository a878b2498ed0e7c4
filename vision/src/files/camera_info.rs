//! ROS `camera_info` YAML, as `camera_calibration` writes it and `camera_info_manager` reads it.

use std::path::Path;

use nalgebra::{DMatrix, Matrix3, Matrix3x4};

use super::{FileError, calibration, list};
use crate::calibrate::rectify;
use crate::camera::{Camera, StereoRig};

/// One camera's `camera_info`.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraInfo {
    /// The camera's name.
    pub name: String,
    /// The camera.
    pub camera: Camera,
    /// Rectifying rotation.
    pub rectification: Matrix3<f64>,
    /// Projection of the rectified image; the right camera's holds -f times the baseline, in its
    /// first row for cameras side by side and in its second for one above the other.
    pub projection: Matrix3x4<f64>,
}

/// Both cameras' `camera_info` (left, right) with OpenCV's rectification; where the rig cannot
/// be rectified, each camera keeps its own axes.
pub fn camera_info(rig: &StereoRig) -> [CameraInfo; 2] {
    let rectified = rectify(rig);
    let one = |side: usize, name: &str, camera: Camera| {
        let (rectification, projection) = match &rectified {
            Some(r) => {
                let c = r.centres[side];
                let shift = if side == 0 { 0.0 } else { r.shift * r.focal };
                // One above the other: the baseline lies along the columns.
                let (across, down) = if r.vertical {
                    (0.0, shift)
                } else {
                    (shift, 0.0)
                };
                let turn = if side == 0 { r.left } else { r.right };
                #[rustfmt::skip]
                let p = Matrix3x4::new(
                    r.focal, 0.0, c.x, across,
                    0.0, r.focal, c.y, down,
                    0.0, 0.0, 1.0, 0.0,
                );
                (*turn.matrix(), p)
            }
            None => (
                Matrix3::identity(),
                camera.matrix().fixed_resize::<3, 4>(0.0),
            ),
        };
        CameraInfo {
            name: name.to_owned(),
            camera,
            rectification,
            projection,
        }
    };
    [one(0, "left", rig.left), one(1, "right", rig.right)]
}

/// One camera alone, not rectified.
pub fn camera_info_of(camera: &Camera, name: &str) -> CameraInfo {
    CameraInfo {
        name: name.to_owned(),
        camera: *camera,
        rectification: Matrix3::identity(),
        projection: camera.matrix().fixed_resize::<3, 4>(0.0),
    }
}

impl CameraInfo {
    /// As a YAML document.
    pub fn to_yaml(&self) -> String {
        let c = &self.camera;
        let matrix = |key: &str, m: &DMatrix<f64>| {
            let data = list(m.transpose().iter().copied());
            let (rows, cols) = m.shape();
            format!("{key}:\n  rows: {rows}\n  cols: {cols}\n  data: [{data}]\n")
        };
        let (model, d) = c.distortion.ros();
        let d = DMatrix::from_row_slice(1, d.len(), &d);
        let dynamic3 = |m: &Matrix3<f64>| DMatrix::from_column_slice(3, 3, m.as_slice());
        [
            format!("image_width: {}\nimage_height: {}\n", c.width, c.height),
            format!("camera_name: {}\n", self.name),
            matrix("camera_matrix", &dynamic3(&c.matrix())),
            format!("distortion_model: {model}\n"),
            matrix("distortion_coefficients", &d),
            matrix("rectification_matrix", &dynamic3(&self.rectification)),
            matrix(
                "projection_matrix",
                &DMatrix::from_column_slice(3, 4, self.projection.as_slice()),
            ),
        ]
        .concat()
    }
}

/// Reads a `camera_info` file.
///
/// # Errors
/// As [`read_calibration`](super::read_calibration).
pub fn read_camera_info(path: &Path) -> Result<CameraInfo, FileError> {
    calibration::read_info(path)
}
