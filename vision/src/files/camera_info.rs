//! ROS `camera_info` YAML, as `camera_calibration` writes it and `camera_info_manager` reads it.

use std::path::Path;

use nalgebra::{DMatrix, Matrix3, Matrix3x4};

use super::FileError;
use super::yaml::{Document, list};
use crate::calibrate::rectify;
use crate::camera::{Camera, Distortion, StereoRig};

/// One camera's `camera_info`.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraInfo {
    /// The camera's name.
    pub name: String,
    /// The camera.
    pub camera: Camera,
    /// Rectifying rotation.
    pub rectification: Matrix3<f64>,
    /// Projection of the rectified image; the right camera's holds -f times the baseline.
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
                let turn = if side == 0 { r.left } else { r.right };
                #[rustfmt::skip]
                let p = Matrix3x4::new(
                    r.focal, 0.0, c.x, shift,
                    0.0, r.focal, c.y, 0.0,
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

impl CameraInfo {
    /// As a YAML document.
    pub fn to_yaml(&self) -> String {
        let c = &self.camera;
        let matrix = |key: &str, m: &DMatrix<f64>| {
            let data = list(m.transpose().iter().copied());
            let (rows, cols) = m.shape();
            format!("{key}:\n  rows: {rows}\n  cols: {cols}\n  data: [{data}]\n")
        };
        let d = DMatrix::from_row_slice(1, 5, &c.distortion.to_array());
        let dynamic3 = |m: &Matrix3<f64>| DMatrix::from_column_slice(3, 3, m.as_slice());
        [
            format!("image_width: {}\nimage_height: {}\n", c.width, c.height),
            format!("camera_name: {}\n", self.name),
            matrix("camera_matrix", &dynamic3(&c.matrix())),
            "distortion_model: plumb_bob\n".to_owned(),
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

/// Reads a `camera_info` file (model `plumb_bob`, four or five coefficients).
///
/// # Errors
/// The file cannot be read, is no YAML, or a key is missing or wrong.
pub fn read_camera_info(path: &Path) -> Result<CameraInfo, FileError> {
    let doc = Document::read(path)?;
    let model = doc.text("distortion_model")?;
    if model != "plumb_bob" {
        return Err(doc.wrong("distortion_model", "`plumb_bob`"));
    }
    let k = doc.sized("camera_matrix", 3, 3)?;
    let d = distortion(&doc, "distortion_coefficients")?;
    let camera = camera(
        &doc,
        &k,
        d,
        (doc.count("image_width")?, doc.count("image_height")?),
    )?;
    let r = doc.sized("rectification_matrix", 3, 3)?;
    let p = doc.sized("projection_matrix", 3, 4)?;
    Ok(CameraInfo {
        name: doc.text("camera_name")?.to_owned(),
        camera,
        rectification: Matrix3::from_column_slice(r.as_slice()),
        projection: Matrix3x4::from_column_slice(p.as_slice()),
    })
}

/// A camera from its matrix and distortion.
pub(super) fn camera(
    doc: &Document<'_>,
    k: &DMatrix<f64>,
    distortion: Distortion,
    (width, height): (usize, usize),
) -> Result<Camera, FileError> {
    Camera {
        width,
        height,
        fx: k[(0, 0)],
        fy: k[(1, 1)],
        cx: k[(0, 2)],
        cy: k[(1, 2)],
        distortion,
    }
    .validated()
    .map_err(|source| FileError::Camera {
        path: doc.path().to_owned(),
        source,
    })
}

/// Four or five coefficients, in a row or a column; more than five only if they are zero.
pub(super) fn distortion(doc: &Document<'_>, key: &str) -> Result<Distortion, FileError> {
    let m = doc.matrix(key)?;
    let values = m.as_slice();
    let extra_zero = values.iter().skip(5).all(|&v| v == 0.0);
    if values.len() < 4 || !(m.nrows() == 1 || m.ncols() == 1) || !extra_zero {
        return Err(doc.wrong(key, "four or five coefficients k1 k2 p1 p2 [k3]"));
    }
    let mut d = [0.0; 5];
    for (to, from) in d.iter_mut().zip(values) {
        *to = *from;
    }
    Ok(Distortion::from_array(d))
}
