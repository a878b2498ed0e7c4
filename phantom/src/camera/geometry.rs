//! From settings to the true parameters of the rig.
//!
//! In the phantom's frame (z into the gel) the gel's centre is at half its depth below the
//! origin. Both cameras lie in the horizontal plane through it, their images upright, their axes
//! at half the separation on either side of the azimuth, each along its wall's normal. At 90
//! degrees the walls make a box; at smaller separations they are two facets of a prism.

use hal::{Position, Transform};
use nalgebra::{
    Isometry3, Matrix3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3,
};

use super::lens::Lens;
use super::parameters::{Container, Plane, RigParameters};
use super::settings::CameraSettings;

/// The gel's centre in the phantom's frame \[m\].
pub(super) fn gel_centre(settings: &CameraSettings) -> Point3<f64> {
    Point3::new(0.0, 0.0, 0.5e-3 * settings.container.gel_depth_mm)
}

/// Unit vector from the gel's axis towards each camera, in the phantom's frame.
pub(super) fn towards_camera(settings: &CameraSettings, index: usize) -> Vector3<f64> {
    let half = 0.5 * settings.separation_deg.to_radians();
    let azimuth = settings.azimuth_deg.to_radians() + if index == 0 { half } else { -half };
    Vector3::new(azimuth.cos(), azimuth.sin(), 0.0)
}

/// A camera's pose in the phantom's frame.
fn phantom_from_camera(settings: &CameraSettings, index: usize) -> Isometry3<f64> {
    let towards = towards_camera(settings, index);
    let z = -towards;
    let y = Vector3::z();
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[y.cross(&z), y, z]));
    let centre = gel_centre(settings) + 1e-3 * settings.distance_mm * towards;
    Isometry3::from_parts(
        Translation3::from(centre.coords),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

/// The rig as it truly is. The settings must be valid.
pub(super) fn true_parameters(
    settings: &CameraSettings,
    world_from_phantom: &Isometry3<f64>,
) -> RigParameters {
    let lens = |index: usize| Lens {
        fx: settings.focal_px,
        fy: settings.focal_px,
        cx: 0.5 * (settings.width_px as f64 - 1.0) + settings.principal_offset_px[index][0],
        cy: 0.5 * (settings.height_px as f64 - 1.0) + settings.principal_offset_px[index][1],
        distortion: settings.distortion[index],
    };
    let phantom_from_left = phantom_from_camera(settings, 0);
    let left_from_phantom = phantom_from_left.inverse();
    let plane = |point: Point3<f64>, normal: Vector3<f64>| Plane {
        point: Position::new(left_from_phantom * point),
        normal: Unit::new_normalize(left_from_phantom.rotation * normal),
    };
    let container = &settings.container;
    let wall = |index: usize| {
        let towards = towards_camera(settings, index);
        let distance = 1e-3 * (container.gel_half_width_mm + container.wall_mm);
        plane(gel_centre(settings) + distance * towards, towards)
    };
    RigParameters {
        width_px: settings.width_px,
        height_px: settings.height_px,
        left: lens(0),
        right: lens(1),
        right_from_left: Transform::assume(
            phantom_from_camera(settings, 1).inverse() * phantom_from_left,
        ),
        left_from_world: Transform::assume(left_from_phantom * world_from_phantom.inverse()),
        container: Container {
            left_wall: wall(0),
            right_wall: wall(1),
            surface: plane(Point3::origin(), -Vector3::z()),
            wall_thickness: 1e-3 * container.wall_mm,
            wall_index: container.wall_index,
            gel_index: container.gel_index,
        },
    }
}
