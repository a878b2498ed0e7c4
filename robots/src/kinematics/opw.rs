//! Analytic inverse kinematics of arms with an orthogonal base and a spherical wrist.
//!
//! The geometry and its parameters are those of Brandstoetter, Angerer and Hofbaur, "An
//! analytical solution of the inverse kinematics problem of industrial serial manipulators with
//! an ortho-parallel basis and a spherical wrist" (2014). They are derived from the chain, in
//! whatever way its URDF lays out the frames.

use core::f64::consts::PI;

use hal::Joints;
use nalgebra::{Isometry3, Matrix3, Vector3};

use super::chain::Chain;
use super::line::Line;
use super::solver::Fit;

/// A link shorter than this is none \[m\].
const SHORT: f64 = 1e-6;
/// Sine of the fifth angle below which the wrist's other two are not told apart.
const WRIST: f64 = 1e-13;

/// Joint angles of the geometric model before signs and offsets.
type Angles = [f64; 6];

/// Geometric parameters of an arm with an ortho-parallel base and a spherical wrist, and how
/// its joints and frames relate to those of the geometric model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpwParameters {
    /// From axis 1 to axis 2 \[m\].
    pub a1: f64,
    /// From axis 3 to axis 4 \[m\].
    pub a2: f64,
    /// Sideways offset of the wrist from axis 1 \[m\].
    pub b: f64,
    /// From the base to axis 2 along axis 1 \[m\].
    pub c1: f64,
    /// From axis 2 to axis 3 \[m\].
    pub c2: f64,
    /// From axis 3 to the wrist along axis 4 \[m\].
    pub c3: f64,
    /// From the wrist to the tip along axis 6 \[m\].
    pub c4: f64,
    /// Angle of the model for a joint at zero \[rad\].
    pub offsets: [f64; 6],
    /// Sense of each joint, 1 or -1: model angle = sign * joint + offset.
    pub signs: [f64; 6],
}

/// Solver derived from a chain.
#[derive(Clone, Debug)]
pub(super) struct Opw {
    parameters: OpwParameters,
    /// From the model's base (z along axis 1, y along axis 2 at joint zero) to the chain's base.
    model_rotation: Matrix3<f64>,
    model_origin: Vector3<f64>,
    /// Rotation of the tip in the model's last frame.
    tip_rotation: Matrix3<f64>,
    /// The wrist's centre in the tip's frame.
    wrist_in_tip: Vector3<f64>,
    /// How far out of reach a target may lie and be taken for the boundary \[1\].
    stretch: f64,
}

impl Opw {
    /// Derives the parameters from the chain at joint zero; `None` if its geometry is another.
    pub(super) fn detect(chain: &Chain, fit: &Fit) -> Option<Self> {
        let tolerance = fit.geometry;
        if chain.len() != 6 {
            return None;
        }
        let zero = Joints::from([0.0; 6]);
        let (frames, tip) = chain.frames(&zero);
        let lines: [Line; 6] = core::array::from_fn(|i| Line::of(&frames[i]));
        let wrist = lines[3].meets(&lines[4], tolerance)?;
        let ortho_parallel = lines[0].is_perpendicular(&lines[1], tolerance)
            && lines[1].is_parallel(&lines[2], tolerance)
            && lines[2].is_perpendicular(&lines[3], tolerance);
        if !ortho_parallel || (lines[4].meets(&lines[5], tolerance)? - wrist).norm() > tolerance {
            return None;
        }

        let z = lines[0].direction;
        let y = (lines[1].direction - z * z.dot(&lines[1].direction)).normalize();
        let x = y.cross(&z);
        let model_rotation = Matrix3::from_columns(&[x, y, z]);
        // The foot of the chain's base on axis 1.
        let model_origin = lines[0].point - z * lines[0].point.dot(&z);
        let place = |p: &Vector3<f64>| model_rotation.transpose() * (p - model_origin);
        let (axis_2, axis_3) = (place(&lines[1].point), place(&lines[2].point));
        let centre = place(&wrist);
        let upper = axis_3 - axis_2;
        let offset_2 = upper.x.atan2(upper.z);
        let forearm = centre - axis_3;
        let mut along = model_rotation.transpose() * lines[3].direction;
        let mut sign_4 = 1.0;
        if along.dot(&forearm) < 0.0 {
            (along, sign_4) = (-along, -1.0);
        }
        let offset_23 = along.x.atan2(along.z);
        let forearm_x = Vector3::new(offset_23.cos(), 0.0, -offset_23.sin());

        // Frame before the wrist, and what joints 4 and 5 have to be for the axes as they are.
        let wrist_frame = model_rotation * rotation_y(offset_23);
        let axis_5 = wrist_frame.transpose() * lines[4].direction;
        let offset_4 = (-axis_5.x).atan2(axis_5.y);
        let turned = wrist_frame * rotation_z(offset_4);
        let axis_6 = turned.transpose() * lines[5].direction;
        let offset_5 = axis_6.x.atan2(axis_6.z);
        let last = turned * rotation_y(offset_5);

        let c2 = upper.x.hypot(upper.z);
        let (a2, c3) = (forearm.dot(&forearm_x), forearm.dot(&along));
        if c2 < SHORT || a2.hypot(c3) < SHORT {
            return None;
        }
        Some(Self {
            parameters: OpwParameters {
                a1: axis_2.x,
                a2,
                b: centre.y,
                c1: axis_2.z,
                c2,
                c3,
                c4: (tip.translation - wrist).dot(&lines[5].direction),
                offsets: [0.0, offset_2, offset_23 - offset_2, offset_4, offset_5, 0.0],
                signs: [
                    1.0,
                    1.0,
                    lines[1].direction.dot(&lines[2].direction).signum(),
                    sign_4,
                    1.0,
                    1.0,
                ],
            },
            model_rotation,
            model_origin,
            tip_rotation: last.transpose() * tip.rotation,
            wrist_in_tip: tip.rotation.transpose() * (wrist - tip.translation),
            stretch: fit.stretch,
        })
    }

