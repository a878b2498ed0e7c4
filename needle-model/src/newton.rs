//! The solver of the needle's equations: fixed-point steps from cold, then Newton's method.
//!
//! A Newton step with a new tangent costs four times one with the tangent last factored. From image to
//! image the needle moves so little that the old tangent still gains two or three digits a step
//! (the chord method), so a new one is factored only where the steps do not shrink tenfold.

use nalgebra::Vector3;

use crate::block::{Block, Singular};
use crate::equilibrium::{Convergence, Equilibrium};
use crate::equilibrium_error::EquilibriumError;
use crate::piece::Piece;

/// Newton steps before giving up.
const MAX_ITERATIONS: usize = 60;
/// Fixed-point steps before Newton's method on a cold start.
const RELAXATIONS: usize = 3;
/// Largest change of a derivative in one step.
const MAX_TURN: f64 = 0.5;
/// Arm that turns a change of slope into a length, for the tolerance \[m\].
const SLOPE_ARM: f64 = 0.01;
/// Longest step taken with an old tangent \[m\].
const REACH: f64 = 0.5e-3;
/// Largest ratio of a step to the one before it at which an old tangent is kept.
const CONTRACTION: f64 = 0.1;
/// A tangent factored this close to the present state is the state's \[m\]: it turns with the needle's
/// slope, so that a nanometre of the state costs 1e-5 of a derivative, this 1e-8.
const FRESH: f64 = 1e-12;
/// Part of the tolerance that may be left after a last step with an old tangent.
const REMAINDER: f64 = 1e-2;

impl Equilibrium {
    /// As [`Self::converge`], from cold.
    pub(crate) fn restart(
        &mut self,
        update: impl FnMut(&mut Self, usize),
    ) -> Result<Convergence, EquilibriumError> {
        self.start();
        self.relax()?;
        let result = self.converge(update)?;
        self.convergence.iterations = result.iterations + RELAXATIONS;
        Ok(self.convergence)
    }

    /// Fixed-point steps from a cold start: linear beam with planes and lengths frozen, then both
    /// renewed. Converges from far away, where Newton's method may not.
    fn relax(&mut self) -> Result<(), EquilibriumError> {
        for iteration in 1..=RELAXATIONS {
            let unstable = |_| EquilibriumError::Unstable { iteration };
            self.settle(true);
            let mut border = self.linearize(true).map_err(unstable)?;
            self.advance(&mut border, f64::INFINITY).map_err(unstable)?;
            let z = self.nodes[0].d;
            let mut used = 0.0;
            for i in 1..self.nodes.len() {
                for _ in 0..3 {
                    let (a, b) = (&self.nodes[i - 1], &self.nodes[i]);
                    let mut piece = Piece::default();
                    piece.set(self.stiffness, a, b, &z, true);
                    self.nodes[i].l = (self.nodes[i].l + piece.slack).max(0.5 * self.nodes[i].l);
                }
                used += self.nodes[i].l;
            }
            self.tip_length = self.needle.length() - used;
        }
        Ok(())
    }

    /// Newton's method; `update` may renew stiffnesses and load from the state before each step.
    pub(crate) fn converge(
        &mut self,
        mut update: impl FnMut(&mut Self, usize),
    ) -> Result<Convergence, EquilibriumError> {
        self.convergence.residual = f64::NAN;
        self.factored_within = f64::INFINITY;
        self.searches += 1;
        self.settle(false);
        let mut last_step_m = f64::NAN;
        let mut shrinking = true;
        for iteration in 1..=MAX_ITERATIONS {
            let unstable = |Singular| EquilibriumError::Unstable { iteration };
            let load = self.load;
            update(self, iteration - 1);
            if self.load != load {
                self.settle_tip();
            }
            let chord = if self.factored && shrinking {
                let mut border = self.residual();
                let step = self.advance(&mut border, REACH).map_err(unstable)?;
                (step <= REACH).then_some(step)
            } else {
                None
            };
            let step = if let Some(step) = chord {
                step
            } else {
                let mut border = self.linearize(false).map_err(unstable)?;
                self.advance(&mut border, f64::INFINITY).map_err(unstable)?
            };
            if !step.is_finite() {
                return Err(EquilibriumError::Unstable { iteration });
            }
            // Steps with one tangent shrink by about the same ratio each: what follows a step is
            // that ratio times the step. The first has none before it to compare with.
            let before = if iteration == 1 { step } else { last_step_m };
            let settled = chord.is_none() || step * step <= REMAINDER * self.tolerance * before;
            if step <= self.tolerance && settled {
                self.convergence = Convergence {
                    iterations: iteration,
                    residual: step,
                };
                return Ok(self.convergence);
            }
            let first = iteration == 1;
            shrinking = chord.is_none() || first || step <= CONTRACTION * before;
            self.soon_old |= !shrinking && self.searches == 1;
            shrinking &= chord.is_none() || !self.soon_old;
            last_step_m = step;
        }
        Err(EquilibriumError::NotConverged {
            iterations: MAX_ITERATIONS,
            last_step_m,
        })
    }

