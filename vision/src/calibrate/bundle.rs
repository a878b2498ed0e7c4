//! Levenberg-Marquardt over parameters that all views share and one pose of each view.
//!
//! The poses are eliminated by the Schur complement \[Triggs2000\]; the reduced system is solved
//! by faer.

use faer::linalg::solvers::{DenseSolveCore, Llt, Solve};
use faer::{Mat, Side};
use nalgebra::{Matrix6, SMatrix, SVector, Vector6};

/// Normal equations of one view: shared parameters, the view's pose, and between them.
#[derive(Clone, Debug)]
pub(super) struct Block<const S: usize> {
    pub u: SMatrix<f64, S, S>,
    pub w: SMatrix<f64, S, 6>,
    pub v: Matrix6<f64>,
    pub gs: SVector<f64, S>,
    pub gv: Vector6<f64>,
}

/// A problem of that structure, at one value of its parameters.
pub(super) trait Bundle<const S: usize>: Sized {
    /// Normal equations of every view and the total cost \[px2\]; `None` where the model has
    /// no value.
    fn linearise(&self) -> Option<(Vec<Block<S>>, f64)>;
    /// The problem at other parameters.
    fn stepped(&self, shared: &SVector<f64, S>, poses: &[Vector6<f64>]) -> Self;
}

/// A minimum.
#[derive(Clone, Debug)]
pub(super) struct Minimum<B, const S: usize> {
    pub bundle: B,
    pub blocks: Vec<Block<S>>,
    pub cost: f64,
    pub iterations: usize,
}

/// Why there is no minimum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum NoMinimum {
    /// The start puts a corner behind a camera, or the normal equations are singular.
    Singular,
    /// The iterations ran out.
    NotSettled { iterations: usize },
}

const MAX_ITERATIONS: usize = 100;

/// Minimises from where the bundle stands.
pub(super) fn minimise<B: Bundle<S>, const S: usize>(start: B) -> Result<Minimum<B, S>, NoMinimum> {
    let (blocks, cost) = start.linearise().ok_or(NoMinimum::Singular)?;
    let mut at = Minimum {
        bundle: start,
        blocks,
        cost,
        iterations: 0,
    };
    let mut damping = 1e-4;
    while at.iterations < MAX_ITERATIONS {
        at.iterations += 1;
        let Some((shared, poses, decrease)) = step(&at.blocks, damping) else {
            damping *= 10.0;
            if damping > 1e8 {
                return Err(NoMinimum::Singular);
            }
            continue;
        };
        // What is still to gain is far below a thousandth of one sigma of any parameter.
        let settled = decrease <= 1e-12 * at.cost + f64::MIN_POSITIVE;
        let next = at.bundle.stepped(&shared, &poses);
        match next.linearise() {
            Some((blocks, cost)) if cost <= at.cost => {
                // A step as good as predicted needs no damping.
                damping *= if at.cost - cost > 0.5 * decrease {
                    0.02
                } else {
                    0.5
                };
                (at.bundle, at.blocks, at.cost) = (next, blocks, cost);
                if settled {
                    return Ok(at);
                }
            }
            // At rounding's end a step of no consequence may rise.
            _ if settled => return Ok(at),
            _ => {
                damping = (damping * 10.0).max(1e-6);
                if damping > 1e12 {
                    return Ok(at);
                }
            }
        }
    }
    Err(NoMinimum::NotSettled {
        iterations: at.iterations,
    })
}

type Step<const S: usize> = (SVector<f64, S>, Vec<Vector6<f64>>, f64);

/// The damped Gauss-Newton step and the decrease that it predicts.
fn step<const S: usize>(blocks: &[Block<S>], damping: f64) -> Option<Step<S>> {
    let mut reduced = SMatrix::<f64, S, S>::zeros();
    let mut rhs = SVector::<f64, S>::zeros();
    let mut eliminated = Vec::with_capacity(blocks.len());
    for block in blocks {
        reduced += block.u;
    }
    for i in 0..S {
        reduced[(i, i)] *= 1.0 + damping;
    }
    hold_unused(&mut reduced);
    for block in blocks {
        let mut v = block.v;
        for i in 0..6 {
            v[(i, i)] *= 1.0 + damping;
        }
        let factor = v.cholesky()?;
        let y = factor.solve(&block.w.transpose());
        let own = factor.solve(&block.gv);
        reduced -= block.w * y;
        rhs += block.gs - block.w * own;
        eliminated.push((y, own));
    }
    let factor = factor(&reduced)?;
    let x = factor.solve(Mat::from_fn(S, 1, |i, _| rhs[i]));
    let shared = SVector::<f64, S>::from_fn(|i, _| x[(i, 0)]);
    let mut decrease = 0.0;
    let poses = blocks
        .iter()
        .zip(&eliminated)
        .map(|(block, (y, own))| {
            let pose = own - y * shared;
            decrease += block.gv.dot(&pose) + block.gs.dot(&shared);
            pose
        })
        .collect();
    decrease.is_finite().then_some((shared, poses, decrease))
}

/// Keeps parameters without effect (coefficients that a lens model does not use) where they are.
fn hold_unused<const S: usize>(matrix: &mut SMatrix<f64, S, S>) {
    for i in 0..S {
        if matrix[(i, i)] == 0.0 {
            matrix[(i, i)] = 1.0;
        }
    }
}

fn factor<const S: usize>(matrix: &SMatrix<f64, S, S>) -> Option<Llt<f64>> {
    if !matrix.iter().all(|x| x.is_finite()) {
        return None;
    }
    Mat::from_fn(S, S, |i, j| matrix[(i, j)])
        .llt(Side::Lower)
        .ok()
}

/// Information about the shared parameters that one view brings, its pose unknown, and the
/// gradient that goes with it.
pub(super) fn reduced<const S: usize>(
    block: &Block<S>,
) -> Option<(SMatrix<f64, S, S>, SVector<f64, S>)> {
    let factor = block.v.cholesky()?;
    let y = factor.solve(&block.w.transpose());
    Some((
        block.u - block.w * y,
        block.gs - block.w * factor.solve(&block.gv),
    ))
}

/// Inverse of the reduced normal equations: the covariance of the shared parameters for corners
/// with unit variance. Zero for parameters without effect.
pub(super) fn inverse<const S: usize>(
    information: &SMatrix<f64, S, S>,
) -> Option<SMatrix<f64, S, S>> {
    let mut held = *information;
    hold_unused(&mut held);
    let inverse = factor(&held)?.inverse();
    let used = |i: usize| information[(i, i)] != 0.0;
    let result = SMatrix::<f64, S, S>::from_fn(|i, j| {
        if used(i) && used(j) {
            f64::midpoint(inverse[(i, j)], inverse[(j, i)])
        } else {
            0.0
        }
    });
    result.iter().all(|x| x.is_finite()).then_some(result)
}
