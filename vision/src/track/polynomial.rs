//! Lagrange polynomials on evenly spread control points.

use nalgebra::SMatrix;

/// Greatest number of control points.
pub const MAX_POINTS: usize = 6;

/// Values at the control points; entries past the number in use are zero.
pub(super) type Values = [f64; MAX_POINTS];
pub(super) type Covariance = SMatrix<f64, MAX_POINTS, MAX_POINTS>;

/// The `n` Lagrange polynomials on t = 0, 1/(n-1), ..., 1.
pub(super) fn basis(n: usize, t: f64) -> Values {
    let u = t * (n - 1) as f64;
    let mut l = [0.0; MAX_POINTS];
    for i in 0..n {
        let mut v = 1.0;
        for j in 0..n {
            if j != i {
                v *= (u - j as f64) / (i as f64 - j as f64);
            }
        }
        l[i] = v;
    }
    l
}

/// Their derivatives by t.
pub(super) fn basis_slope(n: usize, t: f64) -> Values {
    let scale = (n - 1) as f64;
    let u = t * scale;
    let mut l = [0.0; MAX_POINTS];
    for i in 0..n {
        let mut sum = 0.0;
        for k in (0..n).filter(|&k| k != i) {
            let mut v = 1.0 / (i as f64 - k as f64);
            for j in (0..n).filter(|&j| j != i && j != k) {
                v *= (u - j as f64) / (i as f64 - j as f64);
            }
            sum += v;
        }
        l[i] = sum * scale;
    }
    l
}

pub(super) fn dot(a: &Values, b: &Values) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// The matrix whose row i evaluates the polynomial at `place(t_i)`; identity past `n`.
pub(super) fn resampling(n: usize, place: impl Fn(f64) -> f64) -> Covariance {
    let mut m = Covariance::identity();
    for i in 0..n {
        let l = basis(n, place(i as f64 / (n - 1) as f64));
        for j in 0..n {
            m[(i, j)] = l[j];
        }
    }
    m
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reproduces_polynomials_and_their_slopes() {
        for n in 4..=MAX_POINTS {
            let f = |t: f64| 1.0 - 2.0 * t + 3.0 * t.powi(3);
            let mut values = [0.0; MAX_POINTS];
            for i in 0..n {
                values[i] = f(i as f64 / (n - 1) as f64);
            }
            for t in [-0.1, 0.0, 0.37, 1.0, 1.2] {
                assert!((dot(&basis(n, t), &values) - f(t)).abs() < 1e-12);
                let slope = -2.0 + 9.0 * t * t;
                assert!((dot(&basis_slope(n, t), &values) - slope).abs() < 1e-11);
            }
        }
    }
}
