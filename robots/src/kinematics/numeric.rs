//! Inverse kinematics by damped Newton iterations from many starting points.

use core::f64::consts::PI;

use hal::Joints;
use nalgebra::{Isometry3, Matrix6, Vector6};

use super::chain::{Chain, JointKind};
use super::redundant;

/// Starting points for a redundant arm once a solution is known: there is always another one.
const REDUNDANT_STARTS: u32 = 512;
/// Families of solutions of a redundant arm that are followed, at most.
const MOST_FAMILIES: u32 = 32;
/// Most starting points.
const MOST_STARTS: u32 = 4096;
/// Starting points that find nothing before a pose counts as out of reach.
const VAIN_STARTS: u32 = 512;
/// Starting points before the search may end, and how often every solution has to have been met
/// then: the ones still unmet have small basins of attraction, or there are none.
const LEAST_STARTS: u32 = 128;
/// See [`LEAST_STARTS`].
const MEETINGS: u32 = 6;
/// Iterations from each.
const ITERATIONS: usize = 60;
/// Pose error of a solution, linear in metres and angular in radians: rounding.
const CONVERGED: f64 = 1e-12;
/// Error up to which a stalled iteration still counts.
const ACCEPTED: f64 = 2e-11;
/// Solutions closer than this are one: what the error leaves near a singularity \[rad\].
const SAME: f64 = 1e-6;
/// A 6-joint arm has no more solutions; of 7 joints, as many within the limits are enough to
/// choose from.
const MOST: usize = 16;
/// Bases of the Halton sequence, one a joint.
const BASES: [u32; hal::MAX_JOINTS] = [2, 3, 5, 7, 11, 13, 17];

/// Calls `found` with every solution met, wherever in the circle; `near` are joint positions
/// that may be close to solutions.
pub(super) fn solve(
    chain: &Chain,
    target: &Isometry3<f64>,
    near: &[Joints],
    found: &mut impl FnMut(Joints),
) {
    let mut search = Search {
        chain,
        target,
        redundant: chain.len() > 6,
        solutions: Vec::new(),
        families: 0,
    };
    for q in near.iter().filter_map(|q| newton(chain, target, *q)) {
        search.meet(q, found);
    }
    for index in 1..=MOST_STARTS {
        if let Some(q) = newton(chain, target, start(chain, index)) {
            search.meet(q, found);
        }
        if search.is_over(index) {
            return;
        }
    }
}

struct Search<'a> {
    chain: &'a Chain,
    target: &'a Isometry3<f64>,
    redundant: bool,
    /// Solutions met, and how often.
    solutions: Vec<(Joints, u32)>,
    /// Families of solutions that were followed before one led inside the limits.
    families: u32,
}

impl Search<'_> {
    fn meet(&mut self, q: Joints, found: &mut impl FnMut(Joints)) {
        let mut q = q;
        if self.redundant && self.chain.near_zero(&q).is_none() {
            // Outside the limits: another member of its family may be inside.
            if self.solutions.is_empty() {
                self.families += 1;
            }
            match redundant::within_limits(self.chain, self.target, &q) {
                Some(inside) => q = inside,
                None => return,
            }
        }
        let known = self
            .solutions
            .iter_mut()
            .find(|(other, _)| self.chain.is_same(other, &q, SAME));
        if let Some((_, meetings)) = known {
            *meetings += 1;
        } else {
            self.solutions.push((q, 1));
            found(q);
        }
    }

    /// Whether the search ends after `starts` starting points.
    fn is_over(&self, starts: u32) -> bool {
        if self.solutions.is_empty() {
            let in_vain = starts == VAIN_STARTS && self.families == 0;
            return in_vain || self.families >= MOST_FAMILIES;
        }
        let again = |(_, meetings): &(Joints, u32)| *meetings >= MEETINGS;
        self.solutions.len() == MOST
            || self.redundant && starts >= REDUNDANT_STARTS
            || starts >= LEAST_STARTS && self.solutions.iter().all(again)
    }
}

/// Point `index` of the Halton sequence, spread over one turn of every joint within its range.
fn start(chain: &Chain, index: u32) -> Joints {
    let mut q = Joints::from([0.0; hal::MAX_JOINTS]);
    for (i, (limit, kind)) in chain.limits().iter().zip(chain.kinds()).enumerate() {
        let (mut share, mut digit, mut rest) = (0.0, 1.0, index);
        while rest > 0 {
            digit /= f64::from(BASES[i]);
            share += digit * f64::from(rest % BASES[i]);
            rest /= BASES[i];
        }
        let middle = 0.5 * (limit.lower + limit.upper);
        let range = 0.5 * (limit.upper - limit.lower);
        let half = match kind {
            JointKind::Prismatic => range,
            _ => range.min(PI),
        };
        q[i] = middle + half * (2.0 * share - 1.0);
    }
    Joints::from_slice(&q[..chain.len()]).unwrap_or(q)
}

/// Levenberg-Marquardt on the pose error.
pub(super) fn newton(chain: &Chain, target: &Isometry3<f64>, mut q: Joints) -> Option<Joints> {
    let (mut pose, mut jacobian) = chain.forward_jacobian(&q);
    let mut error = difference(&pose, target);
    let mut damping = 1e-2;
    for _ in 0..ITERATIONS {
        if error.norm() < CONVERGED {
            break;
        }
        let gram = jacobian * jacobian.transpose() + Matrix6::identity() * damping;
        let Some(factors) = gram.cholesky() else {
            damping = (damping * 10.0).max(1e-12);
            continue;
        };
        let step = jacobian.transpose() * factors.solve(&error);
        let mut tried = q;
        for (x, dx) in tried.iter_mut().zip(step.iter()) {
            *x += dx;
        }
        let (new_pose, new_jacobian) = chain.forward_jacobian(&tried);
        let new_error = difference(&new_pose, target);
        if new_error.norm() < error.norm() {
            (q, pose, jacobian, error) = (tried, new_pose, new_jacobian, new_error);
            damping = if damping < 1e-9 { 0.0 } else { damping * 0.1 };
        } else if error.norm() < ACCEPTED {
            break;
        } else {
            damping = (damping * 10.0).max(1e-9);
            if damping > 1e6 {
                return None;
            }
        }
    }
    debug_assert!(pose.translation.vector.iter().all(|x| x.is_finite()));
    (error.norm() < ACCEPTED).then_some(q)
}

/// Twist that takes `pose` to `target` in unit time.
fn difference(pose: &Isometry3<f64>, target: &Isometry3<f64>) -> Vector6<f64> {
    let linear = target.translation.vector - pose.translation.vector;
    let angular = (target.rotation * pose.rotation.inverse()).scaled_axis();
    Vector6::new(
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
    )
}
