//! Least-squares levels in strict priority under common inequality constraints.
//!
//! Each level is solved in what the levels above leave free: `x = x_above + P y` with P the
//! projector of eq. (20) for all rows above. Lower levels therefore cannot change the residual
//! of a higher one, whatever they ask for.

use nalgebra::{SMatrix, SVector};

use crate::qp::{Constraint, QpError, Solution, solve};

/// Weight of the least-norm choice among equals, relative to rows scaled to order one.
const REGULARISATION: f64 = 1e-6;

/// Singular values below this fraction of a level's largest leave their direction free.
const RANK_TOLERANCE: f64 = 1e-7;

/// A problem of levels in `N` unknowns.
#[derive(Clone, Debug)]
pub struct Levels<'a, const N: usize> {
    rows: &'a [Constraint<N>],
    x: SVector<f64, N>,
    free: SMatrix<f64, N, N>,
}

impl<'a, const N: usize> Levels<'a, N> {
    /// Starts with hard constraints only; rows scaled to order one.
    pub fn new(rows: &'a [Constraint<N>]) -> Self {
        Self {
            rows,
            x: SVector::zeros(),
            free: SMatrix::identity(),
        }
    }

    /// The unknowns so far.
    pub fn x(&self) -> &SVector<f64, N> {
        &self.x
    }

    /// Adds the next level, `min |matrix x - wish|`: an `M`-row least-squares problem padded to
    /// `N` rows with zeros. The multipliers of the result tell which constraints bound it.
    ///
    /// # Errors
    /// See [`QpError`]; the unknowns then must not be used.
    pub fn level(
        &mut self,
        matrix: &SMatrix<f64, N, N>,
        wish: &SVector<f64, N>,
    ) -> Result<Solution<N>, QpError> {
        let reduced = matrix * self.free;
        let hessian = reduced.transpose() * reduced + SMatrix::identity() * REGULARISATION;
        // Least norm of the whole x, not of the step.
        let gradient = -(reduced.transpose() * (wish - matrix * self.x))
            + self.free.transpose() * self.x * REGULARISATION;
        let mut moved = [Constraint {
            normal: SVector::zeros(),
            bound: -1.0,
        }; crate::qp::MAX_CONSTRAINTS];
        let count = self.rows.len().min(moved.len());
        for (to, row) in moved.iter_mut().zip(self.rows) {
            to.normal = self.free.transpose() * row.normal;
            // What the levels above have rounded away is not a violation.
            to.bound = (row.bound - row.normal.dot(&self.x)).min(if self.is_first() {
                f64::INFINITY
            } else {
                0.0
            });
            if to.normal.norm() < 1e-9 * row.normal.norm() {
                to.normal = SVector::zeros();
                to.bound = to.bound.min(0.0);
            }
        }
        let solution = solve(&hessian, &gradient, &moved[..count])?;
        self.x += self.free * solution.x;
        self.free = self.narrowed(&reduced);
        Ok(solution)
    }

    fn is_first(&self) -> bool {
        self.free == SMatrix::<f64, N, N>::identity()
    }

    /// The projector onto what is left free after `reduced`'s rows.
    fn narrowed(&self, reduced: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
        let gram = reduced.transpose() * reduced;
        let mut free = self.free;
        // Deflation by the strongest remaining direction: at most N rounds, no decomposition
        // that could fail.
        let scale = gram.diagonal().max();
        for _ in 0..N {
            let seen = reduced * free;
            let mut best = (0.0, SVector::<f64, N>::zeros());
            for i in 0..N {
                let row = seen.row(i).transpose();
                if row.norm_squared() > best.0 {
                    best = (row.norm_squared(), row);
                }
            }
            if best.0 <= RANK_TOLERANCE * RANK_TOLERANCE * scale || best.0 <= 0.0 {
                break;
            }
            let direction = best.1 / best.0.sqrt();
            let image = free * direction;
            let size = image.norm();
            if size < 1e-9 {
                break;
            }
            let unit = image / size;
            free -= unit * (unit.transpose() * free);
            free = (free + free.transpose()) * 0.5;
        }
        free
    }
}

/// Rows of a level with fewer than `N` equations, padded with zeros.
pub fn padded<const M: usize, const N: usize>(
    matrix: &SMatrix<f64, M, N>,
    wish: &SVector<f64, M>,
) -> (SMatrix<f64, N, N>, SVector<f64, N>) {
    let mut a = SMatrix::<f64, N, N>::zeros();
    let mut b = SVector::<f64, N>::zeros();
    for i in 0..M.min(N) {
        a.set_row(i, &matrix.row(i).into_owned());
        b[i] = wish[i];
    }
    (a, b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn boxed() -> Vec<Constraint<6>> {
        (0..12)
            .map(|i| {
                let mut normal = SVector::zeros();
                normal[i / 2] = if i % 2 == 0 { 1.0 } else { -1.0 };
                Constraint {
                    normal,
                    bound: -1.0,
                }
            })
            .collect()
    }

    proptest! {
        #![proptest_config(crate::seeded())]

        /// A lower level never worsens a higher one, and never breaks a constraint.
        #[test]
        fn lower_levels_never_disturb_higher_ones(
            x in prop::collection::vec(-1.0_f64..1.0, 40), dependent in prop::bool::ANY,
            size in 0.1_f64..5.0,
        ) {
            let mut first = SMatrix::<f64, 2, 6>::from_iterator(x[..12].iter().copied());
            if dependent {
                let copy = first.row(0) * 0.7;
                first.set_row(1, &copy);
            }
            let second = SMatrix::<f64, 2, 6>::from_iterator(x[12..24].iter().copied());
            let third = SMatrix::<f64, 2, 6>::from_iterator(x[24..36].iter().copied());
            let wish = |k: usize| SVector::<f64, 2>::new(x[k], x[k + 1]) * size;
            let rows = boxed();
            let mut levels = Levels::new(&rows);
            let (a, b) = padded(&first, &wish(36));
            levels.level(&a, &b).unwrap();
            let first_reached = first * levels.x();
            let (a, b) = padded(&second, &wish(38));
            levels.level(&a, &b).unwrap();
            let second_reached = second * levels.x();
            prop_assert!((first * levels.x() - first_reached).norm() < 1e-7);
            let (a, b) = padded(&third, &wish(37));
            levels.level(&a, &b).unwrap();
            prop_assert!((first * levels.x() - first_reached).norm() < 1e-7);
            prop_assert!((second * levels.x() - second_reached).norm() < 1e-7);
            for row in &rows {
                prop_assert!(row.normal.dot(levels.x()) - row.bound > -1e-7);
            }
        }

        /// Where no constraint binds the first level is met.
        #[test]
        fn a_reachable_wish_is_met(x in prop::collection::vec(-1.0_f64..1.0, 12)) {
            let first = SMatrix::<f64, 2, 6>::from_iterator(x.iter().copied());
            prop_assume!((first * first.transpose()).determinant() > 0.05);
            let wish = SVector::<f64, 2>::new(0.05, -0.04);
            let rows = boxed();
            let mut levels = Levels::new(&rows);
            let (a, b) = padded(&first, &wish);
            levels.level(&a, &b).unwrap();
            // The regularisation gives up a fraction of about 1e-6 / 0.05.
            prop_assert!((first * levels.x() - wish).norm() < 1e-5);
        }
    }
}
