//! A camera's start from homographies \[Zhang2000\], the principal point taken at the image's
//! centre.

use nalgebra::{Isometry3, Matrix2, Matrix3, Point2, Rotation3, UnitQuaternion, Vector2, Vector3};

use crate::camera::{Camera, Distortion};
use crate::homography::homography;

/// The start of a monocular fit.
#[derive(Clone, Debug)]
pub(super) struct Start {
    pub camera: Camera,
    pub camera_from_board: Vec<Isometry3<f64>>,
}

/// Closed-form camera without distortion, and the boards' poses. `None` if a view's corners
/// determine no homography. A focal length that the views do not determine is guessed.
pub(super) fn start(
    board: &[Point2<f64>],
    views: &[&[Point2<f64>]],
    (width, height): (usize, usize),
) -> Option<Start> {
    let centre = Vector2::new((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
    let mut shift = Matrix3::identity();
    shift.fixed_view_mut::<2, 1>(0, 2).copy_from(&-centre);
    let mut homographies = Vec::with_capacity(views.len());
    for corners in views {
        homographies.push(shift * homography(board, corners)?);
    }
    let guess = 1.2 * width.max(height) as f64;
    let (fx, fy) = focal_lengths(&homographies).unwrap_or((guess, guess));
    let camera = Camera {
        width,
        height,
        fx,
        fy,
        cx: centre.x,
        cy: centre.y,
        distortion: Distortion::default(),
    };
    let poses = homographies.iter().map(|h| pose(h, fx, fy)).collect();
    Some(Start {
        camera,
        camera_from_board: poses,
    })
}

/// Least squares of the two constraints that each homography puts on 1/fx^2 and 1/fy^2.
fn focal_lengths(homographies: &[Matrix3<f64>]) -> Option<(f64, f64)> {
    let mut m = Matrix2::zeros();
    let mut v = Vector2::zeros();
    for h in homographies {
        let (a, b) = (h.column(0), h.column(1));
        // Equal weight for every view: the columns' common scale is arbitrary.
        let scale = 1.0 / (a.norm() * b.norm());
        let rows = [
            (Vector2::new(a.x * b.x, a.y * b.y), -a.z * b.z),
            (
                Vector2::new(a.x * a.x - b.x * b.x, a.y * a.y - b.y * b.y) / 2.0,
                (b.z * b.z - a.z * a.z) / 2.0,
            ),
        ];
        for (row, value) in rows {
            m += row * row.transpose() * scale * scale;
            v += row * value * scale * scale;
        }
    }
    let inverse_squares = m.cholesky()?.solve(&v);
    let (x, y) = (inverse_squares.x, inverse_squares.y);
    let plausible = |f2: f64| f2.is_finite() && f2 > 1e-10 && f2 < 1e-2;
    (plausible(x) && plausible(y)).then(|| (1.0 / x.sqrt(), 1.0 / y.sqrt()))
}

fn pose(h: &Matrix3<f64>, fx: f64, fy: f64) -> Isometry3<f64> {
    let k = Matrix3::from_diagonal(&Vector3::new(1.0 / fx, 1.0 / fy, 1.0));
    let m = k * h;
    let scale = 2.0 / (m.column(0).norm() + m.column(1).norm());
    // The board is in front of the camera.
    let scale = if m[(2, 2)] < 0.0 { -scale } else { scale };
    let (a, b): (Vector3<f64>, Vector3<f64>) = (m.column(0) * scale, m.column(1) * scale);
    let axes = orthonormal(&a, &b);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&axes));
    Isometry3::from_parts((m.column(2) * scale).into(), rotation)
}

/// Gram-Schmidt of two directions, and the third.
fn orthonormal(a: &Vector3<f64>, b: &Vector3<f64>) -> [Vector3<f64>; 3] {
    let x = a.normalize();
    let z = x.cross(b).normalize();
    [x, z.cross(&x), z]
}
