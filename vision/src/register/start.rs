//! Closed-form starts.

use faer::Mat;
use faer::linalg::solvers::SolveLstsq;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

/// The rigid transform that takes `from` to `to` with the least squared error \[Kabsch1976\];
/// `None` for fewer than three points, or points on a line.
pub fn kabsch(from: &[Point3<f64>], to: &[Point3<f64>]) -> Option<Isometry3<f64>> {
    if from.len() < 3 || from.len() != to.len() {
        return None;
    }
    let n = from.len() as f64;
    let mean =
        |points: &[Point3<f64>]| points.iter().fold(Vector3::zeros(), |s, p| s + p.coords) / n;
    let (a, b) = (mean(from), mean(to));
    let mut moment = Matrix3::zeros();
    for (p, q) in from.iter().zip(to) {
        moment += (q.coords - b) * (p.coords - a).transpose();
    }
    let rotation = nearest_rotation(&moment)?;
    Some(Isometry3::from_parts((b - rotation * a).into(), rotation))
}

/// The rotation R with the greatest trace of R^T m; `None` if m leaves a turn open.
pub(super) fn nearest_rotation(m: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    if !m.iter().all(|x| x.is_finite()) {
        return None;
    }
    let svd = m.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let s = svd.singular_values;
    // Two directions fix a rotation; nalgebra orders singular values.
    if s[1].is_nan() || s[1] <= 1e-9 * s[0] {
        return None;
    }
    let sign = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    Some(UnitQuaternion::from_rotation_matrix(
        &Rotation3::from_matrix_unchecked(rotation),
    ))
}

/// World-from-camera and the point on the flange, from points seen and flange poses: linear in
/// both, the rotation then made one.
pub(super) fn point_on_flange(
    seen: &[Vector3<f64>],
    flange: &[Isometry3<f64>],
) -> Option<(Isometry3<f64>, Vector3<f64>)> {
    const UNKNOWNS: usize = 15;
    let rows = 3 * seen.len();
    if rows < UNKNOWNS {
        return None;
    }
    // R m + t - R_F p = t_F; the unknowns are R by rows, t, p.
    let mut a = Mat::<f64>::zeros(rows, UNKNOWNS);
    let mut b = Mat::<f64>::zeros(rows, 1);
    for (i, (m, f)) in seen.iter().zip(flange).enumerate() {
        let rotation = f.rotation.to_rotation_matrix();
        for k in 0..3 {
            let row = 3 * i + k;
            for j in 0..3 {
                a[(row, 3 * k + j)] = m[j];
                a[(row, 12 + j)] = -rotation[(k, j)];
            }
            a[(row, 9 + k)] = 1.0;
            b[(row, 0)] = f.translation.vector[k];
        }
    }
    let x = a.col_piv_qr().solve_lstsq(&b);
    let value = |k: usize| x[(k, 0)];
    let rotation = nearest_rotation(&Matrix3::from_fn(|i, j| value(3 * i + j)))?;
    let p = Vector3::new(value(12), value(13), value(14));
    // With the rotation fixed the rest is a mean.
    let n = seen.len() as f64;
    let t = seen.iter().zip(flange).fold(Vector3::zeros(), |s, (m, f)| {
        s + (f.rotation * p + f.translation.vector - rotation * m) / n
    });
    let finite = p.iter().chain(t.iter()).all(|x| x.is_finite());
    finite.then(|| (Isometry3::from_parts(t.into(), rotation), p))
}

/// World-from-camera X and flange-from-board Y with X A = F Y: rotations from the relative
/// motions' axes \[Park1994\], translations linear.
pub(super) fn hand_eye(
    seen: &[Isometry3<f64>],
    flange: &[Isometry3<f64>],
) -> Option<(Isometry3<f64>, Isometry3<f64>)> {
    let mut moment = Matrix3::zeros();
    for i in 0..seen.len() {
        for j in 0..i {
            let a = (seen[i].rotation * seen[j].rotation.inverse()).scaled_axis();
            let f = (flange[i].rotation * flange[j].rotation.inverse()).scaled_axis();
            // Small turns say little about their axis, half turns not which way.
            let clear = |v: &Vector3<f64>| (0.03..2.9).contains(&v.norm());
            if clear(&a) && clear(&f) {
                moment += f * a.transpose();
            }
        }
    }
    let x_rotation = nearest_rotation(&moment)?;
    let mut y_moment = Matrix3::zeros();
    for (a, f) in seen.iter().zip(flange) {
        let y = f.rotation.inverse() * x_rotation * a.rotation;
        y_moment += y.to_rotation_matrix().matrix();
    }
    let y_rotation = nearest_rotation(&y_moment)?;
    // R_X t_A + t_X = R_F t_Y + t_F.
    let rows = 3 * seen.len();
    let mut m = Mat::<f64>::zeros(rows, 6);
    let mut b = Mat::<f64>::zeros(rows, 1);
    for (i, (a, f)) in seen.iter().zip(flange).enumerate() {
        let rotation = f.rotation.to_rotation_matrix();
        let rhs = f.translation.vector - x_rotation * a.translation.vector;
        for k in 0..3 {
            let row = 3 * i + k;
            m[(row, k)] = 1.0;
            for j in 0..3 {
                m[(row, 3 + j)] = -rotation[(k, j)];
            }
            b[(row, 0)] = rhs[k];
        }
    }
    let t = m.col_piv_qr().solve_lstsq(&b);
    let at = |k: usize| Vector3::new(t[(k, 0)], t[(k + 1, 0)], t[(k + 2, 0)]);
    let (tx, ty) = (at(0), at(3));
    let finite = tx.iter().chain(ty.iter()).all(|x| x.is_finite());
    finite.then(|| {
        (
            Isometry3::from_parts(tx.into(), x_rotation),
            Isometry3::from_parts(ty.into(), y_rotation),
        )
    })
}
