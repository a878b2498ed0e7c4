//! Analytic inverse kinematics of arms with three parallel axes in the middle and a wrist whose
//! last two axes meet at a right angle, as the Universal Robots have.
//!
//! Axes 2, 3 and 4 are parallel; axis 5 is perpendicular to axis 4 and meets axis 6 at a right
//! angle, in the wrist's centre. Axis 1 may lie in any way that is not parallel to axis 2. Such an
//! arm has up to eight postures: the wrist's centre keeps its distance from the plane of axes 2
//! to 4, which gives joint 1 (two sides); the direction of axis 6 then gives joints 5 and 6 (two
//! wrists); what is left is a planar arm of two links (two elbows). The solution works on the
//! axes as lines in space, in whatever way the URDF lays out the frames.

use core::f64::consts::PI;

use hal::Joints;
use nalgebra::{Isometry3, Matrix3, Vector3};

use super::chain::Chain;
use super::line::{Line, rotation};
use super::rigid::Rigid;
use super::solver::Fit;

/// A link shorter than this is none \[m\].
const SHORT: f64 = 1e-6;
/// Sine of the angle between axes 1 and 2 below which joint 1 cannot place the wrist.
const SLANT: f64 = 0.1;
/// Sine of the angle between axes 4 and 6 below which joints 4 and 6 are not told apart.
const WRIST: f64 = 1e-13;
/// Change of the pose by which the rounding of a target may be made up for \[rad\].
const UNSEEN: f64 = 1e-12;
/// Distance of the wrist from axis 1, over the arm's length, below which joint 1 is free.
const ON_AXIS: f64 = 1e-13;

/// Solver derived from a chain.
#[derive(Clone, Debug)]
pub(super) struct Parallel {
    /// A point of axis 1, and its direction.
    shoulder: Line,
    /// Common direction of axes 2, 3 and 4.
    normal: Vector3<f64>,
    /// Points of axes 2, 3 and 4, and the wrist's centre, with the joints at zero.
    axis_2: Vector3<f64>,
    axis_4: Vector3<f64>,
    wrist: Vector3<f64>,
    /// Upper arm and forearm across the parallel axes.
    upper: Vector3<f64>,
    fore: Vector3<f64>,
    /// Directions of axes 5 and 6.
    axis_5: Vector3<f64>,
    axis_6: Vector3<f64>,
    /// Sense of joints 3 and 4 about `normal`.
    signs: [f64; 2],
    /// Angle from axis 6 to `normal` about axis 5.
    bend: f64,
    /// Inverse of the tip's pose with the joints at zero.
    zero_from_tip: Rigid,
    /// How far out of reach a target may lie and be taken for the boundary \[1\].
    stretch: f64,
}

/// Joints 5 and 6; sine of the angle between axes 4 and 6, and whether they point the same way.
struct Wrist {
    q5: f64,
    q6: f64,
    slant: f64,
    sense: f64,
}

/// `a cos(x) + b sin(x) = d`: the middle of the two solutions and half their distance.
fn circle(a: f64, b: f64, d: f64, stretch: f64) -> Option<(f64, f64)> {
    let size = a.hypot(b);
    if d.abs() > size * (1.0 + stretch) {
        return None;
    }
    let across = ((size - d) * (size + d)).max(0.0).sqrt();
    Some((b.atan2(a), across.atan2(d)))
}

