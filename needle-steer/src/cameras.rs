//! The cameras of a configuration, and what the controller is told about them.

use std::path::{Path, PathBuf};

use hal::Transform;
use hal::frame::{LeftCamera, RightCamera, World};
use nalgebra::Isometry3;
use phantom::camera::{self as truth, CameraSettings, RigParameters};
use vision::StereoRig;
use vision::camera::{Camera, Container, Distortion, FlatWindow};
use vision::files::{FileError, ReadOptions, read_calibration};
use vision::register::read_registration;

use crate::config::Config;

/// Settings of the simulated cameras: those of the phantom's preset, at the width asked for,
/// with the configuration's changes.
///
/// # Errors
/// An unknown preset or key, or a wrong type.
pub fn settings(config: &Config) -> Result<CameraSettings, phantom::SettingsError> {
    let preset = CameraSettings::preset(&config.run.phantom)?;
    let sized = if config.cameras.width_px == preset.width_px {
        preset
    } else {
        preset.at_1280()
    };
    sized.overridden(config.cameras.simulated.clone())
}

/// What was measured of real cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// The calibrated cameras.
    pub rig: StereoRig,
    /// Where the left one stands.
    pub world_from_left_camera: Transform<World, LeftCamera>,
}

/// Calibration and registration of real cameras, where the configuration names them.
///
/// # Errors
/// A file cannot be read or is none.
pub fn measured(config: &Config) -> Result<Option<Measured>, FileError> {
    let cameras = &config.cameras;
    if cameras.calibration.is_empty() {
        return Ok(None);
    }
    let files: Vec<PathBuf> = [&cameras.calibration, &cameras.second_calibration]
        .into_iter()
        .filter(|name| !name.is_empty())
        .map(PathBuf::from)
        .collect();
    let options = ReadOptions {
        unit: (cameras.unit_mm > 0.0).then_some(cameras.unit_mm * 1e-3),
        image_sizes: None,
    };
    Ok(Some(Measured {
        rig: read_calibration(&files, &options)?.file.rig,
        world_from_left_camera: read_registration(Path::new(&cameras.registration))?,
    }))
}

/// A rig as `vision` takes it from the phantom's parameters.
pub fn calibrated(parameters: &RigParameters) -> StereoRig {
    let camera = |lens: &truth::Lens| Camera {
        width: parameters.width_px,
        height: parameters.height_px,
        fx: lens.fx,
        fy: lens.fy,
        cx: lens.cx,
        cy: lens.cy,
        distortion: Distortion::from_array(lens.distortion),
    };
    let given = &parameters.container;
    let window = |plane: &truth::Plane, camera_from_left: &Isometry3<f64>| {
        let normal = camera_from_left.rotation * -plane.normal;
        FlatWindow {
            normal,
            distance: (camera_from_left * plane.point.point()).coords.dot(&normal),
            thickness: given.wall_thickness,
            wall_index: given.wall_index,
            gel_index: given.gel_index,
        }
    };
    let right_from_left: Transform<RightCamera, LeftCamera> = parameters.right_from_left;
    StereoRig {
        left: camera(&parameters.left),
        right: camera(&parameters.right),
        right_from_left,
        container: Some(Container {
            left: window(&given.left_wall, &Isometry3::identity()),
            right: window(&given.right_wall, right_from_left.isometry()),
        }),
    }
}
