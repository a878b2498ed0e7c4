//! Normal equations of one camera looking at one board.

use nalgebra::{Isometry3, Matrix6, Point2, SMatrix, SVector, Vector2, Vector3};

use crate::camera::Camera;

pub(super) use crate::camera::INTRINSICS;
const ALL: usize = INTRINSICS + 6;

/// Corners of one board in one image; `None` for a rejected corner.
pub(super) type Observed = Vec<Option<Point2<f64>>>;

/// Normal equations by intrinsics and by the board's pose (translation, then rotation of the
/// camera's axes about the board's origin).
#[derive(Clone, Debug)]
pub(super) struct CameraNormal {
    pub ii: SMatrix<f64, INTRINSICS, INTRINSICS>,
    pub ip: SMatrix<f64, INTRINSICS, 6>,
    pub pp: Matrix6<f64>,
    pub gi: SVector<f64, INTRINSICS>,
    pub gp: SVector<f64, 6>,
    /// Sum of the loss of all corners \[px2\].
    pub cost: f64,
}

/// Accumulates the Gauss-Newton normal equations with Huber's loss; `None` if a corner would be
/// behind the camera.
pub(super) fn accumulate(
    camera: &Camera,
    camera_from_board: &Isometry3<f64>,
    board: &[Point2<f64>],
    observed: &Observed,
    huber_px: f64,
) -> Option<CameraNormal> {
    let rotation = camera_from_board.rotation.to_rotation_matrix();
    let translation = camera_from_board.translation.vector;
    let (ex, ey) = (rotation.matrix().column(0), rotation.matrix().column(1));
    let mut h = [[0.0_f64; ALL]; ALL];
    let mut g = [0.0_f64; ALL];
    let mut cost = 0.0;
    for (point, px) in board.iter().zip(observed) {
        let Some(px) = px else { continue };
        let arm: Vector3<f64> = ex * point.x + ey * point.y;
        let p = camera.project_with_all_derivatives(&(arm + translation))?;
        let e = px - p.px.0;
        let (weight, loss) = huber(&e, huber_px);
        cost += loss;
        let mut rows = [[0.0_f64; ALL]; 2];
        for (r, row) in rows.iter_mut().enumerate() {
            for k in 0..INTRINSICS {
                row[k] = p.by_intrinsics[(r, k)];
            }
            let d = Vector3::new(p.by_point[(r, 0)], p.by_point[(r, 1)], p.by_point[(r, 2)]);
            // Moving by w x arm: the derivative by w is arm x d.
            let turn = arm.cross(&d);
            for k in 0..3 {
                row[INTRINSICS + k] = d[k];
                row[INTRINSICS + 3 + k] = turn[k];
            }
        }
        let [a, b] = &rows;
        for i in 0..ALL {
            let (ai, bi) = (weight * a[i], weight * b[i]);
            g[i] += ai * e.x + bi * e.y;
            let line = &mut h[i];
            // The lower triangle would be enough, but whole rows fill the vector units.
            for j in 0..ALL {
                line[j] += ai * a[j] + bi * b[j];
            }
        }
    }
    Some(CameraNormal {
        ii: SMatrix::from_fn(|i, j| h[i][j]),
        ip: SMatrix::from_fn(|i, j| h[i][INTRINSICS + j]),
        pp: SMatrix::from_fn(|i, j| h[INTRINSICS + i][INTRINSICS + j]),
        gi: SVector::from_fn(|i, _| g[i]),
        gp: SVector::from_fn(|i, _| g[INTRINSICS + i]),
        cost,
    })
}

/// Huber's weight and loss of a corner's residual, by its length \[Huber1964\].
pub(super) fn huber(e: &Vector2<f64>, limit: f64) -> (f64, f64) {
    let square = e.norm_squared();
    if square <= limit * limit {
        return (1.0, square);
    }
    let length = square.sqrt();
    (limit / length, limit * (2.0 * length - limit))
}

/// What the corners of one image miss their model by \[px\]; `None` for rejected corners.
pub(super) fn residuals(
    camera: &Camera,
    camera_from_board: &Isometry3<f64>,
    board: &[Point2<f64>],
    observed: &[Point2<f64>],
) -> Vec<Vector2<f64>> {
    let miss = |(point, px): (&Point2<f64>, &Point2<f64>)| {
        let p = camera_from_board * nalgebra::Point3::new(point.x, point.y, 0.0);
        camera
            .project(&p.coords)
            .map_or_else(|| Vector2::repeat(f64::INFINITY), |model| px - model.0)
    };
    board.iter().zip(observed).map(miss).collect()
}

/// Applies a step of a pose: translation, then rotation of the camera's axes.
pub(super) fn stepped(pose: &Isometry3<f64>, step: &SVector<f64, 6>) -> Isometry3<f64> {
    let turn = nalgebra::UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
    let mut rotation = turn * pose.rotation;
    rotation.renormalize();
    Isometry3::from_parts(
        (pose.translation.vector + step.fixed_rows::<3>(0)).into(),
        rotation,
    )
}
