//! What one pose of the arm shows: a point, or a board's pose, in the left camera's frame, with
//! its covariance and its sensitivity to the calibration.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix2, Matrix2x3, Point2, Point3, UnitQuaternion, Vector3,
    Vector6,
};

use super::start::kabsch;
use crate::camera::{Camera, DistortedPx, NoPoint, StereoRig, triangulate};

/// Number of parameters of a calibration's covariance: those that both lens models use, and six
/// of the relative pose.
pub(super) fn parameters(rig: &StereoRig) -> usize {
    let of = |camera: &Camera| camera.distortion.model.used().len();
    of(&rig.left) + of(&rig.right) + 6
}

/// A measured point (translation only) or board pose.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    /// Target in the left camera's frame.
    pub left_from_target: Isometry3<f64>,
    /// Covariance from the pixels; 3x3 for a point, 6x6 for a board (translation, rotation of
    /// the camera's axes).
    pub covariance: DMatrix<f64>,
    /// Derivative by the calibration's parameters.
    pub by_calibration: DMatrix<f64>,
    /// Squared residual of all pixels \[px2\].
    pub square_px: f64,
    /// Degrees of freedom of that residual.
    pub freedom: usize,
}

/// Triangulates a point.
pub(super) fn point(
    rig: &StereoRig,
    pixels: [Point2<f64>; 2],
    sigma_px: f64,
) -> Result<Measured, NoPoint> {
    let px = pixels.map(DistortedPx);
    let found = triangulate(&rig.views(), &px, &[Matrix2::identity(); 2])?;
    let pose = Isometry3::from_parts(found.position.coords().into(), UnitQuaternion::identity());
    let none = || NoPoint::NoMeeting { angle_rad: 0.0 };
    let n = normal(
        rig,
        &pose,
        &[Vector3::zeros()],
        [&[pixels[0]], &[pixels[1]]],
        3,
    )
    .ok_or_else(none)?;
    n.measured(pose, sigma_px, 1).ok_or_else(none)
}

/// The most likely pose of a board, by its corners' reprojection in both images.
pub(super) fn board(
    rig: &StereoRig,
    corners: &[Point2<f64>],
    pixels: [&[Point2<f64>]; 2],
    sigma_px: f64,
) -> Result<Option<Measured>, NoPoint> {
    let views = rig.views();
    let unit = [Matrix2::identity(); 2];
    let mut seen = Vec::with_capacity(corners.len());
    for (l, r) in pixels[0].iter().zip(pixels[1]) {
        let found = triangulate(&views, &[DistortedPx(*l), DistortedPx(*r)], &unit)?;
        seen.push(*found.position.point());
    }
    let flat: Vec<Vector3<f64>> = corners
        .iter()
        .map(|c| Vector3::new(c.x, c.y, 0.0))
        .collect();
    let flat_points: Vec<_> = flat.iter().copied().map(Point3::from).collect();
    Ok(kabsch(&flat_points, &seen).and_then(|start| refined(rig, start, &flat, pixels, sigma_px)))
}

fn refined(
    rig: &StereoRig,
    start: Isometry3<f64>,
    flat: &[Vector3<f64>],
    pixels: [&[Point2<f64>]; 2],
    sigma_px: f64,
) -> Option<Measured> {
    let mut pose = start;
    for _ in 0..10 {
        let n = normal(rig, &pose, flat, pixels, 6)?;
        let step = n.information.clone().cholesky()?.solve(&n.gradient);
        let step = Vector6::from_column_slice(step.as_slice());
        let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
        pose = Isometry3::from_parts(
            (pose.translation.vector + step.fixed_rows::<3>(0)).into(),
            turn * pose.rotation,
        );
        if step.norm() < 1e-11 {
            break;
        }
    }
    normal(rig, &pose, flat, pixels, 6)?.measured(pose, sigma_px, flat.len())
}

/// Normal equations of the reprojection.
struct Normal {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    /// J^T times the derivative of the projections by the calibration.
    cross: DMatrix<f64>,
    square: f64,
}

impl Normal {
    fn measured(self, pose: Isometry3<f64>, sigma_px: f64, points: usize) -> Option<Measured> {
        let factor = self.information.cholesky()?;
        let size = self.gradient.len();
        Some(Measured {
            left_from_target: pose,
            by_calibration: -factor.solve(&self.cross),
            covariance: factor.inverse() * (sigma_px * sigma_px),
            square_px: self.square,
            freedom: (4 * points).saturating_sub(size),
        })
    }
}

/// `size` is 3 for a translation, 6 with a rotation.
fn normal(
    rig: &StereoRig,
    pose: &Isometry3<f64>,
    flat: &[Vector3<f64>],
    pixels: [&[Point2<f64>]; 2],
    size: usize,
) -> Option<Normal> {
    let mut n = Normal {
        information: DMatrix::zeros(size, size),
        gradient: DVector::zeros(size),
        cross: DMatrix::zeros(size, parameters(rig)),
        square: 0.0,
    };
    for (side, view) in rig.views().iter().enumerate() {
        for (x, px) in flat.iter().zip(pixels[side]) {
            let arm = pose.rotation * x;
            let at = arm + pose.translation.vector;
            let (model, by_point) = view.project_with_derivative(&at)?;
            let mut j = DMatrix::zeros(2, size);
            j.view_mut((0, 0), (2, 3)).copy_from(&by_point);
            if size == 6 {
                let turn: Matrix2x3<f64> = -by_point * arm.cross_matrix();
                j.view_mut((0, 3), (2, 3)).copy_from(&turn);
            }
            let e = px - model.0;
            n.information += j.transpose() * &j;
            n.gradient += j.transpose() * e;
            n.cross += j.transpose() * by_calibration(rig, side, &at)?;
            n.square += e.norm_squared();
        }
    }
    Some(n)
}

/// Derivative of a projection by the calibration's parameters.
fn by_calibration(rig: &StereoRig, side: usize, at: &Vector3<f64>) -> Option<DMatrix<f64>> {
    let view = &rig.views()[side];
    let mut j = DMatrix::zeros(2, parameters(rig));
    let p = (view.camera_from_left * Point3::from(*at)).coords;
    let direction = match &view.window {
        None => p,
        Some(w) => w.direction_to(&p)?.direction,
    };
    let intrinsic = view.camera.project_with_all_derivatives(&direction)?;
    let first = side * rig.left.distortion.model.used().len();
    for (k, &place) in view.camera.distortion.model.used().iter().enumerate() {
        j.set_column(first + k, &intrinsic.by_intrinsics.column(place));
    }
    if side == 1 {
        // Translation and rotation of right-from-left, along the right camera's axes.
        let (_, by_left) = view.project_with_derivative(at)?;
        let rotation = view.camera_from_left.rotation.to_rotation_matrix();
        let by_right: Matrix2x3<f64> = by_left * rotation.matrix().transpose();
        let turned = view.camera_from_left.rotation * at;
        let pose = parameters(rig) - 6;
        j.view_mut((0, pose), (2, 3)).copy_from(&by_right);
        j.view_mut((0, pose + 3), (2, 3))
            .copy_from(&(-by_right * turned.cross_matrix()));
    }
    Some(j)
}