impl Parallel {
    /// Derives the solver from the chain at joint zero; `None` if its geometry is another.
    pub(super) fn detect(chain: &Chain, fit: &Fit) -> Option<Self> {
        if chain.len() != 6 {
            return None;
        }
        let tolerance = fit.geometry;
        let (frames, tip) = chain.frames(&Joints::from([0.0; 6]));
        let lines: [Line; 6] = core::array::from_fn(|i| Line::of(&frames[i]));
        let fits = lines[1].is_parallel(&lines[2], tolerance)
            && lines[1].is_parallel(&lines[3], tolerance)
            && !lines[0].is_parallel(&lines[1], SLANT)
            && lines[4].is_perpendicular(&lines[3], tolerance)
            && lines[5].is_perpendicular(&lines[4], tolerance);
        if !fits {
            return None;
        }
        // The exact geometry next to this one.
        let wrist = lines[4].meets(&lines[5], tolerance)?;
        let axis_5 = lines[4].direction;
        let across = |v: &Vector3<f64>, n: &Vector3<f64>| v - n * n.dot(v);
        let normal = across(&lines[1].direction, &axis_5).normalize();
        let axis_6 = across(&lines[5].direction, &axis_5).normalize();
        let axis_4 = lines[3].foot(&wrist);
        let axis_3 = lines[2].foot(&axis_4);
        let axis_2 = lines[1].foot(&axis_3);
        let (upper, fore) = (
            across(&(axis_3 - axis_2), &normal),
            across(&(axis_4 - axis_3), &normal),
        );
        if upper.norm() < SHORT || fore.norm() < SHORT {
            return None;
        }
        Some(Self {
            shoulder: Line {
                point: lines[0].point,
                direction: lines[0].direction,
            },
            normal,
            axis_2,
            axis_4,
            wrist,
            upper,
            fore,
            axis_5,
            axis_6,
            signs: [2, 3].map(|i: usize| lines[i].direction.dot(&normal).signum()),
            bend: normal
                .dot(&axis_5.cross(&axis_6))
                .atan2(normal.dot(&axis_6)),
            zero_from_tip: tip.inverse(),
            stretch: fit.stretch,
        })
    }

    /// Calls `found` with the joint positions of every branch, wherever in the circle.
    ///
    /// In the wrist's singularity, where axes 4 and 6 are parallel and the arm may turn about the
    /// wrist's centre, joint 6 is at zero, at half a turn, or as near to that as the elbow
    /// reaches; with the wrist on axis 1, joint 1 is at zero and at half a turn.
    pub(super) fn solve(&self, base_from_tip: &Isometry3<f64>, mut found: impl FnMut(Joints)) {
        let tip = Rigid {
            rotation: base_from_tip.rotation.to_rotation_matrix().into_inner(),
            translation: base_from_tip.translation.vector,
        };
        // What the six joints together have to do to the arm at zero.
        let moved = tip.then(&self.zero_from_tip);
        let wrist = moved.rotation * self.wrist + moved.translation - self.shoulder.point;
        for q1 in self.sides(&wrist) {
            let back = rotation(&self.shoulder.direction, -q1);
            let turned = back * moved.rotation;
            let centre = self.shoulder.point + back * wrist;
            for wrist in self.wrists(&turned) {
                let mut middle =
                    turned * rotation(&self.axis_6, -wrist.q6) * rotation(&self.axis_5, -wrist.q5);
                let mut q6 = wrist.q6;
                let turn = self.turn_into_reach(&middle, &centre);
                if turn.abs() * wrist.slant < UNSEEN {
                    middle = rotation(&self.normal, turn) * middle;
                    q6 -= wrist.sense * turn;
                }
                for [q2, q3, q4] in self.elbows(&middle, &centre) {
                    found(Joints::from([q1, q2, q3, q4, wrist.q5, q6]));
                }
            }
        }
    }

    /// Joint 1 for the wrist's centre, from the shoulder's point.
    fn sides(&self, wrist: &Vector3<f64>) -> impl Iterator<Item = f64> + use<> {
        let (h, n) = (&self.shoulder.direction, &self.normal);
        let lean = n.dot(h);
        let a = n.dot(wrist) - lean * h.dot(wrist);
        let b = -n.dot(&h.cross(wrist));
        let d = n.dot(&(self.wrist - self.shoulder.point)) - lean * h.dot(wrist);
        let length = self.upper.norm() + self.fore.norm();
        let sides = if a.hypot(b) < ON_AXIS * length {
            // Any angle does, or none.
            (d.abs() <= self.stretch * length).then_some([0.0, PI])
        } else {
            circle(a, b, d, self.stretch).map(|(middle, half)| [middle + half, middle - half])
        };
        sides.into_iter().flatten()
    }

