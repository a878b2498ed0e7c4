//! Calibrations as files that other tools read: ROS `camera_info` YAML and OpenCV
//! `FileStorage` YAML; images, folders of them, and pictures of what was tracked in them.

mod camera_info;
mod folder;
mod opencv;
mod overlay;
mod yaml;

pub use camera_info::{CameraInfo, camera_info, read_camera_info};
pub use folder::{FolderError, ImageFolder};
pub use opencv::{StereoFile, read_stereo, stereo_yml};
pub use overlay::write_overlay;

use std::fs;
use std::path::{Path, PathBuf};

use hal::GrayImage;

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
    #[error("{}: {source}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// What the parser said, with line and key.
        source: serde_json::Error,
    },
    /// A key is missing or of another kind.
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

/// Reads an image as grey values.
///
/// # Errors
/// The file cannot be read or decoded.
pub fn read_image(path: &Path) -> Result<GrayImage, FileError> {
    let bytes = fs::read(path).map_err(|source| FileError::Io {
        path: path.to_owned(),
        source,
    })?;
    let image = image::load_from_memory(&bytes)
        .map_err(|source| FileError::Image {
            path: path.to_owned(),
            source,
        })?
        .into_luma8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    let mut grey = GrayImage::filled(width, height, 0);
    grey.pixels_mut().copy_from_slice(image.as_raw());
    Ok(grey)
}

/// The size that all images have, from their headers alone \[px\]; zero without images.
///
/// # Errors
/// A file cannot be read, is no image, or differs in size from the first.
pub fn same_size<'a>(
    paths: impl IntoIterator<Item = &'a PathBuf>,
) -> Result<(usize, usize), FileError> {
    let mut first: Option<(&PathBuf, (usize, usize))> = None;
    for path in paths {
        let io = |source| FileError::Io {
            path: path.clone(),
            source,
        };
        let (width, height) = image::ImageReader::open(path)
            .and_then(image::ImageReader::with_guessed_format)
            .map_err(io)?
            .into_dimensions()
            .map_err(|source| FileError::Image {
                path: path.clone(),
                source,
            })?;
        let size = (width as usize, height as usize);
        match first {
            None => first = Some((path, size)),
            Some((_, (first_width, first_height))) if size == (first_width, first_height) => {}
            Some((first, (first_width, first_height))) => {
                return Err(FileError::MixedSizes {
                    path: path.clone(),
                    width: size.0,
                    height: size.1,
                    first: first.clone(),
                    first_width,
                    first_height,
                });
            }
        }
    }
    Ok(first.map_or((0, 0), |(_, size)| size))
}

/// Reads images that must all have the same size.
///
/// # Errors
/// A file cannot be read or decoded, or differs in size from the first.
pub fn read_images(paths: &[PathBuf]) -> Result<Vec<GrayImage>, FileError> {
    let mut images: Vec<GrayImage> = Vec::with_capacity(paths.len());
    for path in paths {
        let image = read_image(path)?;
        if let (Some(first), Some(first_path)) = (images.first(), paths.first())
            && (first.width(), first.height()) != (image.width(), image.height())
        {
            return Err(FileError::MixedSizes {
                path: path.clone(),
                width: image.width(),
                height: image.height(),
                first: first_path.clone(),
                first_width: first.width(),
                first_height: first.height(),
            });
        }
        images.push(image);
    }
    Ok(images)
}

/// Writes whole files or none: each text first goes to a file beside its place, and only when
/// all are on disk do they take their names.
///
/// # Errors
/// The system refused; nothing has been written over then.
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
    let written = files
        .iter()
        .try_for_each(|(path, text)| fs::write(aside(path), text).map_err(refused(path)));
    if written.is_err() {
        for (path, _) in files {
            // What was never written cannot be removed.
            let _ = fs::remove_file(aside(path));
        }
        return written;
    }
    files
        .iter()
        .try_for_each(|(path, _)| fs::rename(aside(path), path).map_err(refused(path)))
}

fn read_text(path: &Path) -> Result<String, FileError> {
    fs::read_to_string(path).map_err(|source| FileError::Io {
        path: path.to_owned(),
        source,
    })
}
