//! The cameras of a configuration, and what the controller is told about them.

use std::path::{Path, PathBuf};

use hal::Transform;
use hal::frame::{LeftCamera, RightCamera, World};
use nalgebra::{Isometry3, Point3, Vector3};
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

/// Least angle between the cameras' planes through the needle \[rad\]: below, an error across an
/// image becomes one of twenty times its size in space.
pub const LEAST_OPENING: f64 = 0.05;

/// Angle between the planes that join the needle's axis (a point and a direction in World) to the
/// cameras' centres \[rad\], 0 to pi / 2. At 0 the axis and both cameras lie in one plane, as where
/// the needle runs along the baseline: then no pair of images says how far away it is.
pub fn opening(
    rig: &StereoRig,
    world_from_left_camera: &Transform<World, LeftCamera>,
    point: &Point3<f64>,
    direction: &Vector3<f64>,
) -> f64 {
    let left = world_from_left_camera.isometry();
    let right = left * rig.right_from_left.isometry().inverse();
    let normal = |camera: &Isometry3<f64>| {
        let to_needle = point.coords - camera.translation.vector;
        direction.cross(&to_needle)
    };
    let (a, b) = (normal(left), normal(&right));
    a.cross(&b).norm().atan2(a.dot(&b).abs())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_needle_along_the_baseline_opens_no_angle_between_the_cameras() {
        let config = Config::default();
        let parameters = truth::StereoRig::new(
            &settings(&config).unwrap(),
            &config.world_from_entry(),
            1001,
        )
        .unwrap();
        let mut rig = calibrated(parameters.given());
        let left = Transform::assume(Isometry3::identity());
        let at = Point3::new(0.02, 0.01, 0.4);
        // Parallel cameras, 0.1 m apart along x.
        rig.right_from_left = Transform::assume(Isometry3::translation(-0.1, 0.0, 0.0));
        let opened = |direction: Vector3<f64>| opening(&rig, &left, &at, &direction);
        assert!(opened(Vector3::x()) < 1e-12);
        // In the plane of both centres and the needle.
        assert!(opened(at.coords.normalize()) < 1e-12);
        let across = opened(Vector3::y());
        assert!((across - 0.1_f64.atan2(0.4)).abs() < 0.02, "{across}");
        assert!(across > LEAST_OPENING);
    }
}
