//! Strictly convex quadratic programs of a few variables: the dual active-set method of
//! Goldfarb and Idnani (1983), of fixed size and without heap.

use nalgebra::{SMatrix, SVector};

/// Most constraints of one program.
pub const MAX_CONSTRAINTS: usize = 40;

/// Violations below this are rounding: the rows are scaled to norm one, the unknowns to order
/// one.
const FEASIBLE: f64 = 1e-9;

/// A row that depends on the working rows and is violated by no more than this is one of them
/// up to rounding.
const DEPENDENT: f64 = 1e-6;

/// One row `normal . x >= bound`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constraint<const N: usize> {
    /// Normal, pointing to the allowed side.
    pub normal: SVector<f64, N>,
    /// Bound.
    pub bound: f64,
}

/// Why a program has no solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum QpError {
    /// A number of the program is not finite.
    #[error("the quadratic program holds a number that is not finite")]
    NonFinite,
    /// The objective is not strictly convex.
    #[error("the quadratic program is not strictly convex")]
    NotConvex,
    /// The constraints contradict each other.
    #[error("constraint {constraint} of the quadratic program contradicts others")]
    Infeasible {
        /// Index of a row that cannot be met.
        constraint: usize,
    },
    /// More rows than [`MAX_CONSTRAINTS`].
    #[error("{count} constraints; at most {MAX_CONSTRAINTS} are supported")]
    TooManyConstraints {
        /// Rows given.
        count: usize,
    },
    /// The iteration did not end; the program is too badly scaled.
    #[error("the quadratic program did not converge")]
    NotConverged,
}

/// The minimiser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution<const N: usize> {
    /// The unknowns.
    pub x: SVector<f64, N>,
    /// Multiplier of each row, positive where it binds.
    pub multipliers: [f64; MAX_CONSTRAINTS],
}

/// Rows in coordinates in which the Hessian is the identity.
struct Whitened<const N: usize> {
    normals: [SVector<f64, N>; MAX_CONSTRAINTS],
    bounds: [f64; MAX_CONSTRAINTS],
    /// Norms of the original normals.
    sizes: [f64; MAX_CONSTRAINTS],
    count: usize,
}

impl<const N: usize> Whitened<N> {
    fn slack(&self, row: usize, z: &SVector<f64, N>) -> f64 {
        (self.normals[row].dot(z) - self.bounds[row]) / self.sizes[row]
    }
}

/// Which rows bind, their multipliers, and their orthonormal basis `normals = basis * factor`.
struct Working<const N: usize> {
    rows: [usize; N],
    multipliers: [f64; N],
    basis: [SVector<f64, N>; N],
    factor: SMatrix<f64, N, N>,
    len: usize,
    /// Rows that follow from the working rows.
    implied: [bool; MAX_CONSTRAINTS],
}

impl<const N: usize> Working<N> {
    fn new() -> Self {
        Self {
            rows: [0; N],
            multipliers: [0.0; N],
            basis: [SVector::zeros(); N],
            factor: SMatrix::zeros(),
            len: 0,
            implied: [false; MAX_CONSTRAINTS],
        }
    }

    fn contains(&self, row: usize) -> bool {
        self.implied[row] || self.rows[..self.len].contains(&row)
    }

    fn remove(&mut self, at: usize, problem: &Whitened<N>) {
        self.rows.copy_within(at + 1..self.len, at);
        self.multipliers.copy_within(at + 1..self.len, at);
        let len = core::mem::take(&mut self.len) - 1;
        // What followed from the removed row may not follow any more.
        self.implied = [false; MAX_CONSTRAINTS];
        for _ in 0..len {
            self.append_basis(&problem.normals[self.rows[self.len]]);
        }
    }

    fn push(&mut self, row: usize, multiplier: f64, problem: &Whitened<N>) {
        self.rows[self.len] = row;
        self.multipliers[self.len] = multiplier;
        self.append_basis(&problem.normals[row]);
    }

    fn append_basis(&mut self, normal: &SVector<f64, N>) {
        let k = self.len;
        let (coefficients, rest) = self.split(normal);
        let size = rest.norm();
        self.factor.set_column(k, &coefficients);
        self.factor[(k, k)] = size;
        self.basis[k] = rest / size.max(f64::MIN_POSITIVE);
        self.len += 1;
    }

    /// Coefficients of `normal` in the basis, and what is orthogonal to it (Gram-Schmidt, twice).
    fn split(&self, normal: &SVector<f64, N>) -> (SVector<f64, N>, SVector<f64, N>) {
        let mut coefficients = SVector::zeros();
        let mut rest = *normal;
        for _ in 0..2 {
            for k in 0..self.len {
                let c = self.basis[k].dot(&rest);
                coefficients[k] += c;
                rest -= self.basis[k] * c;
            }
        }
        (coefficients, rest)
    }

