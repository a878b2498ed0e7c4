//! Calibrations as files that other tools read: ROS `camera_info` YAML and OpenCV
//! `FileStorage` YAML; images, folders of them, and pictures of what was tracked in them.

mod calibration;
mod camera_info;
mod folder;
mod kalibr;
mod images;
mod opencv;
mod overlay;

pub use calibration::{ReadCalibration, ReadOptions, read_calibration, read_camera};
pub use camera_info::{CameraInfo, camera_info, camera_info_of, read_camera_info};
pub use folder::{FolderError, ImageFolder};
pub use images::{Pixels, read_image, read_image_of, read_images, same_size};
pub use kalibr::camchain;
pub use opencv::{StereoFile, read_stereo, stereo_yml};
pub use overlay::write_overlay;

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// A file that could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file that would be written is there already.
    #[error(
        "{}: is there already, of an earlier command, and nothing is written over; name another \
         folder or file",
        path.display()
    )]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file is no image, or of an unknown kind.
    #[error("{}: not a readable image: {source}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What the decoder said.
        source: image::ImageError,
    },
    /// A picture could not be coded.
    #[error("{}: cannot be coded: {source}", path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// What the encoder said.
        source: image::ImageError,
    },
    /// The file is no YAML.
    #[error("{}: not YAML: {source}", path.display())]
    Yaml {
        /// The file.
        path: PathBuf,
        /// What the parser said.
        source: yaml_rust2::ScanError,
    },
    /// The file is no JSON of the expected form.
    #[error(
        "{}:{}:{}: not the JSON that is expected: {}",
        path.display(),
        source.line(),
        source.column(),
        without_place(&source.to_string())
    )]
    Json {
        /// The file.
        path: PathBuf,
        /// What the parser said, with line and key.
        source: serde_json::Error,
    },
    /// The file is no XML.
    #[error("{}: not XML: {reason}", path.display())]
    Xml {
        /// The file.
        path: PathBuf,
        /// What the parser said.
        reason: String,
    },
    /// A file of another kind.
    #[error("{}: {what}; {remedy}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What it is.
        what: String,
        /// The way round.
        remedy: String,
    },
    /// A key is missing.
    #[error("{files}: no `{key}` ({meaning}); the file has {found}")]
    MissingKey {
        /// The files searched.
        files: String,
        /// The key.
        key: String,
        /// What it would hold, and its other names.
        meaning: String,
        /// The keys that are there.
        found: String,
    },
    /// A lens that is not supported, or not what its label says.
    #[error("{}: key `{key}`: {why}", path.display())]
    Lens {
        /// The file.
        path: PathBuf,
        /// The key.
        key: String,
        /// What is wrong.
        why: String,
    },
    /// A baseline that is not plausible in metres.
    #[error("{}: key `{key}`: baseline {baseline_m:.4} m: {remedy}", path.display())]
    Baseline {
        /// The file.
        path: PathBuf,
        /// The key that holds it.
        key: String,
        /// The baseline \[m\].
        baseline_m: f64,
        /// What to do.
        remedy: String,
    },
    /// A key is of another kind.
    #[error("{}: key `{key}`: expected {expected}", path.display())]
    Key {
        /// The file.
        path: PathBuf,
        /// The key.
        key: String,
        /// What should be there.
        expected: String,
    },
    /// The values make no camera.
    #[error("{}: {source}", path.display())]
    Camera {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: crate::camera::InvalidCamera,
    },
    /// The values make no window.
    #[error("{}: {source}", path.display())]
    Window {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: crate::camera::InvalidWindow,
    },
    /// A calibration for images of another size: of another camera.
    #[error(
        "{}: calibrates images of {calibrated_width} x {calibrated_height}, these have \
         {width} x {height}: the calibration of another camera",
        path.display()
    )]
    OtherCamera {
        /// The calibration file.
        path: PathBuf,
        /// Calibrated width \[px\].
        calibrated_width: usize,
        /// Calibrated height \[px\].
        calibrated_height: usize,
        /// Width of the images \[px\].
        width: usize,
        /// Height of the images \[px\].
        height: usize,
    },
    /// Images of one camera that differ in size.
    #[error(
        "{}: {width} x {height} pixels, but {} has {first_width} x {first_height}",
        path.display(),
        first.display()
    )]
    MixedSizes {
        /// The image.
        path: PathBuf,
        /// Its width \[px\].
        width: usize,
        /// Its height \[px\].
        height: usize,
        /// The first image.
        first: PathBuf,
        /// Its width \[px\].
        first_width: usize,
        /// Its height \[px\].
        first_height: usize,
    },
}

/// Writes whole new files or none (an empty file counts as none): each text first goes to a file beside its place, and only when
/// all are on disk do they take their names.
///
/// # Errors
/// One of them is there already, or the system refused; nothing has been written over, and none of
/// them is left.
pub fn write_all(files: &[(PathBuf, String)]) -> Result<(), FileError> {
    let aside = |path: &Path| {
        let mut name = path.as_os_str().to_owned();
        name.push(".part");
        PathBuf::from(name)
    };
    let refused = |path: &Path| {
        let path = path.to_owned();
        move |source| FileError::Io { path, source }
    };
    let exists = |path: &Path| FileError::Exists {
        path: path.to_owned(),
    };
    if let Some((path, _)) = files.iter().find(|(path, _)| holds(path)) {
        return Err(exists(path));
    }
    // Names taken so far.
    let mut taken: Vec<&Path> = Vec::new();
    let mut write = || -> Result<(), FileError> {
        for (path, text) in files {
            fs::write(aside(path), text).map_err(refused(path))?;
        }
        for (path, _) in files {
            let mut new = fs::OpenOptions::new();
            match new.write(true).create_new(true).open(path) {
                Ok(_) => taken.push(path),
                Err(e) if e.kind() == ErrorKind::AlreadyExists => {
                    if holds(path) {
                        return Err(exists(path));
                    }
                }
                Err(e) => return Err(refused(path)(e)),
            }
            fs::rename(aside(path), path).map_err(refused(path))?;
        }
        Ok(())
    };
    let written = write();
    if written.is_err() {
        // What was never written cannot be removed.
        for (path, _) in files {
            let _ = fs::remove_file(aside(path));
        }
        for path in taken {
            let _ = fs::remove_file(path);
        }
    }
    written
}

/// What a parser says, less the line and column that are told before.
fn without_place(said: &str) -> &str {
    said.rfind(" at line ").map_or(said, |end| &said[..end])
}

/// Whether something is there that would be lost: an empty file, as `mktemp` makes, is nothing.
fn holds(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| !found.is_file() || found.len() > 0)
}

/// A number with all its digits; with a point as OpenCV's reader needs it, and a sign before the
/// exponent: without one it is a text to YAML 1.1, which Python reads ROS's and Kalibr's files by.
fn digits(value: f64) -> String {
    let text = format!("{value:.16e}");
    match text.split_once('e') {
        Some((mantissa, power)) if !power.starts_with('-') => format!("{mantissa}e+{power}"),
        _ => text,
    }
}

/// Numbers on lines of at most four.
fn list(values: impl IntoIterator<Item = f64>) -> String {
    let words: Vec<String> = values.into_iter().map(digits).collect();
    let lines: Vec<String> = words.chunks(4).map(|c| c.join(", ")).collect();
    lines.join(",\n      ")
}
