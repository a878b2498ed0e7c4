//! Newton's method for the rod's equilibrium.

use nalgebra::Vector3;

use super::{Load, Rod};

/// Newton stops after a step shorter than this \[m\]: the remaining error is quadratically
/// smaller, far below a nanometre.
const STEP_TOLERANCE: f64 = 2e-7;
/// An edge turns by at most this in one Newton step \[rad\].
const LARGEST_TURN: f64 = 0.3;
/// The same where the way to the equilibrium matters, because the shaft snaps \[rad\].
const CAREFUL_TURN: f64 = 0.04;
/// Newton steps with contacts searched anew in each; a smooth problem needs three to six.
const SEARCHING: u32 = 16;
/// Newton steps with contacts at their places.
const KEEPING: u32 = 50;
/// Newton steps of a shaft that snaps.
const SNAPPING: u32 = 120;
/// Oscillating by less than this between two sides of a corner, contacts keep their places \[m\].
const CORNER: f64 = 1e-3;

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
    ///
    /// Where a node sits at a corner of its contact, the force jumps and Newton's method goes to
    /// and fro between the two sides: then the contacts keep their places, as where a contact
    /// search is made once a step. Where that does not help either the shaft has lost its
    /// equilibrium, and goes from its first shape downhill in small steps.
    pub(crate) fn relax(&mut self, load: &mut impl Load) -> Solution {
        self.start.copy_from_slice(&self.nodes);
        let mut solution = self.iterate(load, SEARCHING, LARGEST_TURN);
        if !solution.converged && solution.last_step < CORNER {
            solution = self.keep_places(load, solution, LARGEST_TURN);
        }
        if !solution.converged || !self.is_sound() {
            self.nodes.copy_from_slice(&self.start);
            load.resist(true);
            let before = solution.iterations;
            solution = self.iterate(load, SNAPPING, CAREFUL_TURN);
            solution.iterations += before;
            if !solution.converged && solution.last_step < CORNER {
                solution = self.keep_places(load, solution, CAREFUL_TURN);
            }
            load.resist(false);
        }
        solution
    }

    fn keep_places(&mut self, load: &mut impl Load, so_far: Solution, turn: f64) -> Solution {
        load.keep_places(true);
        let mut solution = self.iterate(load, KEEPING, turn);
        load.keep_places(false);
        solution.iterations += so_far.iterations;
        solution
    }

    /// At most `most` Newton steps in which no edge turns by more than `largest_turn` \[rad\].
    fn iterate(&mut self, load: &mut impl Load, most: u32, largest_turn: f64) -> Solution {
        let mut solution = Solution {
            iterations: 0,
            last_step: f64::INFINITY,
            converged: false,
            stable: true,
        };
        let mut previous = f64::INFINITY;
        let mut damping: f64 = 1.0;
        while solution.iterations < most {
            self.evaluate(load);
            solution.stable = self.newton_step();
            let mut length = largest(&self.step);
            // Natural monotonicity test: the next Newton step must be shorter than the last.
            // Downhill from an unstable shape it is not.
            if solution.stable && length > 1.5 * previous && damping > 0.02 {
                damping *= 0.5;
                self.nodes.copy_from_slice(&self.trial);
                self.evaluate(load);
                solution.stable = self.newton_step();
                length = largest(&self.step);
            } else {
                previous = if solution.stable {
                    length
                } else {
                    f64::INFINITY
                };
                damping = (2.0 * damping).min(1.0);
            }
            let turn = self
                .step
                .windows(2)
                .fold(self.step[0].norm(), |m, w| m.max((w[1] - w[0]).norm()))
                / self.edge;
            let fraction = damping * (largest_turn / turn).min(1.0);
            if !(length.is_finite() && fraction > 0.0) {
                solution.last_step = f64::INFINITY;
                break;
            }
            self.trial.copy_from_slice(&self.nodes);
            self.apply_step(fraction);
            solution.iterations += 1;
            solution.last_step = fraction * length;
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
            let mut shift = 1e-7 * self.band.scale();
            while !self.band.factorise(shift) && shift.is_finite() {
                shift *= 10.0;
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
    let (bound, sum) = step.iter().fold((0.0f64, 0.0), |(bound, sum), s| {
        let squared = s.norm_squared();
        (bound.max(squared), sum + squared)
    });
    if sum.is_finite() {
        bound.sqrt()
    } else {
        f64::NAN
    }
}
