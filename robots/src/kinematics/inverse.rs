//! Inverse kinematics: all postures of the arm for a pose of its tip.

use core::f64::consts::{PI, TAU};

use hal::{JointLimit, Joints};
use nalgebra::Isometry3;

use super::chain::{Chain, JointKind};
use super::numeric;
use super::opw::OpwParameters;

/// Which full turns of the joints count as solutions of their own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Turns {
    /// One solution a posture: every joint as near to zero as its limits allow.
    #[default]
    One,
    /// All full turns within the limits; of more than 65 536 solutions, which joints without ends
    /// to speak of make, those with the later joints' turns next to zero.
    All,
}

/// Rounding by which a solution may lie beyond a limit, onto which it is then put \[rad\].
const AT_LIMIT: f64 = 1e-11;
/// Solutions closer than this are one \[rad\].
const SAME: f64 = 1e-9;
/// Most solutions that differ by full turns.
const MOST: usize = 1 << 16;

impl Chain {
    /// All joint positions within the limits that put the tip at `base_from_tip`.
    ///
    /// Two families of arms are solved analytically: those with an orthogonal base and a spherical
    /// wrist ([`Chain::opw`]), and those with three parallel axes in the middle whose last two
    /// axes meet at a right angle (the Universal Robots). Every branch is returned, exact to
    /// rounding, also close to singularities; where a singularity leaves a joint free, one
    /// representative of the branch.
    ///
    /// Other arms are solved by damped Newton iterations from starting points spread over the
    /// joint ranges, until every solution met has been met several times; arms close to one of
    /// the families (calibrated ones) also from its solutions. Every solution returned is exact
    /// to rounding, but one may be missed: of 10 000 random joint vectors of ten arms without any
    /// special geometry, away from singularities, one was not among the solutions for its pose;
    /// of 4 000 of four UR5e with every length and angle off by up to 3 mm and 3 mrad, none. For
    /// seven joints the solutions are a sample of infinitely many, and every family of them that
    /// is met is followed until it comes within the limits. [`Chain::is_exhaustive`] says which
    /// of these holds.
    ///
    /// A continuous joint comes in (-pi, pi]; its full turns are no solutions of their own.
    ///
    /// A pose out of reach, or one that is not finite, has no solutions.
    pub fn inverse(&self, base_from_tip: &Isometry3<f64>, turns: Turns) -> Vec<Joints> {
        let mut solutions = Vec::with_capacity(8);
        let finite = base_from_tip
            .translation
            .vector
            .iter()
            .all(|x| x.is_finite())
            && base_from_tip.rotation.coords.iter().all(|x| x.is_finite());
        if !finite {
            return solutions;
        }
        let mut keep = |q: Joints| {
            if let Some(q) = self.near_zero(&q)
                && !solutions.iter().any(|other| self.is_same(other, &q, SAME))
            {
                solutions.push(q);
            }
        };
        self.solver().solve(self, base_from_tip, &mut keep);
        match turns {
            Turns::One => solutions,
            Turns::All => self.all_turns(&solutions),
        }
    }