    /// Joints 5 and 6 for the rotation that joints 2 to 6 make together. Joint 5 is taken from
    /// what joint 6 leaves, so that the error of joint 6 near the wrist's singularity, where it
    /// is ill determined, does not show in the pose.
    fn wrists(&self, turned: &Matrix3<f64>) -> [Wrist; 2] {
        let normal = turned.transpose() * self.normal;
        let aside = self.axis_5.cross(&self.axis_6);
        let (along, x, y) = (
            normal.dot(&self.axis_6),
            normal.dot(&aside),
            normal.dot(&self.axis_5),
        );
        let slant = x.hypot(y);
        let turn = if slant < WRIST { 0.0 } else { -y.atan2(x) };
        [turn, turn + PI].map(|q6| {
            let (sin, cos) = q6.sin_cos();
            let bend = (x * cos - y * sin).atan2(along);
            Wrist {
                q5: self.bend - bend,
                q6,
                slant,
                sense: along.signum(),
            }
        })
    }

    /// The least turn of the last link about the parallel axes that brings it into the reach of
    /// the two others; 0 where it is.
    fn turn_into_reach(&self, middle: &Matrix3<f64>, centre: &Vector3<f64>) -> f64 {
        let n = &self.normal;
        let across = |v: Vector3<f64>| v - n * n.dot(&v);
        let to_wrist = across(centre - self.axis_2);
        let last = across(middle * (self.wrist - self.axis_4));
        let (upper, fore) = (self.upper.norm(), self.fore.norm());
        let reach = (to_wrist - last).norm();
        let reachable = reach.clamp((upper - fore).abs(), upper + fore);
        if (reachable - reach).abs() <= self.stretch * reach {
            return 0.0;
        }
        circle(
            to_wrist.dot(&last),
            to_wrist.dot(&n.cross(&last)),
            0.5 * (to_wrist.norm_squared() + last.norm_squared() - reachable * reachable),
            0.0,
        )
        .map_or(0.0, |(middle, half)| {
            if middle > 0.0 {
                middle - half
            } else {
                middle + half
            }
        })
    }

    /// Joints 2, 3 and 4 for the rotation they make together and the wrist's centre.
    fn elbows(
        &self,
        middle: &Matrix3<f64>,
        centre: &Vector3<f64>,
    ) -> impl Iterator<Item = [f64; 3]> + use<> {
        let n = self.normal;
        let link = self.upper;
        let sum = angle(&n, &link, &(middle * link));
        let reach = centre - middle * (self.wrist - self.axis_4) - self.axis_2;
        let reach = reach - n * n.dot(&reach);
        let (upper, fore) = (link, self.fore);
        let both = 0.5 * (reach.norm_squared() - upper.norm_squared() - fore.norm_squared());
        let elbows = circle(
            upper.dot(&fore),
            n.dot(&fore.cross(&upper)),
            both,
            self.stretch,
        );
        let [sign_3, sign_4] = self.signs;
        elbows
            .map(|(middle, half)| [middle + half, middle - half])
            .into_iter()
            .flatten()
            .map(move |turn_3| {
                let arm = upper + rotation(&n, turn_3) * fore;
                let turn_2 = angle(&n, &arm, &reach);
                [turn_2, sign_3 * turn_3, sign_4 * (sum - turn_2 - turn_3)]
            })
    }
}

/// Angle about `axis` from `a` to `b`.
fn angle(axis: &Vector3<f64>, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    axis.dot(&a.cross(b)).atan2(a.dot(b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::numeric;

    const UR5E: &str = include_str!("../../urdf/ur5e.urdf");

    /// The two solvers share nothing but the forward kinematics.
    #[test]
    fn the_numerical_solver_finds_no_solution_that_the_analytic_one_lacks() {
        let chain = Chain::from_urdf(UR5E, "tool0").unwrap();
        let solver = Parallel::detect(&chain, &Fit::EXACT).unwrap();
        let mut compared = 0;
        for k in 0_u32..40 {
            let k = f64::from(k);
            let q = [0.3, 0.7, 1.1, 1.3, 1.7, 1.9].map(|step| (1.0 + k * step) % 6.0 - 3.0);
            let pose = chain.forward(&Joints::from(q));
            let mut analytic = Vec::new();
            solver.solve(&pose, |q| analytic.push(q));
            let mut numerical = Vec::new();
            numeric::solve(&chain, &pose, &[], &mut |q| numerical.push(q));
            for q in &numerical {
                compared += 1;
                let met = analytic.iter().any(|x| chain.is_same(x, q, 1e-6));
                assert!(met, "{q:?} is missing in {analytic:?}");
            }
        }
        assert!(compared > 150, "{compared}");
    }
}
