//! The covariance of a stereo calibration, to first order: views of a known board in both cameras, corners with independent errors, all intrinsics (f, c, five
//! distortion coefficients of each camera) and extrinsics free, the boards' poses eliminated by a
//! Schur complement. Errors of focal length, principal point and extrinsics therefore come
//! correlated as a real calibration leaves them, and largely cancel where the boards were.

use hal::Transform;
use nalgebra::{
    Cholesky, Isometry3, Point3, Rotation3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3,
};
use rand::RngExt;

use super::board::BoardView;
use super::lens::{Lens, Pixel};
use super::noise::{Stream, generator};
use super::parameters::RigParameters;
use super::settings::CalibrationSettings;

/// Left intrinsics (9), right intrinsics (9), rotation and translation of the right camera (6).
const PARAMETERS: usize = 24;
type Information = SMatrix<f64, PARAMETERS, PARAMETERS>;
pub(super) type Parameters = SVector<f64, PARAMETERS>;

/// Steps of the central differences; also the units in which the information is assembled.
const LENS_STEPS: [f64; 9] = [1e-1, 1e-1, 1e-1, 1e-1, 1e-3, 1e-3, 1e-4, 1e-4, 1e-2];
const POSE_STEPS: [f64; 6] = [1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5];

/// One standard deviation of each parameter of a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationSigma {
    /// fx, fy, cx, cy \[px\], k1, k2, p1, p2, k3 of the left and the right camera.
    pub lenses: [[f64; 9]; 2],
    /// Rotation of `right_from_left`, per axis of the right camera \[rad\].
    pub rotation: [f64; 3],
    /// Translation of `right_from_left` \[m\].
    pub translation: [f64; 3],
}

/// The views do not determine the calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{views} views of the board with {corners} visible corners do not determine the calibration"
)]
pub struct Undetermined {
    /// Number of views.
    pub views: usize,
    /// Corners visible, both cameras together.
    pub corners: usize,
}

/// Poses of a board as an operator would hold it: about the middle of the rig's field, turned
/// up to 29 degrees about its axes, facing between the cameras; a board of 9 x 6 inner corners,
/// 10 mm apart.
pub fn calibration_boards(rig: &RigParameters, views: usize, seed: u64) -> Vec<BoardView> {
    let mut generator = generator(seed, Stream::Calibration, 1);
    let left_from_world = *rig.left_from_world.isometry();
    let left_from_right = rig.right_from_left.isometry().inverse();
    let axis = left_from_right.rotation * Vector3::z() + Vector3::z();
    // Where the cameras' axes pass closest, and a board's frame that faces between them.
    let centre = nearest_point(&left_from_right);
    let z = axis.normalize();
    let x = (left_from_right.translation.vector - z * z.dot(&left_from_right.translation.vector))
        .normalize();
    let facing = Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
    let (columns, rows, square) = (9, 6, 10e-3);
    let middle = Vector3::new(4.0, 2.5, 0.0) * square;
    (0..views)
        .map(|_| {
            let mut uniform = |half: f64| generator.random_range(-half..=half);
            let shift = Vector3::new(uniform(0.02), uniform(0.012), uniform(0.03));
            let turn = Rotation3::from_euler_angles(uniform(0.5), uniform(0.4), uniform(0.4));
            let rotation = facing * turn;
            let left_from_board = Isometry3::from_parts(
                Translation3::from(centre + facing * shift - rotation * middle),
                UnitQuaternion::from_rotation_matrix(&rotation),
            );
            BoardView {
                world_from_board: Transform::assume(left_from_world.inverse() * left_from_board),
                columns,
                rows,
                square,
            }
        })
        .collect()
}

/// Middle of the shortest line between the two optical axes, in the left camera's frame.
fn nearest_point(left_from_right: &Isometry3<f64>) -> Vector3<f64> {
    let (o, d) = (
        left_from_right.translation.vector,
        left_from_right.rotation * Vector3::z(),
    );
    let z = Vector3::z();
    let c = z.dot(&d);
    let det = 1.0 - c * c;
    let s = (o.dot(&z) - c * o.dot(&d)) / det;
    let t = (c * o.dot(&z) - o.dot(&d)) / det;
    0.5 * (s * z + o + t * d)
}

