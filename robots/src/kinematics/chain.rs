//! Forward kinematics and the geometric Jacobian.

use hal::{JointLimit, Joints, MAX_JOINTS};
use nalgebra::{Isometry3, Matrix3, Rotation3, SMatrix, Translation3, UnitQuaternion, Vector3};

use super::solver::Solver;
use super::urdf;
use super::urdf_error::UrdfError;

/// Geometric Jacobian `j_tip_joints`: joint rates to the tip's twist \[linear; angular\] along
/// the axes of the chain's base, at the tip's origin. One column a joint; columns beyond the
/// arm's joints are zero.
pub type Jacobian = SMatrix<f64, 6, MAX_JOINTS>;

/// A serial chain of six or seven revolute joints from a base link to a tip link.
///
/// Fixed joints are merged into their neighbours. The frame of every joint is turned so that
/// the joint rotates about its z, which leaves 30 products a joint in forward kinematics.
#[derive(Clone, Debug)]
pub struct Chain {
    base: String,
    tip: String,
    names: Vec<String>,
    limits: Vec<JointLimit>,
    /// From the frame before (turned by its joint) to the frame of each joint.
    joints: [Rigid; MAX_JOINTS],
    /// From the last joint's frame to the tip.
    last: Rigid,
    solver: Solver,
}

/// Rotation matrix and translation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rigid {
    pub(super) rotation: Matrix3<f64>,
    pub(super) translation: Vector3<f64>,
}

impl Rigid {
    pub(super) const IDENTITY: Self = Self {
        rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        translation: Vector3::new(0.0, 0.0, 0.0),
    };

    pub(super) fn then(&self, next: &Self) -> Self {
        Self {
            rotation: self.rotation * next.rotation,
            translation: self.rotation * next.translation + self.translation,
        }
    }

    pub(super) fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }

    /// Followed by a rotation about z.
    fn turned(&self, angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        let r = &self.rotation;
        let (x, y) = (r.column(0), r.column(1));
        Self {
            rotation: Matrix3::from_columns(&[
                x * cos + y * sin,
                y * cos - x * sin,
                r.column(2).into_owned(),
            ]),
            translation: self.translation,
        }
    }

    fn to_isometry(self) -> Isometry3<f64> {
        let rotation = Rotation3::from_matrix_unchecked(self.rotation);
        Isometry3::from_parts(
            Translation3::from(self.translation),
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    }
}

/// One revolute joint as a URDF has it.
pub(super) struct Revolute {
    pub(super) name: String,
    /// From the revolute joint before, or the base, with the fixed joints between.
    pub(super) origin: Rigid,
    /// Unit vector.
    pub(super) axis: Vector3<f64>,
    pub(super) limit: JointLimit,
}

impl Chain {
    /// Reads the chain from the root of a URDF to its link `tip`.
    ///
    /// # Errors
    /// The text is no valid URDF, or the chain to `tip` is not a serial one of six or seven
    /// limited revolute joints; the error names the element.
    pub fn from_urdf(xml: &str, tip: &str) -> Result<Self, UrdfError> {
        urdf::read(xml, tip)
    }

    /// Assembles a chain; `revolute` holds at most [`MAX_JOINTS`] joints.
    pub(super) fn assemble(
        base: String,
        tip: String,
        revolute: Vec<Revolute>,
        after_last: Rigid,
    ) -> Self {
        let mut chain = Self {
            base,
            tip,
            names: Vec::with_capacity(revolute.len()),
            limits: Vec::with_capacity(revolute.len()),
            joints: [Rigid::IDENTITY; MAX_JOINTS],
            last: after_last,
            solver: Solver::Numerical,
        };
        let mut turned_back = Matrix3::identity();
        for (slot, joint) in chain.joints.iter_mut().zip(revolute) {
            let onto_axis = z_onto(&joint.axis);
            *slot = Rigid {
                rotation: turned_back * joint.origin.rotation * onto_axis,
                translation: turned_back * joint.origin.translation,
            };
            turned_back = onto_axis.transpose();
            chain.names.push(joint.name);
            chain.limits.push(joint.limit);
        }
        chain.last.rotation = turned_back * chain.last.rotation;
        chain.last.translation = turned_back * chain.last.translation;
        chain.solver = Solver::choose(&chain);
        chain
    }

