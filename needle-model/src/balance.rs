//! The paper's balance equations as residuals of a given needle: what the solver must bring to 0.

use nalgebra::Vector3;

use crate::equilibrium::Equilibrium;
use crate::segment::{Segment, curvature_gap, derivative_gap, position_gap};
use crate::spring::spring_force;

/// Normal force \[N\] at the extremity of a segment: Eq. (8).
///
/// The `tip_force` and the forces of the springs from there to the tip, projected across the unit
/// `normal` of the plane there.
///
/// # Deviation
/// The solver projects each spring's force on its own plane and adds the jumps along the needle,
/// instead of projecting the sum on plane i. They differ by about the third power of the
/// slope ([`Residuals::literal_shear`] is the difference); the sum's tangential part, which eq. (8) drops
/// at plane i, would be normal to the needle elsewhere.
pub fn normal_force(
    normal: &Vector3<f64>,
    tip_force: &Vector3<f64>,
    spring_forces: impl Iterator<Item = Vector3<f64>>,
) -> Vector3<f64> {
    let sum = tip_force + spring_forces.sum::<Vector3<f64>>();
    sum - normal * normal.dot(&sum)
}

/// Residual \[N\] of the constant shear along a segment, E I S''' = -F: Eq. (9).
///
/// `ei`: bending stiffness \[N m2\]; `force`: normal force at its extremity \[N\].
///
/// # Deviation
/// Only its part across the needle is meant: along the needle the node stays in its spring's plane.
pub fn shear_residual(segment: &Segment, ei: f64, force: &Vector3<f64>) -> Vector3<f64> {
    segment.third_derivative() * ei + force
}

/// Residual \[N m\] of E I S''(L) = -M_tip `y_tip` on the tip segment: Eq. (11).
pub fn tip_moment_residual(
    segment: &Segment,
    ei: f64,
    m_tip: f64,
    y_tip: &Vector3<f64>,
) -> Vector3<f64> {
    segment.second_derivative(segment.length) * ei + y_tip * m_tip
}

/// Largest residual of each equation over the needle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Residuals {
    /// Eq. (5) \[m\].
    pub position: f64,
    /// Eq. (6).
    pub derivative: f64,
    /// Eq. (7), times E I \[N m\].
    pub moment: f64,
    /// Balance of each spring in its plane \[N\]: eqs. (8) and (9) as the solver reads them.
    pub shear: f64,
    /// Eqs. (8) and (9) to the letter \[N\].
    pub literal_shear: f64,
    /// Eq. (11) \[N m\].
    pub tip_moment: f64,
    /// Distance of a node from its spring's plane \[m\].
    pub plane: f64,
    /// True arc length of a segment less its parametric length \[m\].
    pub arc: f64,
    /// Arc length of the whole less the needle's length \[m\].
    pub length: f64,
}

impl Equilibrium {
    /// Residuals of the present state. Allocates; for checks, not for the loop.
    pub fn residuals(&self) -> Residuals {
        let segments: Vec<Segment> = self.segments().collect();
        let n = self.springs.len();
        let tip = &segments[n];
        let (y, ei) = (self.tip.y, self.stiffness);
        let tip_force = y * self.load.force;
        let force = |i: usize| {
            let spring = &self.springs[i];
            spring_force(spring.stiffness, &self.nodes[i + 1].p, &spring.rest)
        };
        let mut worst = Residuals {
            tip_moment: tip_moment_residual(tip, ei, -self.load.bending, &y).norm(),
            ..Residuals::default()
        };
        let mut total = tip.arc_length(tip.length);
        for i in 0..n {
            let (before, after, node) = (&segments[i], &segments[i + 1], &self.nodes[i + 1]);
            let across = |v: Vector3<f64>| v - node.n * node.n.dot(&v);
            let arc = before.arc_length(before.length);
            total += arc;
            let jump = (before.third_derivative() - after.third_derivative()) * ei + force(i);
            let literal = normal_force(&node.n, &tip_force, (i..n).map(force));
            let stretch = node.p - self.springs[i].rest;
            let gaps = [
                (&mut worst.position, position_gap(before, after).norm()),
                (&mut worst.derivative, derivative_gap(before, after).norm()),
                (&mut worst.moment, curvature_gap(before, after).norm() * ei),
                (&mut worst.shear, across(jump).norm()),
                (
                    &mut worst.literal_shear,
                    across(shear_residual(before, ei, &literal)).norm(),
                ),
                (&mut worst.plane, node.n.dot(&stretch).abs()),
                (&mut worst.arc, (arc - before.length).abs()),
            ];
            for (most, gap) in gaps {
                *most = most.max(gap);
            }
        }
        worst.shear = worst.shear.max(shear_residual(tip, ei, &tip_force).norm());
        worst.length = (total - self.needle.length()).abs();
        worst
    }
}
