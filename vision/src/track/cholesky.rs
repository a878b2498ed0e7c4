//! Cholesky factor of the leading block of a matrix of fixed size: nothing is allocated, and
//! idle rows cost nothing.

use nalgebra::{SMatrix, SVector};

/// Factor of the first `active` rows and columns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Factor<const N: usize> {
    /// Rows of the lower triangle.
    rows: [[f64; N]; N],
    /// One over the diagonal.
    inverses: [f64; N],
    active: usize,
}

impl<const N: usize> Factor<N> {
    /// Factors the symmetric `matrix`, of which the lower half is read; nothing where it is not
    /// positive definite.
    pub(super) fn new(matrix: &SMatrix<f64, N, N>, active: usize) -> Option<Self> {
        let active = active.min(N);
        let mut rows = [[0.0; N]; N];
        let mut inverses = [0.0; N];
        for i in 0..active {
            let (above, rest) = rows.split_at_mut(i);
            let row = &mut rest[0];
            for (j, other) in above.iter().enumerate() {
                let mut value = matrix[(i, j)];
                for (a, b) in row.iter().zip(other).take(j) {
                    value -= a * b;
                }
                row[j] = value * inverses[j];
            }
            let mut value = matrix[(i, i)];
            for a in row.iter().take(i) {
                value -= a * a;
            }
            if value <= 0.0 || !value.is_finite() {
                return None;
            }
            row[i] = value.sqrt();
            inverses[i] = 1.0 / row[i];
        }
        Some(Self {
            rows,
            inverses,
            active,
        })
    }

    /// Solution for the right side `b`; idle entries are zero.
    pub(super) fn solve(&self, b: &SVector<f64, N>) -> SVector<f64, N> {
        let mut x = SVector::zeros();
        for i in 0..self.active {
            let mut value = b[i];
            for k in 0..i {
                value -= self.rows[i][k] * x[k];
            }
            x[i] = value * self.inverses[i];
        }
        for i in (0..self.active).rev() {
            x[i] *= self.inverses[i];
            for k in 0..i {
                x[k] -= self.rows[i][k] * x[i];
            }
        }
        x
    }

    /// Inverse of the block; idle entries are zero.
    pub(super) fn inverse(&self) -> SMatrix<f64, N, N> {
        let n = self.active;
        // Inverse of the triangle, then its product with itself.
        let mut triangle = [[0.0; N]; N];
        for j in 0..n {
            triangle[j][j] = self.inverses[j];
            for i in j + 1..n {
                let mut value = 0.0;
                for k in j..i {
                    value -= self.rows[i][k] * triangle[k][j];
                }
                triangle[i][j] = value * self.inverses[i];
            }
        }
        let mut inverse = SMatrix::zeros();
        for row in triangle.iter().take(n) {
            for i in 0..n {
                for j in 0..=i {
                    inverse[(i, j)] += row[i] * row[j];
                }
            }
        }
        for i in 0..n {
            for j in 0..i {
                inverse[(j, i)] = inverse[(i, j)];
            }
        }
        inverse
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn leading_blocks_are_factored_as_by_nalgebra() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for active in 1..=9 {
            let root = SMatrix::<f64, 9, 9>::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let matrix = root * root.transpose() + SMatrix::identity() * 0.1;
            let b = SVector::<f64, 9>::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let factor = Factor::new(&matrix, active).unwrap();
            let block = matrix.view((0, 0), (active, active)).into_owned();
            let peer = nalgebra::Cholesky::new(block).unwrap();
            let (x, y) = (
                factor.solve(&b),
                peer.solve(&b.rows(0, active).into_owned()),
            );
            // Condition numbers below 1e3.
            assert!((x.rows(0, active) - y).amax() < 1e-11);
            let (inverse, other) = (factor.inverse(), peer.inverse());
            assert!((inverse.view((0, 0), (active, active)) - other).amax() < 1e-11);
        }
    }

    #[test]
    fn what_is_not_positive_definite_has_no_factor() {
        let mut matrix = SMatrix::<f64, 3, 3>::identity();
        matrix[(1, 1)] = -1.0;
        assert!(Factor::new(&matrix, 1).is_some());
        assert!(Factor::new(&matrix, 2).is_none());
        matrix[(1, 1)] = f64::NAN;
        assert!(Factor::new(&matrix, 3).is_none());
    }
}