    /// Planes of the nodes (frozen: as if they did not turn with the needle) and the tip's piece, for
    /// the present base and rest points.
    pub(crate) fn settle(&mut self, frozen: bool) {
        let (z, x) = (self.nodes[0].d, self.nodes[0].e[0]);
        for (node, spring) in self.nodes[1..].iter_mut().zip(&self.springs) {
            node.refresh(&z, &x, &spring.rest);
            if frozen {
                node.w = Vector3::zeros();
            }
        }
        self.settle_tip();
    }

    /// Solves for the step and takes it, unless it is longer than `reach`; returns its length \[m\].
    fn advance(&mut self, border: &mut Block<2, 1>, reach: f64) -> Result<f64, Singular> {
        self.system.solve(&mut self.rhs, border);
        let n = self.springs.len();
        let mut turn = 0.0_f64;
        for x in &self.rhs {
            turn = turn.max(x[2][0].abs().max(x[3][0].abs()).max(x[4][0].abs()));
        }
        let mut scale = if turn > MAX_TURN {
            MAX_TURN / turn
        } else {
            1.0
        };
        // Lengths first: they need the old nodes, and bound the step so that no piece folds.
        let mut before = (Vector3::zeros(), Vector3::zeros());
        let mut changes = [0.0_f64; 2];
        for i in 1..=n {
            let x: [f64; 5] = std::array::from_fn(|k| self.rhs[i - 1][k][0]);
            let now = self.nodes[i].expand(&x);
            let piece = &mut self.pieces[i - 1];
            piece.slack += piece.l_by[0].dot(&(now.0 - before.0))
                + piece.l_by[1].dot(&before.1)
                + piece.l_by[2].dot(&now.1);
            if piece.slack < -0.9 * self.nodes[i].l {
                scale = scale.min(-0.5 * self.nodes[i].l / piece.slack);
            }
            changes[0] = changes[0].max(now.0.norm_squared());
            changes[1] = changes[1].max(now.1.norm_squared());
            before = now;
        }
        let slope = changes[1].sqrt().max(border[1][0].abs());
        let step = changes[0]
            .sqrt()
            .max(border[0][0].abs())
            .max(slope * SLOPE_ARM);
        if step > reach {
            return Ok(step);
        }
        for i in 1..=n {
            let x: [f64; 5] = std::array::from_fn(|k| self.rhs[i - 1][k][0] * scale);
            let node = &mut self.nodes[i];
            let (dp, dd) = node.expand(&x);
            node.p = settled(&(node.p + dp));
            node.d = settled(&(node.d + dd));
            node.l += self.pieces[i - 1].slack * scale;
        }
        self.tip_length += border[0][0] * scale;
        self.theta += border[1][0] * scale;
        let z = self.nodes[0].d;
        if n > 0 && self.nodes[n].d.dot(&z) < -0.9 * self.nodes[n].d.norm() {
            return Err(Singular);
        }
        self.settle(false);
        self.factored_within += step;
        Ok(step)
    }

    /// Whether the factored tangent is that of the present state, to rounding of its uses.
    pub(crate) fn tangent_is_fresh(&self) -> bool {
        self.factored_within <= FRESH
    }
}

/// The vector with coordinates far below any length made 0: in a plane needle the rounding noise
/// across the plane shrinks with every step, down to slow subnormal numbers.
#[inline]
fn settled(v: &Vector3<f64>) -> Vector3<f64> {
    v.map(|x| if x.abs() < 1e-40 { 0.0 } else { x })
}