    /// Change of the working multipliers for a unit multiplier of a new row.
    fn duals(&self, coefficients: &SVector<f64, N>) -> SVector<f64, N> {
        let mut dual = SVector::zeros();
        for k in (0..self.len).rev() {
            let known: f64 = (k + 1..self.len)
                .map(|j| self.factor[(k, j)] * dual[j])
                .sum();
            dual[k] = (coefficients[k] - known) / self.factor[(k, k)];
        }
        dual
    }
}

/// Minimises `x' H x / 2 + g' x` subject to all rows.
///
/// # Errors
/// See [`QpError`].
pub fn solve<const N: usize>(
    hessian: &SMatrix<f64, N, N>,
    gradient: &SVector<f64, N>,
    rows: &[Constraint<N>],
) -> Result<Solution<N>, QpError> {
    if rows.len() > MAX_CONSTRAINTS {
        return Err(QpError::TooManyConstraints { count: rows.len() });
    }
    let finite = hessian.iter().chain(gradient.iter()).all(|x| x.is_finite())
        && rows
            .iter()
            .all(|r| r.bound.is_finite() && r.normal.iter().all(|x| x.is_finite()));
    if !finite {
        return Err(QpError::NonFinite);
    }
    let lower = hessian.cholesky().ok_or(QpError::NotConvex)?.unpack();
    let whiten = |v: &SVector<f64, N>| lower.solve_lower_triangular(v).ok_or(QpError::NotConvex);
    let mut problem = Whitened {
        normals: [SVector::zeros(); MAX_CONSTRAINTS],
        bounds: [0.0; MAX_CONSTRAINTS],
        sizes: [1.0; MAX_CONSTRAINTS],
        count: rows.len(),
    };
    for (i, row) in rows.iter().enumerate() {
        problem.normals[i] = whiten(&row.normal)?;
        problem.bounds[i] = row.bound;
        problem.sizes[i] = row.normal.norm().max(1e-12);
    }
    let mut z = -whiten(gradient)?;
    let mut working = Working::<N>::new();
    for _ in 0..20 * (MAX_CONSTRAINTS + N) {
        if let Some(entering) = most_violated(&problem, &z, &working) {
            add_row(&problem, entering, &mut z, &mut working)?;
            continue;
        }
        let mut multipliers = [0.0; MAX_CONSTRAINTS];
        for k in 0..working.len {
            multipliers[working.rows[k]] = working.multipliers[k];
        }
        let x = lower
            .transpose()
            .solve_upper_triangular(&z)
            .ok_or(QpError::NotConvex)?;
        return Ok(Solution { x, multipliers });
    }
    Err(QpError::NotConverged)
}

fn most_violated<const N: usize>(
    problem: &Whitened<N>,
    z: &SVector<f64, N>,
    working: &Working<N>,
) -> Option<usize> {
    let mut worst = None;
    let mut depth = -FEASIBLE;
    for i in 0..problem.count {
        let s = problem.slack(i, z);
        if s < depth && !working.contains(i) {
            depth = s;
            worst = Some(i);
        }
    }
    worst
}

