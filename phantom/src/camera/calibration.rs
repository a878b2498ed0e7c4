//! What a calibration believes: the truth plus an error drawn from the calibration's covariance,
//! the creep of the mounts since, and errors of container and registration.

use hal::frame::{LeftCamera, World};
use hal::{Position, Transform};
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::covariance::{Parameters, Undetermined, changed, factor, step};
use super::noise::{Stream, generator};
use super::parameters::{Container, Plane, RigParameters};
use super::settings::CalibrationSettings;
use super::stereo_frame::stereo_from_world;

fn normal3(generator: &mut ChaCha8Rng, sigma: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| {
        let z: f64 = StandardNormal.sample(generator);
        sigma * z
    })
}

/// What a calibration and a registration make of a rig.
#[derive(Clone, Debug)]
pub(super) struct Given {
    /// The rig as the controller is told it is.
    pub(super) parameters: RigParameters,
    /// Where the frame of its reconstructions truly lies.
    pub(super) stereo_from_world: Transform<LeftCamera, World>,
}

/// Half the side of the cube in which the stereo frame is fitted \[m\].
const REACH: f64 = 0.03;

/// The rig as the controller is told it is, before a gel about `gel_centre` (World).
pub(super) fn given(
    truth: &RigParameters,
    settings: &CalibrationSettings,
    gel_centre: &Point3<f64>,
    seed: u64,
) -> Result<Given, Undetermined> {
    let mut rig = truth.clone();
    let mut generator = generator(seed, Stream::Calibration, 0);
    if settings.corner_sigma_px > 0.0 {
        let factor = factor(truth, settings, seed)?;
        let white = Parameters::from_fn(|_, _| StandardNormal.sample(&mut generator));
        let error = factor
            .l()
            .transpose()
            .solve_upper_triangular(&white)
            .unwrap_or_else(Parameters::zeros);
        for k in 0..18 {
            let lens = if k < 9 { &mut rig.left } else { &mut rig.right };
            *lens = changed(lens, k % 9, error[k] * step(k));
        }
        let part = |i: usize| Vector3::from_fn(|k, _| error[i + k] * step(i + k));
        let motion = Isometry3::new(part(21), part(18));
        rig.right_from_left = Transform::assume(motion * truth.right_from_left.isometry());
    }
    let drift = normal3(&mut generator, 1e-3 * settings.drift_mrad);
    if settings.drift_mrad > 0.0 {
        let turn = Isometry3::new(Vector3::zeros(), drift);
        rig.right_from_left = Transform::assume(turn * rig.right_from_left.isometry());
    }
    if rig != *truth {
        rig.left_from_world = stereo_from_world(truth, &rig, gel_centre, REACH);
        let stereo_from_true =
            rig.left_from_world.isometry() * truth.left_from_world.isometry().inverse();
        rig.container = moved_container(&truth.container, &stereo_from_true);
    }
    let stereo_from_world = rig.left_from_world;
    misplace_container(&mut rig, settings, &mut generator);
    misplace_laboratory(&mut rig, settings, &mut generator);
    Ok(Given {
        parameters: rig,
        stereo_from_world,
    })
}

/// The container moved as a whole.
fn moved_container(container: &Container, motion: &Isometry3<f64>) -> Container {
    let plane = |plane: &Plane| Plane {
        point: Position::new(motion * plane.point.point()),
        normal: Unit::new_normalize(motion.rotation * plane.normal.into_inner()),
    };
    Container {
        left_wall: plane(&container.left_wall),
        right_wall: plane(&container.right_wall),
        surface: plane(&container.surface),
        ..*container
    }
}

/// Container and gel as the operator measured them.
fn misplace_container(
    rig: &mut RigParameters,
    settings: &CalibrationSettings,
    generator: &mut ChaCha8Rng,
) {
    let container = &mut rig.container;
    let about = *container.surface.point.point();
    let shift = normal3(generator, 1e-3 * settings.container_mm);
    let turn = Rotation3::new(normal3(generator, settings.container_deg.to_radians()));
    let z: f64 = StandardNormal.sample(generator);
    if settings.container_mm > 0.0 || settings.container_deg > 0.0 {
        let back = Translation3::from(about.coords + shift)
            * UnitQuaternion::from_rotation_matrix(&turn)
            * Translation3::from(-about.coords);
        *container = moved_container(container, &back);
    }
    container.gel_index = (container.gel_index + settings.gel_index * z).max(1.0);
}

/// The laboratory as the registration has it: misplaced about the gel, where registration poses
/// are taken, not about its own far origin.
fn misplace_laboratory(
    rig: &mut RigParameters,
    settings: &CalibrationSettings,
    generator: &mut ChaCha8Rng,
) {
    let shift = normal3(generator, 1e-3 * settings.registration_mm);
    let turn = normal3(generator, settings.registration_deg.to_radians());
    if settings.registration_mm > 0.0 || settings.registration_deg > 0.0 {
        let about = rig.container.surface.point.coords();
        let misplaced = Translation3::from(shift + about)
            * UnitQuaternion::new(turn)
            * Translation3::from(-about);
        rig.left_from_world = Transform::assume(misplaced * rig.left_from_world.isometry());
    }
}
