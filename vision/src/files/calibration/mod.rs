//! One reader for the calibration files of this and other programs.
//!
//! OpenCV's `FileStorage` (YAML, XML, JSON; one file or intrinsics and extrinsics apart), ROS's
//! `camera_info` of both cameras, Kalibr's `camchain`, `EuRoC`'s sensor files, and hand-written
//! variants of their names. Labels of the lens model are honoured, rotations made orthonormal,
//! lengths checked for plausibility; whatever is neither understood nor harmless is refused by
//! its name.

mod keys;
mod lens;
mod node;
mod pose;
mod stereo;
mod syntax;

use std::path::{Path, PathBuf};

use nalgebra::{DMatrix, Matrix3, Matrix3x4};

use super::{CameraInfo, FileError, StereoFile};
use crate::camera::Camera;
use keys::{MATRIX, PROJECTION, RECTIFICATION};
use node::Node;

pub(super) use keys::{Affix, Keys, NEITHER};

/// What the files do not say.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReadOptions {
    /// Length of the files' unit \[m\]: 1e-3 where translations are millimetres, a square's side
    /// where they are squares. `None` for metres, which are then checked for plausibility.
    pub unit: Option<f64>,
    /// Sizes of the left and right camera's images \[px\], for files that name none.
    pub image_sizes: Option<[(usize, usize); 2]>,
}

/// A calibration read from files.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadCalibration {
    /// The rig, with what our own files add to it.
    pub file: StereoFile,
    /// What a user should know: a rotation that was made orthonormal, a fisheye.
    pub notes: Vec<String>,
}

/// Reads the calibration of two cameras from one file, or from two: both cameras' own files
/// (left first), or intrinsics and extrinsics.
///
/// # Errors
/// A file cannot be read or is of another kind, a value is missing, wrong or not supported, or
/// the baseline is not plausible.
pub fn read_calibration(
    paths: &[PathBuf],
    options: &ReadOptions,
) -> Result<ReadCalibration, FileError> {
    let documents = paths
        .iter()
        .map(|path| Ok((path.as_path(), syntax::read(path)?)))
        .collect::<Result<Vec<_>, FileError>>()?;
    if documents.len() > 2 {
        return Err(FileError::Foreign {
            path: documents[2].0.to_owned(),
            what: "a third calibration file".to_owned(),
            remedy: "give one file, or two: both cameras', or intrinsics and extrinsics".to_owned(),
        });
    }
    let each_a_camera = documents.len() == 2 && documents.iter().all(is_one_camera);
    let keys = Keys::new(&documents, each_a_camera);
    let read = stereo::read(&keys, options);
    match read {
        // A file of parameters that holds no calibration is better named than searched.
        Err(FileError::MissingKey { .. }) => {
            Err(documents.iter().find_map(parameters).unwrap_or_else(|| {
                let one = documents.first().filter(|_| documents.len() == 1);
                one.filter(|d| is_one_camera(d))
                    .map_or_else(|| read.err(), |(path, _)| Some(alone(path)))
                    .unwrap_or_else(|| keys.missing("M1", ""))
            }))
        }
        other => other,
    }
}

/// Reads the calibration of one camera; `image_size` counts where the file names none.
///
/// # Errors
/// As [`read_calibration`].
pub fn read_camera(
    path: &Path,
    image_size: Option<(usize, usize)>,
) -> Result<(Camera, Vec<String>), FileError> {
    let document = (path, syntax::read(path)?);
    if let Some(named) = parameters(&document).filter(|_| !is_one_camera(&document)) {
        return Err(named);
    }
    let mut notes = Vec::new();
    let keys = Keys::new(&[document], false);
    let camera = stereo::one_camera(&keys, NEITHER, None, image_size, &mut notes)?;
    Ok((camera, notes))
}

/// Whether a document holds a camera matrix that belongs to no side.
fn is_one_camera(document: &(&Path, Node)) -> bool {
    let keys = Keys::new(core::slice::from_ref(document), false);
    keys.find_where(NEITHER, MATRIX, |node| {
        node.matrix().is_some_and(|m| m.len() == 9 || m.len() == 4)
    })
    .is_some()
}

fn alone(path: &Path) -> FileError {
    FileError::Foreign {
        path: path.to_owned(),
        what: "the calibration of one camera".to_owned(),
        remedy: "give both cameras' files, the left one's first: --calibration left.yaml \
                 right.yaml"
            .to_owned(),
    }
}

/// Names a ROS 2 parameter file.
fn parameters((path, node): &(&Path, Node)) -> Option<FileError> {
    fn holds(node: &Node) -> bool {
        let Node::Map(entries) = node else {
            return false;
        };
        entries
            .iter()
            .any(|(key, value)| key == "ros__parameters" || holds(value))
    }
    holds(node).then(|| FileError::Foreign {
        path: (*path).to_owned(),
        what: "a ROS 2 parameter file without a calibration".to_owned(),
        remedy: "give the camera_info files that its `camera_info_url` names: --calibration \
                 left.yaml right.yaml"
            .to_owned(),
    })
}

/// Reads one camera's `camera_info`.
pub(super) fn read_info(path: &Path) -> Result<CameraInfo, FileError> {
    let keys = Keys::new(&[(path, syntax::read(path)?)], false);
    let camera = stereo::one_camera(&keys, NEITHER, None, None, &mut Vec::new())?;
    let of = |names: &[&str], cols: usize| {
        let found = keys.find(NEITHER, names);
        let found = found.ok_or_else(|| keys.missing(names[0], "of camera_info"))?;
        let m = found.matrix()?;
        match m.shape() {
            (3, c) if c == cols => Ok(m),
            (n, 1) if n == 3 * cols => Ok(DMatrix::from_row_slice(3, cols, m.as_slice())),
            _ => Err(found.wrong(&format!("a matrix of 3 x {cols}"))),
        }
    };
    let name = keys.find(NEITHER, &["cameraname", "name"]);
    Ok(CameraInfo {
        name: name
            .and_then(|found| found.node.text())
            .unwrap_or_default()
            .to_owned(),
        camera,
        rectification: Matrix3::from_column_slice(of(RECTIFICATION, 3)?.as_slice()),
        projection: Matrix3x4::from_column_slice(of(PROJECTION, 4)?.as_slice()),
    })
}
