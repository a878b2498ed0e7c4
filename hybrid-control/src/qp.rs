//! Strictly convex quadratic programs of a few variables: the dual active-set method of
//! Goldfarb and Idnani (1983), of fixed size and without heap.

use nalgebra::{SMatrix, SVector};

/// Most constraints of one program.
pub const MAX_CONSTRAINTS: usize = 40;

/// Violations below this are rounding: the rows are scaled to norm one, the unknowns to order
/// one.
const FEASIBLE: f64 = 1e-9;

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

/// The working set: which rows bind, and their multipliers.
struct Working<const N: usize> {
    rows: [usize; N],
    multipliers: [f64; N],
    len: usize,
}

impl<const N: usize> Working<N> {
    fn contains(&self, row: usize) -> bool {
        self.rows[..self.len].contains(&row)
    }

    fn remove(&mut self, at: usize) {
        self.rows.copy_within(at + 1..self.len, at);
        self.multipliers.copy_within(at + 1..self.len, at);
        self.len -= 1;
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
    let inverse = hessian.cholesky().ok_or(QpError::NotConvex)?.inverse();
    let mut x = -(inverse * gradient);
    let mut working = Working::<N> {
        rows: [0; N],
        multipliers: [0.0; N],
        len: 0,
    };
    for _ in 0..20 * (MAX_CONSTRAINTS + N) {
        let Some(entering) = most_violated(rows, &x, &working) else {
            let mut multipliers = [0.0; MAX_CONSTRAINTS];
            for k in 0..working.len {
                multipliers[working.rows[k]] = working.multipliers[k];
            }
            return Ok(Solution { x, multipliers });
        };
        add_row(&inverse, rows, entering, &mut x, &mut working)?;
    }
    Err(QpError::NotConverged)
}

fn slack<const N: usize>(row: &Constraint<N>, x: &SVector<f64, N>) -> f64 {
    row.normal.dot(x) - row.bound
}

fn most_violated<const N: usize>(
    rows: &[Constraint<N>],
    x: &SVector<f64, N>,
    working: &Working<N>,
) -> Option<usize> {
    let mut worst = None;
    let mut depth = -FEASIBLE;
    for (i, row) in rows.iter().enumerate() {
        let size = row.normal.norm().max(1e-12);
        let s = slack(row, x) / size;
        if s < depth && !working.contains(i) {
            depth = s;
            worst = Some(i);
        }
    }
    worst
}

/// Moves along the dual until `entering` holds, dropping rows whose multiplier reaches zero.
fn add_row<const N: usize>(
    inverse: &SMatrix<f64, N, N>,
    rows: &[Constraint<N>],
    entering: usize,
    x: &mut SVector<f64, N>,
    working: &mut Working<N>,
) -> Result<(), QpError> {
    let normal = rows[entering].normal;
    let mut multiplier = 0.0;
    for _ in 0..=2 * N {
        let (direction, dual) = step_directions(inverse, rows, &normal, working)?;
        // Longest step that keeps every multiplier non-negative.
        let (mut dual_step, mut leaving) = (f64::INFINITY, None);
        for k in 0..working.len {
            if dual[k] > 1e-14 && working.multipliers[k] / dual[k] < dual_step {
                dual_step = working.multipliers[k] / dual[k];
                leaving = Some(k);
            }
        }
        let curvature = direction.dot(&normal);
        let dependent = curvature <= 1e-12 * normal.dot(&(inverse * normal)).max(1e-300);
        let primal_step = if dependent {
            f64::INFINITY
        } else {
            -slack(&rows[entering], x) / curvature
        };
        let step = dual_step.min(primal_step);
        if !step.is_finite() {
            return Err(QpError::Infeasible {
                constraint: entering,
            });
        }
        if primal_step.is_finite() {
            *x += direction * step;
        }
        for k in 0..working.len {
            working.multipliers[k] -= step * dual[k];
        }
        multiplier += step;
        if primal_step <= dual_step {
            if working.len < N {
                working.rows[working.len] = entering;
                working.multipliers[working.len] = multiplier;
                working.len += 1;
                return Ok(());
            }
            return Err(QpError::NotConverged);
        }
        if let Some(k) = leaving {
            working.remove(k);
        }
    }
    Err(QpError::NotConverged)
}

/// Primal direction that keeps the working rows, and the change of their multipliers.
fn step_directions<const N: usize>(
    inverse: &SMatrix<f64, N, N>,
    rows: &[Constraint<N>],
    normal: &SVector<f64, N>,
    working: &Working<N>,
) -> Result<(SVector<f64, N>, SVector<f64, N>), QpError> {
    let free = inverse * normal;
    if working.len == 0 {
        return Ok((free, SVector::zeros()));
    }
    let mut gram = SMatrix::<f64, N, N>::identity();
    let mut right = SVector::<f64, N>::zeros();
    for a in 0..working.len {
        let row = rows[working.rows[a]].normal;
        let image = inverse * row;
        right[a] = row.dot(&free);
        for b in 0..working.len {
            gram[(a, b)] = rows[working.rows[b]].normal.dot(&image);
        }
    }
    let dual = gram.cholesky().ok_or(QpError::NotConverged)?.solve(&right);
    let mut direction = free;
    for a in 0..working.len {
        direction -= inverse * rows[working.rows[a]].normal * dual[a];
    }
    Ok((direction, dual))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clarabel::algebra::CscMatrix;
    use clarabel::solver::{
        DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus,
    };
    use proptest::prelude::*;

    type Program = (SMatrix<f64, 4, 4>, SVector<f64, 4>, Vec<Constraint<4>>);

    fn any_program() -> impl Strategy<Value = Program> {
        let numbers = prop::collection::vec(-1.0_f64..1.0, 20);
        let rows =
            prop::collection::vec((prop::array::uniform4(-1.0_f64..1.0), -0.5_f64..0.3), 0..12);
        (numbers, rows).prop_map(|(x, rows)| {
            let a = SMatrix::<f64, 4, 4>::from_iterator(x[..16].iter().copied());
            let h = a.transpose() * a + SMatrix::identity() * 0.05;
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
            tol_gap_abs: 1e-9,
            tol_gap_rel: 1e-9,
            tol_feas: 1e-9,
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
        #[test]
        fn agrees_with_an_interior_point_library(program in any_program()) {
            let ours = solve(&program.0, &program.1, &program.2);
            match oracle(&program) {
                // 1e-5: the library's own tolerance on x for objectives of order one.
                (SolverStatus::Solved, x) => prop_assert!((ours.unwrap().x - x).norm() < 1e-5),
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
                    let gap = slack(row, &s.x);
                    prop_assert!(gap > -1e-8);
                    prop_assert!(s.multipliers[i] >= -1e-9);
                    prop_assert!((gap * s.multipliers[i]).abs() < 1e-7 * (1.0 + s.multipliers[i]));
                    stationarity -= row.normal * s.multipliers[i];
                }
                prop_assert!(stationarity.norm() < 1e-7);
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