    /// Name of the base link.
    pub fn base(&self) -> &str {
        &self.base
    }

    /// Name of the tip link.
    pub fn tip(&self) -> &str {
        &self.tip
    }

    /// Number of joints, six or seven.
    #[expect(clippy::len_without_is_empty, reason = "a chain is never empty")]
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Names of the joints, base to tip.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Limits of the joints, base to tip.
    ///
    /// A URDF of version 1.2 may hold accelerations and jerks. Where it does not, conservative
    /// defaults are filled in, for arms whose maker publishes none: 4 rad/s2 and 40 rad/s3, and
    /// ten times that for the last joint, which only turns what it holds.
    pub fn limits(&self) -> &[JointLimit] {
        &self.limits
    }

    /// The same chain with other limits.
    ///
    /// # Errors
    /// Hands the limits back unless there is one for every joint.
    pub fn with_limits(mut self, limits: Vec<JointLimit>) -> Result<Self, Vec<JointLimit>> {
        if limits.len() != self.limits.len() {
            return Err(limits);
        }
        self.limits = limits;
        Ok(self)
    }

    /// Whether every joint is inside its limits.
    pub fn within_limits(&self, q: &Joints) -> bool {
        q.len() == self.len()
            && q.iter()
                .zip(&self.limits)
                .all(|(q, limit)| (limit.lower..=limit.upper).contains(q))
    }

    /// `base_from_tip` for the joint positions `q` \[rad\]. Joints missing in `q` count as
    /// zero; those beyond the chain's are ignored.
    pub fn forward(&self, q: &Joints) -> Isometry3<f64> {
        let mut frame = Rigid::IDENTITY;
        for (i, joint) in self.joints[..self.names.len()].iter().enumerate() {
            frame = frame.then(joint).turned(value(q, i));
        }
        frame.then(&self.last).to_isometry()
    }

    /// `base_from_tip` and the geometric Jacobian at the tip's origin.
    pub fn forward_jacobian(&self, q: &Joints) -> (Isometry3<f64>, Jacobian) {
        let (frames, tip) = self.frames(q);
        let mut jacobian = Jacobian::zeros();
        for (i, frame) in frames[..self.names.len()].iter().enumerate() {
            let axis = frame.rotation.column(2).into_owned();
            let velocity = axis.cross(&(tip.translation - frame.translation));
            for k in 0..3 {
                jacobian[(k, i)] = velocity[k];
                jacobian[(k + 3, i)] = axis[k];
            }
        }
        (tip.to_isometry(), jacobian)
    }

    /// The geometric Jacobian at the tip's origin.
    pub fn jacobian(&self, q: &Joints) -> Jacobian {
        self.forward_jacobian(q).1
    }

    /// How inverse kinematics is solved.
    pub(super) fn solver(&self) -> &Solver {
        &self.solver
    }

    /// Frame of every joint (z is its axis) and of the tip, in the base.
    pub(super) fn frames(&self, q: &Joints) -> ([Rigid; MAX_JOINTS], Rigid) {
        let mut frames = [Rigid::IDENTITY; MAX_JOINTS];
        let mut frame = Rigid::IDENTITY;
        for (i, joint) in self.joints[..self.names.len()].iter().enumerate() {
            frame = frame.then(joint).turned(value(q, i));
            frames[i] = frame;
        }
        (frames, frame.then(&self.last))
    }
}

fn value(q: &Joints, joint: usize) -> f64 {
    q.get(joint).copied().unwrap_or(0.0)
}

/// Rotation that takes z to the unit vector `axis`; exact for the axes of the frame.
fn z_onto(axis: &Vector3<f64>) -> Matrix3<f64> {
    if *axis == Vector3::z() {
        return Matrix3::identity();
    }
    let mut helper = Vector3::zeros();
    helper[axis.iamin()] = 1.0;
    let x = helper.cross(axis).normalize();
    Matrix3::from_columns(&[x, axis.cross(&x), *axis])
}
