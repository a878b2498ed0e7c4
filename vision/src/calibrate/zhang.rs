//! A camera's start from homographies \[Zhang2000\], the principal point taken at the image's
//! centre.

use nalgebra::{Isometry3, Matrix2, Matrix3, Point2, Rotation3, UnitQuaternion, Vector2, Vector3};

use super::normal::{Observed, residuals};
use crate::camera::{Camera, DistortedPx, Distortion};
use crate::homography::homography;

/// The start of a monocular fit.
#[derive(Clone, Debug)]
pub(super) struct Start {
    pub camera: Camera,
    pub camera_from_board: Vec<Isometry3<f64>>,
}

/// The board's points and pixels that a view shows.
fn seen(board: &[Point2<f64>], observed: &Observed) -> (Vec<Point2<f64>>, Vec<Point2<f64>>) {
    let both = board.iter().zip(observed);
    both.filter_map(|(point, px)| px.map(|px| (*point, px)))
        .unzip()
}

/// Closed-form camera without distortion, and the boards' poses. `None` if a view's corners
/// determine no homography. A focal length that the views do not determine is guessed.
pub(super) fn start(
    board: &[Point2<f64>],
    views: &[Observed],
    (width, height): (usize, usize),
) -> Option<Start> {
    let centre = Vector2::new((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
    let mut shift = Matrix3::identity();
    shift.fixed_view_mut::<2, 1>(0, 2).copy_from(&-centre);
    let mut homographies = Vec::with_capacity(views.len());
    for view in views {
        let (points, pixels) = seen(board, view);
        homographies.push(shift * homography(&points, &pixels)?);
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

/// Focal lengths that a fisheye's start tries, over the image's longer side: from a view of
/// 180 degrees across it to a mild wide angle.
const FISHEYE_FOCAL: [f64; 6] = [0.25, 0.32, 0.4, 0.55, 0.75, 1.1];

/// A fisheye's start: of a few focal lengths the one with which planes explain the views best.
pub(super) fn fisheye_start(
    board: &[Point2<f64>],
    views: &[Observed],
    (width, height): (usize, usize),
) -> Option<Start> {
    let mut best: Option<(f64, Start)> = None;
    for share in FISHEYE_FOCAL {
        let focal = share * width.max(height) as f64;
        let camera = Camera {
            width,
            height,
            fx: focal,
            fy: focal,
            cx: (width as f64 - 1.0) / 2.0,
            cy: (height as f64 - 1.0) / 2.0,
            distortion: Distortion::equidistant([0.0; 4]),
        };
        let Some(poses) = views
            .iter()
            .map(|view| plane(&camera, board, view))
            .collect::<Option<Vec<_>>>()
        else {
            continue;
        };
        let cost: f64 = views
            .iter()
            .zip(&poses)
            .map(|(view, pose)| miss(&camera, pose, board, view))
            .sum();
        if best.as_ref().is_none_or(|(least, _)| cost < *least) {
            let start = Start {
                camera,
                camera_from_board: poses,
            };
            best = Some((cost, start));
        }
    }
    best.map(|(_, start)| start)
}

/// A board's pose from the directions of its corners.
fn plane(camera: &Camera, board: &[Point2<f64>], view: &Observed) -> Option<Isometry3<f64>> {
    let (points, pixels) = seen(board, view);
    let normalised = pixels
        .iter()
        .map(|px| {
            camera
                .direction(DistortedPx(*px))
                .map(|d| Point2::from(d.xy()))
        })
        .collect::<Option<Vec<_>>>()?;
    Some(pose(&homography(&points, &normalised)?, 1.0, 1.0))
}

/// Sum of the squared residuals of a view \[px2\].
fn miss(camera: &Camera, pose: &Isometry3<f64>, board: &[Point2<f64>], view: &Observed) -> f64 {
    let (points, pixels) = seen(board, view);
    let all = residuals(camera, pose, &points, &pixels);
    all.iter().map(Vector2::norm_squared).sum()
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