/// Information of the calibration in steps' units, for corners with errors of 1 px.
fn information(rig: &RigParameters, boards: &[BoardView]) -> (Information, usize) {
    let mut total = Information::zeros();
    let mut corners = 0;
    let right_from_left = *rig.right_from_left.isometry();
    for board in boards {
        let left_from_board = rig.left_from_world.isometry() * board.world_from_board.isometry();
        let mut own = Information::zeros();
        let mut cross = SMatrix::<f64, PARAMETERS, 6>::zeros();
        let mut pose = SMatrix::<f64, 6, 6>::identity() * 1e-12;
        for corner in board.corners() {
            let in_left = left_from_board * corner;
            let in_right = right_from_left * in_left;
            for (camera, point, lens) in [(0, in_left, &rig.left), (1, in_right, &rig.right)] {
                let Some(pixel) = pixel(lens, &point) else {
                    continue;
                };
                let inside = |v: f64, n: usize| (0.0..=n as f64 - 1.0).contains(&v);
                if !(inside(pixel[0], rig.width_px) && inside(pixel[1], rig.height_px)) {
                    continue;
                }
                corners += 1;
                let (of_rig, of_pose) =
                    derivatives(lens, camera, &in_left, &point, &right_from_left);
                own += of_rig.transpose() * of_rig;
                cross += of_rig.transpose() * of_pose;
                pose += of_pose.transpose() * of_pose;
            }
        }
        if let Some(inverse) = pose.try_inverse() {
            total += own - cross * inverse * cross.transpose();
        }
    }
    (total, corners)
}

/// Derivatives of a corner's pixel by the rig's parameters and by the board's pose.
fn derivatives(
    lens: &Lens,
    camera: usize,
    in_left: &Point3<f64>,
    point: &Point3<f64>,
    right_from_left: &Isometry3<f64>,
) -> (SMatrix<f64, 2, PARAMETERS>, SMatrix<f64, 2, 6>) {
    let mut of_rig = SMatrix::<f64, 2, PARAMETERS>::zeros();
    let mut of_pose = SMatrix::<f64, 2, 6>::zeros();
    let difference = |plus: Option<Pixel>, minus: Option<Pixel>| match (plus, minus) {
        (Some(p), Some(m)) => SVector::<f64, 2>::new(p[0] - m[0], p[1] - m[1]) * 0.5,
        _ => SVector::<f64, 2>::zeros(),
    };
    for (k, step) in LENS_STEPS.iter().enumerate() {
        let d = difference(
            pixel(&changed(lens, k, *step), point),
            pixel(&changed(lens, k, -step), point),
        );
        of_rig.set_column(9 * camera + k, &d);
    }
    for (k, step) in POSE_STEPS.iter().enumerate() {
        if camera == 1 {
            let d = difference(
                pixel(lens, &moved(point, k, *step)),
                pixel(lens, &moved(point, k, -step)),
            );
            of_rig.set_column(18 + k, &d);
        }
        // The board turns about the left camera's centre.
        let seen = |step: f64| {
            let p = moved(in_left, k, step);
            pixel(lens, &if camera == 0 { p } else { right_from_left * p })
        };
        of_pose.set_column(k, &difference(seen(*step), seen(-step)));
    }
    (of_rig, of_pose)
}

fn pixel(lens: &Lens, p: &Point3<f64>) -> Option<Pixel> {
    (p.z > 0.0).then(|| lens.project([p.x / p.z, p.y / p.z]))
}

pub(super) fn changed(lens: &Lens, parameter: usize, by: f64) -> Lens {
    let mut lens = *lens;
    match parameter {
        0 => lens.fx += by,
        1 => lens.fy += by,
        2 => lens.cx += by,
        3 => lens.cy += by,
        k => lens.distortion[k - 4] += by,
    }
    lens
}

/// A point after a small rotation (0-2) or translation (3-5) along an axis.
fn moved(p: &Point3<f64>, motion: usize, by: f64) -> Point3<f64> {
    let mut axis = Vector3::zeros();
    axis[motion % 3] = by;
    if motion < 3 {
        Rotation3::new(axis) * p
    } else {
        p + axis
    }
}

/// Factor of the information, in the calibration's own units of noise.
pub(super) fn factor(
    rig: &RigParameters,
    settings: &CalibrationSettings,
    seed: u64,
) -> Result<Cholesky<f64, nalgebra::Const<PARAMETERS>>, Undetermined> {
    let boards = calibration_boards(rig, settings.views, seed);
    let (information, corners) = information(rig, &boards);
    Cholesky::new(information / settings.corner_sigma_px.powi(2)).ok_or(Undetermined {
        views: settings.views,
        corners,
    })
}

/// Standard deviations of a calibration of `rig` as set; the views' poses depend on the seed.
///
/// # Errors
/// The views do not determine the calibration (corners outside the images).
pub fn calibration_sigma(
    rig: &RigParameters,
    settings: &CalibrationSettings,
    seed: u64,
) -> Result<CalibrationSigma, Undetermined> {
    let covariance = factor(rig, settings, seed)?.inverse();
    let sigma = |i: usize| covariance[(i, i)].sqrt() * step(i);
    let three = |i: usize| [sigma(i), sigma(i + 1), sigma(i + 2)];
    Ok(CalibrationSigma {
        lenses: [0, 9].map(|from| core::array::from_fn(|k| sigma(from + k))),
        rotation: three(18),
        translation: three(21),
    })
}

pub(super) fn step(parameter: usize) -> f64 {
    match parameter {
        0..18 => LENS_STEPS[parameter % 9],
        _ => POSE_STEPS[parameter - 18],
    }
}