    pub(super) fn parameters(&self) -> &OpwParameters {
        &self.parameters
    }

    /// Calls `found` with the joint positions of every branch, wherever in the circle.
    ///
    /// In the wrist's singularity, where joints 4 and 6 only count together, joint 4 is at zero;
    /// with the wrist on axis 1, joint 1 is at zero.
    pub(super) fn solve(&self, base_from_tip: &Isometry3<f64>, mut found: impl FnMut(Joints)) {
        let p = &self.parameters;
        let rotation = base_from_tip.rotation.to_rotation_matrix();
        let wrist = base_from_tip.translation.vector + rotation.matrix() * self.wrist_in_tip;
        let c = self.model_rotation.transpose() * (wrist - self.model_origin);
        let last =
            self.model_rotation.transpose() * rotation.matrix() * self.tip_rotation.transpose();

        let radial = c.x * c.x + c.y * c.y - p.b * p.b;
        if radial < -self.stretch * (c.x * c.x + c.y * c.y + p.b * p.b) {
            return;
        }
        let radial = radial.max(0.0).sqrt();
        let heading = if c.x == 0.0 && c.y == 0.0 {
            0.0
        } else {
            c.y.atan2(c.x)
        };
        let (k, psi) = (p.a2.hypot(p.c3), p.a2.atan2(p.c3));
        for side in [radial, -radial] {
            let q1 = heading - p.b.atan2(side);
            let (x, z) = (side - p.a1, c.z - p.c1);
            let cos = (x * x + z * z - p.c2 * p.c2 - k * k) / (2.0 * p.c2 * k);
            if cos.abs() > 1.0 + self.stretch {
                continue;
            }
            let sin = ((1.0 - cos) * (1.0 + cos)).max(0.0).sqrt();
            for sin in [sin, -sin] {
                let elbow = sin.atan2(cos);
                let q2 = x.atan2(z) - (k * sin).atan2(p.c2 + k * cos);
                let arm = [q1, q2, elbow - psi];
                self.wrist(arm, &last, &mut found);
            }
        }
    }

    /// Both postures of the wrist. The fifth and sixth angles are taken from what the fourth
    /// leaves, so that its error near the wrist's singularity, where it is ill determined, does
    /// not show in the pose.
    fn wrist(&self, arm: [f64; 3], last: &Matrix3<f64>, found: &mut impl FnMut(Joints)) {
        let p = &self.parameters;
        let before = rotation_z(arm[0]) * rotation_y(arm[1] + arm[2]);
        let r = before.transpose() * last;
        let (bend_x, bend_y) = (r[(0, 2)], r[(1, 2)]);
        let q4 = if bend_x.hypot(bend_y) < WRIST {
            p.offsets[3]
        } else {
            bend_y.atan2(bend_x)
        };
        for q4 in [q4, q4 + PI] {
            let (sin, cos) = q4.sin_cos();
            let x = r.row(0) * cos + r.row(1) * sin;
            let y = r.row(1) * cos - r.row(0) * sin;
            let q5 = x[2].atan2(r[(2, 2)]);
            let q6 = y[0].atan2(y[1]);
            found(self.joints(&[arm[0], arm[1], arm[2], q4, q5, q6]));
        }
    }

    fn joints(&self, angles: &Angles) -> Joints {
        let p = &self.parameters;
        let mut q = [0.0; 6];
        for i in 0..6 {
            q[i] = p.signs[i] * (angles[i] - p.offsets[i]);
        }
        Joints::from(q)
    }
}

fn rotation_y(angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
}

fn rotation_z(angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
}