    /// The solution nearest to `q`, by the largest joint difference, full turns included.
    pub fn inverse_near(&self, base_from_tip: &Isometry3<f64>, q: &Joints) -> Option<Joints> {
        let distance = |x: &Joints| x.zip(q, |a, b| a - b).max_abs();
        self.inverse(base_from_tip, Turns::One)
            .into_iter()
            .map(|mut solution| {
                let joints = self.limits().iter().zip(self.kinds());
                for ((x, (limit, kind)), near) in solution.iter_mut().zip(joints).zip(q.iter()) {
                    if *kind != JointKind::Prismatic {
                        *x = turn_next_to(*x, *near, limit).unwrap_or(*x);
                    }
                }
                solution
            })
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    /// The solution that damped Newton iterations from `q` lead to, wherever in the circle and
    /// within the limits or not; nothing if they do not converge.
    pub fn refine(&self, base_from_tip: &Isometry3<f64>, q: &Joints) -> Option<Joints> {
        numeric::newton(self, base_from_tip, *q)
    }

    /// Whether [`Chain::inverse`] finds every solution, so that none means out of reach. Without
    /// an analytic solution the search is not sure of that.
    pub fn is_exhaustive(&self) -> bool {
        self.solver().is_exact()
    }

    /// Parameters of an arm with an orthogonal base and a spherical wrist; `None` for others.
    pub fn opw(&self) -> Option<&OpwParameters> {
        self.solver().opw()
    }

    /// The same posture with every joint as near to zero as its limits allow, if they do.
    pub(super) fn near_zero(&self, q: &Joints) -> Option<Joints> {
        let mut out = *q;
        for (x, (limit, kind)) in out.iter_mut().zip(self.limits().iter().zip(self.kinds())) {
            let principal = *x - TAU * (*x / TAU).round();
            *x = match kind {
                JointKind::Prismatic => onto(*x, limit)?,
                JointKind::Continuous if principal <= -PI => principal + TAU,
                JointKind::Continuous => principal,
                JointKind::Revolute => {
                    onto(principal, limit).or_else(|| turn_next_to(principal, 0.0, limit))?
                }
            };
        }
        Some(out)
    }

    /// Whether two joint vectors are one up to full turns and `tolerance` \[rad, m\].
    pub(super) fn is_same(&self, a: &Joints, b: &Joints, tolerance: f64) -> bool {
        let pairs = a.iter().zip(b.iter());
        pairs.zip(self.kinds()).all(|((a, b), kind)| {
            let apart = a - b;
            let turns = match kind {
                JointKind::Prismatic => 0.0,
                _ => (apart / TAU).round(),
            };
            (apart - TAU * turns).abs() < tolerance
        })
    }

    fn all_turns(&self, solutions: &[Joints]) -> Vec<Joints> {
        let mut all = solutions.to_vec();
        for (i, limit) in self.limits().iter().enumerate() {
            if self.kinds()[i] != JointKind::Revolute {
                continue;
            }
            let mut turned = Vec::with_capacity(all.len());
            let most = (MOST / all.len().max(1)).max(1);
            for q in &all {
                for x in turns_of(q[i], limit, most) {
                    if let Some(x) = onto(x, limit) {
                        let mut q = *q;
                        q[i] = x;
                        turned.push(q);
                    }
                }
            }
            all = turned;
        }
        all
    }
}

/// The first and the last full turn to add to `x`, just below the lower limit and just above the
/// upper one.
fn span(x: f64, limit: &JointLimit) -> (f64, f64) {
    let first = ((limit.lower - AT_LIMIT - x) / TAU).ceil();
    let last = ((limit.upper + AT_LIMIT - x) / TAU).floor();
    (first, last)
}

/// `x` and its full turns between the limits, `most` of them at most, from that next to zero.
fn turns_of(x: f64, limit: &JointLimit, most: usize) -> impl Iterator<Item = f64> {
    let (first, last) = span(x, limit);
    let middle = if first <= last {
        (-x / TAU).round().clamp(first, last)
    } else {
        first
    };
    // Outwards: 0, 1, -1, 2, -2, ...
    let half = (middle - first).max(last - middle).max(0.0);
    core::iter::successors(Some(0.0_f64), |k| Some(if *k > 0.0 { -k } else { 1.0 - k }))
        .take_while(move |k| k.abs() <= half)
        .map(move |k| middle + k)
        .filter(move |k| (first..=last).contains(k))
        .take(most)
        .map(move |k| x + TAU * k)
}

/// `x` with the full turns that bring it next to `near` within the limits, if there are any.
fn turn_next_to(x: f64, near: f64, limit: &JointLimit) -> Option<f64> {
    let (first, last) = span(x, limit);
    let turns = ((near - x) / TAU).round();
    (first <= last && turns.is_finite())
        .then(|| x + TAU * turns.clamp(first, last))
        .and_then(|x| onto(x, limit))
}

fn onto(x: f64, limit: &JointLimit) -> Option<f64> {
    (limit.lower - AT_LIMIT..=limit.upper + AT_LIMIT)
        .contains(&x)
        .then(|| x.clamp(limit.lower, limit.upper))
}
