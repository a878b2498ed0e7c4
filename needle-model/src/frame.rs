//! The tip frame: the base frame carried along the needle without torsion (section II.B).
//!
//! Carrying a frame without rotation about the tangent, from the base axis z to the tip axis t,
//! equals the smallest rotation from z to t after a roll about z by
//! theta = integral of (z x t) . t' / (1 + z . t): zero for a plane needle.

use nalgebra::{Matrix3, Vector3};

/// Smallest rotation from unit `z` to unit `t`, applied to a vector orthogonal to `z`.
#[inline]
pub(crate) fn carry(z: &Vector3<f64>, t: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    v - (z + t) * (t.dot(v) / (1.0 + z.dot(t)))
}

/// `y_base` rolled by `theta` about the base axis: carried to the tip axis, it is `y_tip`.
#[inline]
pub(crate) fn rolled(z_base: &Vector3<f64>, y_base: &Vector3<f64>, theta: f64) -> Vector3<f64> {
    let (sin, cos) = theta.sin_cos();
    y_base * cos + z_base.cross(y_base) * sin
}

/// Row r with (rotation about t of the tip frame) = r . dt for a change dt of t, z and theta fixed.
#[inline]
pub(crate) fn spin_row(z: &Vector3<f64>, t: &Vector3<f64>) -> Vector3<f64> {
    -z.cross(t) / (1.0 + z.dot(t))
}

/// Change of `y_tip` by a change of t: d y = Q dt, z and theta fixed.
#[inline]
pub(crate) fn tip_y_by_axis(z: &Vector3<f64>, t: &Vector3<f64>, y: &Vector3<f64>) -> Matrix3<f64> {
    -t * y.transpose() + t.cross(y) * spin_row(z, t).transpose()
}

/// Roll of one quadrature point and its gradients: with tangent `d` and its derivative `v` along
/// the segment, f = z . (d x v) / (|d| (|d| + z . d)). Returns (f, df/dd, df/dv, df/dz).
#[inline]
pub(crate) fn roll_rate(
    z: &Vector3<f64>,
    d: &Vector3<f64>,
    v: &Vector3<f64>,
) -> (f64, Vector3<f64>, Vector3<f64>, Vector3<f64>) {
    let (norm, along) = (d.norm(), z.dot(d));
    let cross = d.cross(v);
    let inverse = 1.0 / (norm * (norm + along));
    let f = z.dot(&cross) * inverse;
    let g = f * inverse;
    let by_d = v.cross(z) * inverse - (d * (2.0 + along / norm) + z * norm) * g;
    let by_z = cross * inverse - d * (norm * g);
    (f, by_d, z.cross(d) * inverse, by_z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::{GAUSS_10, Segment};

    fn twisted() -> Segment {
        let coefficients = [
            Vector3::zeros(),
            Vector3::z(),
            Vector3::new(0.4, 0.0, 0.1),
            Vector3::new(-0.3, 0.5, 0.0),
        ];
        Segment {
            coefficients,
            length: 1.0,
        }
    }

    #[test]
    fn roll_agrees_with_small_rotations() {
        let (segment, n) = (twisted(), 200_000);
        let (z, y) = (Vector3::z(), Vector3::y());
        let (mut t, mut frame) = (z, y);
        for i in 1..=n {
            let next = segment.derivative(f64::from(i) / f64::from(n)).normalize();
            frame = carry(&t, &next, &frame);
            t = next;
        }
        let mut theta = 0.0;
        for panel in 0..4 {
            for (u, w) in GAUSS_10 {
                let l = (f64::from(panel) + u) / 4.0;
                let (d, v) = (segment.derivative(l), segment.second_derivative(l));
                theta += w / 4.0 * roll_rate(&z, &d, &v).0;
            }
        }
        assert!(theta.abs() > 0.01, "the curve should roll: {theta}");
        // Small rotations converge with 1/n^2 = 2.5e-11; rounding adds up to 1e-11.
        let gap = (carry(&z, &t, &rolled(&z, &y, theta)) - frame).norm();
        assert!(gap < 1e-9, "{gap:e}");
    }

    #[test]
    fn gradients_match_differences() {
        let (z, d) = (Vector3::z(), Vector3::new(0.2, -0.3, 0.9));
        let v = Vector3::new(0.5, 0.4, -0.2);
        let (_, by_d, by_v, by_z) = roll_rate(&z, &d, &v);
        let h = 1e-6;
        for k in 0..3 {
            let e = Vector3::ith(k, h);
            let diff = |hi: f64, lo: f64| (hi - lo) / (2.0 * h);
            let at = |z, d, v| roll_rate(&z, &d, &v).0;
            // Truncation h^2 = 1e-12, rounding 1e-10.
            assert!((diff(at(z, d + e, v), at(z, d - e, v)) - by_d[k]).abs() < 1e-9);
            assert!((diff(at(z, d, v + e), at(z, d, v - e)) - by_v[k]).abs() < 1e-9);
            assert!((diff(at(z + e, d, v), at(z - e, d, v)) - by_z[k]).abs() < 1e-9);
        }
        let t = d.normalize();
        let turned = rolled(&z, &Vector3::y(), 0.3);
        let y = carry(&z, &t, &turned);
        let q = tip_y_by_axis(&z, &t, &y);
        for step in [t.cross(&y), y] {
            let at = |s: f64| carry(&z, &(t + step * s).normalize(), &turned);
            let difference = (at(h) - at(-h)) / (2.0 * h);
            assert!((difference - q * step).norm() < 1e-9);
        }
    }
}
