//! What a calibration that says nothing of its errors is worth: as much as an ordinary one.

use nalgebra::{
    DMatrix, Isometry3, Matrix3, Point2, Point3, Rotation3, SMatrix, UnitQuaternion, Vector3,
};

use super::super::bundle::{Bundle, inverse, reduced};
use super::super::normal::Observed;
use super::joint::{Joint, SHARED};
use super::outcome::used_parameters;
use crate::camera::{Camera, StereoRig};

/// Pairs of a board: the least that docs/CALIBRATION.md asks for.
const VIEWS: u32 = 12;
/// Points of the board along a row and a column.
const BOARD: (u32, u32) = (9, 6);
/// Length of its rows over the width of what the narrower camera sees \[1\].
const SPAN: f64 = 0.45;
/// Farthest shift of the board, over that width \[1\].
const SHIFT: f64 = 0.2;
/// Farthest shift along the view, over the distance \[1\].
const NEARER: f64 = 0.15;
/// Tilts of the board \[rad\]: 15 to 30 degrees.
const TILT: (f64, f64) = (0.26, 0.52);
/// Turn from one view to the next, which spreads any number of them \[rad\]: the golden angle.
const NEXT: f64 = 2.399_963;
/// Residual beyond which a corner counts less \[px\]; these have none.
const HUBER_PX: f64 = 1.0;

/// Covariance of the parameters of `rig`, in the order of
/// [`StereoCalibration::covariance`](super::StereoCalibration::covariance), if it came from
/// an ordinary session: 12 pairs of a chessboard about `centre` (left camera's frame), tilted by 15 to 30 degrees,
/// corners to `corner_sigma_px` per axis. Nothing where such boards could not be seen.
pub fn assumed_covariance(
    rig: &StereoRig,
    centre: &Point3<f64>,
    corner_sigma_px: f64,
) -> Option<DMatrix<f64>> {
    let distance = centre.coords.norm();
    let seen = |camera: &Camera| camera.width as f64 / camera.fx;
    let width = distance * seen(&rig.left).min(seen(&rig.right));
    let square = SPAN * width / f64::from(BOARD.0 - 1);
    let board: Vec<Point2<f64>> = (0..BOARD.1)
        .flat_map(|row| (0..BOARD.0).map(move |column| (column, row)))
        .map(|(column, row)| Point2::new(f64::from(column), f64::from(row)) * square)
        .collect();
    let right_from_left = *rig.right_from_left.isometry();
    let poses = poses(centre, &right_from_left, width, square)?;
    let observe = |camera: &Camera, camera_from_left: &Isometry3<f64>| -> Vec<Observed> {
        let one = |pose: &Isometry3<f64>| {
            let pose = camera_from_left * pose;
            board
                .iter()
                .map(|p| pixel(camera, &(pose * Point3::new(p.x, p.y, 0.0))))
                .collect()
        };
        poses.iter().map(one).collect()
    };
    let observed = [
        observe(&rig.left, &Isometry3::identity()),
        observe(&rig.right, &right_from_left),
    ];
    let joint = Joint {
        left: rig.left,
        right: rig.right,
        right_from_left,
        left_from_board: poses.clone(),
        board: &board,
        observed: [&observed[0], &observed[1]],
        huber_px: HUBER_PX,
    };
    let mut information = SMatrix::<f64, SHARED, SHARED>::zeros();
    for block in joint.linearise()?.0 {
        information += reduced(&block)?.0;
    }
    let covariance = inverse(&information)? * (corner_sigma_px * corner_sigma_px);
    let used = used_parameters(rig);
    Some(DMatrix::from_fn(used.len(), used.len(), |i, j| {
        covariance[(used[i], used[j])]
    }))
}

/// A point's pixel, where it is in the image.
fn pixel(camera: &Camera, point: &Point3<f64>) -> Option<Point2<f64>> {
    let px = camera.project_with_all_derivatives(&point.coords)?.px.0;
    let inside = |x: f64, size: usize| x >= 0.0 && x <= size as f64 - 1.0;
    (inside(px.x, camera.width) && inside(px.y, camera.height)).then_some(px)
}

/// Boards about `centre` that face between both cameras, tilted to all sides.
fn poses(
    centre: &Point3<f64>,
    right_from_left: &Isometry3<f64>,
    width: f64,
    square: f64,
) -> Option<Vec<Isometry3<f64>>> {
    let right = right_from_left.inverse() * Point3::origin();
    let views = centre.coords.normalize() + (centre - right).normalize();
    let z = views.try_normalize(f64::EPSILON)?;
    let baseline = right.coords - z * z.dot(&right.coords);
    // Cameras one behind the other have no side.
    let x = baseline.try_normalize(f64::EPSILON).unwrap_or_else(|| {
        let across = Vector3::x() - z * z.x;
        across.normalize()
    });
    let facing = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    let middle = Vector3::new(f64::from(BOARD.0 - 1), f64::from(BOARD.1 - 1), 0.0) * (0.5 * square);
    Some(
        (0..VIEWS)
            .map(|k| {
                let part = f64::from(k) / f64::from(VIEWS - 1);
                let azimuth = NEXT * f64::from(k);
                let axis = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0);
                let tilt = TILT.0 + (TILT.1 - TILT.0) * part;
                let turn = facing * Rotation3::from_scaled_axis(axis * tilt);
                let shift = Vector3::new(
                    SHIFT * width * part * (azimuth * 0.5).cos(),
                    SHIFT * width * part * (azimuth * 0.5).sin(),
                    NEARER * centre.coords.norm() * (2.0 * part - 1.0),
                );
                let place = centre.coords + facing * shift - turn * middle;
                Isometry3::from_parts(place.into(), UnitQuaternion::from_rotation_matrix(&turn))
            })
            .collect(),
    )
}
