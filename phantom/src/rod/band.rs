//! Symmetric block-pentadiagonal systems with 3x3 blocks.

use nalgebra::{Matrix3, Vector3};

/// Symmetric matrix of 3x3 blocks, each coupled to its two neighbours on either side, with its
/// factorisation L D L^T in place. O(n) in time and memory; no allocation after construction.
#[derive(Clone, Debug)]
pub(crate) struct Band {
    diagonal: Vec<Matrix3<f64>>,
    /// Blocks (i, i-1) at index i.
    first: Vec<Matrix3<f64>>,
    /// Blocks (i, i-2) at index i.
    second: Vec<Matrix3<f64>>,
    factor_first: Vec<Matrix3<f64>>,
    factor_second: Vec<Matrix3<f64>>,
    inverse_diagonal: Vec<Matrix3<f64>>,
}

/// Determinant and inverse of a symmetric block; `None` unless positive definite.
#[inline]
fn invert_positive(m: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let (a, b, c) = (m.m11, m.m21, m.m31);
    let (d, e, f) = (m.m22, m.m32, m.m33);
    let c11 = d * f - e * e;
    let c21 = c * e - b * f;
    let c31 = b * e - c * d;
    let minor = a * d - b * b;
    let determinant = a * c11 + b * c21 + c * c31;
    if a > 0.0 && minor > 0.0 && determinant > 0.0 {
        let scale = 1.0 / determinant;
        let (i11, i21, i31) = (c11 * scale, c21 * scale, c31 * scale);
        let (i22, i32, i33) = (
            (a * f - c * c) * scale,
            (b * c - a * e) * scale,
            minor * scale,
        );
        Some(Matrix3::new(i11, i21, i31, i21, i22, i32, i31, i32, i33))
    } else {
        None
    }
}

impl Band {
    pub(crate) fn zeros(blocks: usize) -> Self {
        let zeros = || vec![Matrix3::zeros(); blocks];
        Self {
            diagonal: zeros(),
            first: zeros(),
            second: zeros(),
            factor_first: zeros(),
            factor_second: zeros(),
            inverse_diagonal: zeros(),
        }
    }

    /// Copies the entries (not the factors) of a matrix of the same size.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.diagonal.copy_from_slice(&other.diagonal);
        self.first.copy_from_slice(&other.first);
        self.second.copy_from_slice(&other.second);
    }

    #[inline]
    pub(crate) fn add_diagonal(&mut self, i: usize, block: &Matrix3<f64>) {
        self.diagonal[i] += block;
    }

    /// Adds to the block (i, i-1) and, implicitly, its transpose to (i-1, i).
    #[inline]
    pub(crate) fn add_first(&mut self, i: usize, block: &Matrix3<f64>) {
        self.first[i] += block;
    }

    /// Adds to the block (i, i-2) and, implicitly, its transpose to (i-2, i).
    #[inline]
    pub(crate) fn add_second(&mut self, i: usize, block: &Matrix3<f64>) {
        self.second[i] += block;
    }

    /// Largest entry of the diagonal, the scale of a shift.
    pub(crate) fn scale(&self) -> f64 {
        self.diagonal
            .iter()
            .fold(0.0, |s: f64, d| s.max(d.m11).max(d.m22).max(d.m33))
    }

    /// Factorises the matrix plus `shift` times the unit matrix; whether that is positive
    /// definite (otherwise the factors are unusable).
    pub(crate) fn factorise(&mut self, shift: f64) -> bool {
        let shift = Matrix3::from_diagonal_element(shift);
        for i in 0..self.diagonal.len() {
            let mut pivot = self.diagonal[i] + shift;
            let mut coupling = self.first[i];
            if i >= 2 {
                let second = &self.second[i];
                let factor = second * self.inverse_diagonal[i - 2];
                coupling -= second * self.factor_first[i - 1].transpose();
                pivot -= factor * second.transpose();
                self.factor_second[i] = factor;
            }
            if i >= 1 {
                let factor = coupling * self.inverse_diagonal[i - 1];
                pivot -= factor * coupling.transpose();
                self.factor_first[i] = factor;
            }
            match invert_positive(&pivot) {
                Some(inverse) => self.inverse_diagonal[i] = inverse,
                None => return false,
            }
        }
        true
    }

    /// Solves with the factors in place.
    pub(crate) fn solve(&self, rhs: &mut [Vector3<f64>]) {
        let n = rhs.len();
        for i in 1..n {
            let mut value = rhs[i] - self.factor_first[i] * rhs[i - 1];
            if i >= 2 {
                value -= self.factor_second[i] * rhs[i - 2];
            }
            rhs[i] = value;
        }
        for i in (0..n).rev() {
            let mut value = self.inverse_diagonal[i] * rhs[i];
            if i + 1 < n {
                value -= self.factor_first[i + 1].tr_mul(&rhs[i + 1]);
            }
            if i + 2 < n {
                value -= self.factor_second[i + 2].tr_mul(&rhs[i + 2]);
            }
            rhs[i] = value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    /// Against nalgebra's dense Cholesky of the same matrix.
    #[test]
    fn agrees_with_a_dense_factorisation() {
        let n = 9;
        let mut band = Band::zeros(n);
        let mut dense = DMatrix::zeros(3 * n, 3 * n);
        let value = |i: usize, j: usize| ((i * 37 + j * 101) % 17) as f64 / 17.0 - 0.5;
        for i in 0..n {
            for (offset, weight) in [(0, 1.0), (1, 0.7), (2, 0.3)] {
                if i < offset {
                    continue;
                }
                let mut block = Matrix3::from_fn(|r, c| weight * value(3 * i + r, 5 * c + offset));
                if offset == 0 {
                    block = block + block.transpose() + Matrix3::from_diagonal_element(6.0);
                    band.add_diagonal(i, &block);
                } else if offset == 1 {
                    band.add_first(i, &block);
                } else {
                    band.add_second(i, &block);
                }
                let j = i - offset;
                dense.fixed_view_mut::<3, 3>(3 * i, 3 * j).copy_from(&block);
                dense
                    .fixed_view_mut::<3, 3>(3 * j, 3 * i)
                    .copy_from(&block.transpose());
            }
        }
        let rhs = DVector::from_fn(3 * n, |i, _| (i as f64).sin());
        let expected = dense.clone().cholesky().unwrap().solve(&rhs);
        assert!(band.factorise(0.0));
        let mut x: Vec<_> = (0..n)
            .map(|i| rhs.fixed_rows::<3>(3 * i).into_owned())
            .collect();
        band.solve(&mut x);
        for i in 0..n {
            // Diagonally dominant: only rounding separates the two.
            assert!((x[i] - expected.fixed_rows::<3>(3 * i)).norm() < 1e-13);
        }
        let smallest = dense.symmetric_eigenvalues().min();
        assert!(band.factorise(-0.99 * smallest));
        assert!(!band.factorise(-1.01 * smallest));
    }
}
