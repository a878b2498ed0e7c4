//! Newton's method for the rod's equilibrium.

use nalgebra::Vector3;

use super::{Load, Rod};

/// Newton stops after a step shorter than this \[m\]: the remaining error is quadratically
/// smaller, far below a nanometre.
const STEP_TOLERANCE: f64 = 2e-7;
/// An edge turns by at most this in one Newton step \[rad\].
const LARGEST_TURN: f64 = 0.3;
const MOST_ITERATIONS: u32 = 80;

/// How an equilibrium was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Solution {
    /// Newton steps taken.
    pub(crate) iterations: u32,
    /// Length of the last step \[m\].
    pub(crate) last_step: f64,
    /// Whether the last step was short enough.
    pub(crate) converged: bool,
    /// Whether the tangent at the end was positive definite; a rod in unstable equilibrium
    /// buckles.
    pub(crate) stable: bool,
}

impl Rod {
    /// Finds the equilibrium under `load` near the present shape. On return `self.nodes` holds
    /// it and `self.load` the forces (to first order in the last step).
    pub(crate) fn relax(&mut self, load: &mut impl Load) -> Solution {
        let mut solution = Solution {
            iterations: 0,
            last_step: f64::INFINITY,
            converged: false,
            stable: true,
        };
        let mut previous = f64::INFINITY;
        let mut damping: f64 = 1.0;
        while solution.iterations < MOST_ITERATIONS {
            self.evaluate(load);
            solution.stable = self.newton_step();
            let length = largest(&self.step);
            if !length.is_finite() {
                break;
            }
            // Natural monotonicity test: the next Newton step must be shorter than the last.
            if length > 1.5 * previous && damping > 0.02 {
                damping *= 0.5;
                self.nodes.copy_from_slice(&self.trial);
                self.evaluate(load);
                solution.stable = self.newton_step();
            } else {
                previous = length;
                damping = (2.0 * damping).min(1.0);
            }
            let turn = self
                .step
                .windows(2)
                .fold(self.step[0].norm(), |m, w| m.max((w[1] - w[0]).norm()))
                / self.edge;
            let fraction = damping * (LARGEST_TURN / turn).min(1.0);
            self.trial.copy_from_slice(&self.nodes);
            self.apply_step(fraction);
            solution.iterations += 1;
            solution.last_step = fraction * largest(&self.step);
            if solution.last_step < STEP_TOLERANCE && fraction > 0.99 {
                solution.converged = true;
                break;
            }
        }
        solution
    }

    /// Fills `self.step`; whether the tangent was positive definite without a shift.
    fn newton_step(&mut self) -> bool {
        self.step.copy_from_slice(&self.gradient[1..]);
        let stable = self.band.factorise(0.0);
        if !stable {
            let mut shift = 1e-9 * self.band.scale();
            while !self.band.factorise(shift) && shift.is_finite() {
                shift *= 4.0;
            }
        }
        self.band.solve(&mut self.step);
        stable
    }

    /// Moves along the step: edges turn without stretching, then stretch by its axial part.
    fn apply_step(&mut self, fraction: f64) {
        let mut before = Vector3::zeros();
        let mut position = self.nodes[0];
        let mut old = self.nodes[0];
        for i in 0..self.step.len() {
            let step = self.step[i] * fraction;
            let change = step - before;
            before = step;
            let e = self.nodes[i + 1] - old;
            old = self.nodes[i + 1];
            let length = e.norm();
            let t = e / length;
            let axial = t.dot(&change);
            let turned = e + change - t * axial;
            position += turned * ((length + axial) / turned.norm());
            self.nodes[i + 1] = position;
        }
    }
}

fn largest(step: &[Vector3<f64>]) -> f64 {
    // `max` would drop a NaN; the sum keeps it.
    let bound = step.iter().fold(0.0, |m: f64, s| m.max(s.norm_squared()));
    let poison: f64 = step.last().map_or(0.0, |s| 0.0 * s.sum());
    bound.sqrt() + poison
}