/// Moves along the dual until `entering` holds, dropping rows whose multiplier reaches zero.
fn add_row<const N: usize>(
    problem: &Whitened<N>,
    entering: usize,
    z: &mut SVector<f64, N>,
    working: &mut Working<N>,
) -> Result<(), QpError> {
    let normal = problem.normals[entering];
    let mut multiplier = 0.0;
    for _ in 0..=2 * N {
        let (coefficients, direction) = working.split(&normal);
        let dual = working.duals(&coefficients);
        // Longest step that keeps every multiplier non-negative.
        let (mut dual_step, mut leaving) = (f64::INFINITY, None);
        for k in 0..working.len {
            if dual[k] > 1e-12 && working.multipliers[k] / dual[k] < dual_step {
                dual_step = working.multipliers[k] / dual[k];
                leaving = Some(k);
            }
        }
        let curvature = direction.norm_squared();
        let dependent = working.len == N || curvature <= 1e-18 * normal.norm_squared();
        let primal_step = if dependent {
            f64::INFINITY
        } else {
            -problem.slack(entering, z) * problem.sizes[entering] / curvature
        };
        let step = dual_step.min(primal_step);
        if !step.is_finite() {
            if problem.slack(entering, z) > -DEPENDENT {
                working.implied[entering] = true;
                return Ok(());
            }
            return Err(QpError::Infeasible {
                constraint: entering,
            });
        }
        if !dependent {
            *z += direction * step;
        }
        for k in 0..working.len {
            working.multipliers[k] -= step * dual[k];
        }
        multiplier += step;
        if primal_step <= dual_step {
            working.push(entering, multiplier, problem);
            return Ok(());
        }
        if let Some(k) = leaving {
            working.remove(k, problem);
        }
    }
    Err(QpError::NotConverged)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clarabel::algebra::CscMatrix;
    use clarabel::solver::{
        DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus,
    };
    use proptest::prelude::*;

    /// Duality gap, of objectives of order one, at which the library ends.
    const LIBRARY: f64 = 1e-11;

    /// Least curvature of the programs.
    const CURVATURE: f64 = 0.05;

    type Program = (SMatrix<f64, 4, 4>, SVector<f64, 4>, Vec<Constraint<4>>);

    fn any_program() -> impl Strategy<Value = Program> {
        let numbers = prop::collection::vec(-1.0_f64..1.0, 20);
        let rows =
            prop::collection::vec((prop::array::uniform4(-1.0_f64..1.0), -0.5_f64..0.3), 0..12);
        (numbers, rows).prop_map(|(x, rows)| {
            let a = SMatrix::<f64, 4, 4>::from_iterator(x[..16].iter().copied());
            let h = a.transpose() * a + SMatrix::identity() * CURVATURE;
            let g = SVector::from_iterator(x[16..].iter().copied());
            let rows = rows
                .into_iter()
                .map(|(n, bound)| Constraint {
                    normal: SVector::from(n),
                    bound,
                })
                .collect();
            (h, g, rows)
        })
    }

    /// The same program by an interior-point library.
    fn oracle(program: &Program) -> (SolverStatus, SVector<f64, 4>) {
        let (h, g, rows) = program;
        let dense: Vec<Vec<f64>> = (0..4)
            .map(|i| {
                (0..4)
                    .map(|j| if j >= i { h[(i, j)] } else { 0.0 })
                    .collect()
            })
            .collect();
        let p = CscMatrix::from(&dense);
        // Clarabel: A x + s = b, s >= 0.
        let a: Vec<Vec<f64>> = rows
            .iter()
            .map(|r| r.normal.iter().map(|v| -v).collect())
            .collect();
        let b: Vec<f64> = rows.iter().map(|r| -r.bound).collect();
        let a = if a.is_empty() {
            CscMatrix::zeros((0, 4))
        } else {
            CscMatrix::from(&a)
        };
        let cones = [NonnegativeConeT(b.len())];
        let settings = DefaultSettings {
            verbose: false,
            tol_gap_abs: LIBRARY,
            tol_gap_rel: LIBRARY,
            tol_feas: LIBRARY,
            ..Default::default()
        };
        let mut solver = DefaultSolver::new(&p, g.as_slice(), &a, &b, &cones, settings).unwrap();
        solver.solve();
        (
            solver.solution.status,
            SVector::from_column_slice(&solver.solution.x),
        )
    }

    proptest! {
        #![proptest_config(crate::seeded())]

        #[test]
        fn agrees_with_an_interior_point_library(program in any_program()) {
            let ours = solve(&program.0, &program.1, &program.2);
            match oracle(&program) {
                (SolverStatus::Solved, x) => {
                    // A gap in the objective allows its square root in the unknowns.
                    let ours = ours.unwrap().x;
                    let cost = ours.dot(&(program.0 * ours)) / 2.0 + program.1.dot(&ours);
                    let allowed = (2.0 * LIBRARY * cost.abs().max(1.0) / CURVATURE).sqrt();
                    let off = (ours - x).norm();
                    prop_assert!(off < allowed, "{off} of {allowed}");
                }
                (SolverStatus::PrimalInfeasible, _) => {
                    let told = matches!(ours, Err(QpError::Infeasible { .. }));
                    prop_assert!(told, "{ours:?}");
                }
                _ => prop_assume!(false),
            }
        }

        #[test]
        fn solutions_satisfy_the_optimality_conditions(program in any_program()) {
            let (h, g, rows) = program;
            if let Ok(s) = solve(&h, &g, &rows) {
                let mut stationarity = h * s.x + g;
                for (i, row) in rows.iter().enumerate() {
                    let gap = row.normal.dot(&s.x) - row.bound;
                    prop_assert!(gap > -1e-8);
                    prop_assert!(s.multipliers[i] >= -1e-9);
                    prop_assert!((gap * s.multipliers[i]).abs() < 1e-7 * (1.0 + s.multipliers[i]));
                    stationarity -= row.normal * s.multipliers[i];
                }
                // Rounding of the sum: multipliers are large where rows nearly contradict.
                let sum: f64 = s.multipliers.iter().sum();
                prop_assert!(stationarity.norm() < 1e-12 * (1.0 + sum));
            }
        }
    }

    #[test]
    fn contradictions_and_bad_numbers_are_told() {
        let h = SMatrix::<f64, 2, 2>::identity();
        let g = SVector::<f64, 2>::zeros();
        let up = Constraint {
            normal: SVector::from([1.0, 0.0]),
            bound: 1.0,
        };
        let down = Constraint {
            normal: SVector::from([-1.0, 0.0]),
            bound: 0.0,
        };
        assert!(matches!(
            solve(&h, &g, &[up, down]),
            Err(QpError::Infeasible { .. })
        ));
        let bad = Constraint {
            normal: SVector::from([f64::NAN, 0.0]),
            bound: 0.0,
        };
        assert_eq!(solve(&h, &g, &[bad]), Err(QpError::NonFinite));
        assert_eq!(solve(&-h, &g, &[]), Err(QpError::NotConvex));
    }
}
