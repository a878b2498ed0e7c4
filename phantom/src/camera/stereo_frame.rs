//! Where the stereo frame of a calibrated rig truly lies.
//!
//! A calibration trades principal point and orientation against each other: its left camera's
//! frame is turned from the true one by milliradians, and everything it reconstructs with it.
//! Nobody ever sees the true optical frame; registrations and targets refer to what the
//! calibrated cameras reconstruct. The stereo frame is therefore defined as the rigid frame in
//! which reconstructions agree best with the truth about the gel, container removed. What
//! deformation is left is the calibration's error.

use hal::Transform;
use hal::frame::{LeftCamera, World};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::parameters::{RigParameters, Side};
use super::view::Through;

/// Best rigid fit of the frame that `calibrated` reconstructs in to `truth`'s World, over points
/// within `reach` \[m\] of `centre` (World). Poses in `calibrated` are not read.
pub(super) fn stereo_from_world(
    truth: &RigParameters,
    calibrated: &RigParameters,
    centre: &Point3<f64>,
    reach: f64,
) -> Transform<LeftCamera, World> {
    let mut own = calibrated.clone();
    own.left_from_world = Transform::identity();
    let views = Side::BOTH.map(|side| (truth.view(side), own.view(side)));
    let mut pairs = Vec::with_capacity(125);
    for k in 0..125 {
        let step = |n: i32| reach * (0.5 * f64::from(n % 5) - 1.0);
        let world = centre + Vector3::new(step(k), step(k / 5), step(k / 25));
        let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
        for (true_view, view) in &views {
            let ray = true_view
                .project(&world, Through::OpenAir)
                .and_then(|pixel| view.ray(pixel, Through::OpenAir));
            if let Some(ray) = ray {
                let across = Matrix3::identity() - ray.direction * ray.direction.transpose();
                a += across;
                b += across * ray.origin.coords;
            }
        }
        if let Some(inverse) = a.try_inverse() {
            pairs.push((world.coords, inverse * b));
        }
    }
    Transform::assume(kabsch(&pairs))
}

/// The rigid motion that takes the first points of the pairs to the second ones.
fn kabsch(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Isometry3<f64> {
    let n = pairs.len().max(1) as f64;
    let from = pairs.iter().map(|p| p.0).sum::<Vector3<f64>>() / n;
    let to = pairs.iter().map(|p| p.1).sum::<Vector3<f64>>() / n;
    let spread: Matrix3<f64> = pairs
        .iter()
        .map(|(p, q)| (q - to) * (p - from).transpose())
        .sum();
    let svd = spread.svd(true, true);
    let rotation = match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => {
            let mut flip = Matrix3::identity();
            flip[(2, 2)] = (u * v_t).determinant().signum();
            u * flip * v_t
        }
        _ => Matrix3::identity(),
    };
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Isometry3::from_parts(Translation3::from(to - rotation * from), rotation)
}
