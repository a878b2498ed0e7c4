//! Forward kinematics and the geometric Jacobian.

use hal::{JointLimit, Joints, MAX_JOINTS};
use nalgebra::{Isometry3, Matrix3, SMatrix, Vector3};

use super::coupled::{self, Axis};
use super::rigid::{Rigid, z_onto};
use super::solver::Solver;
use super::spin::Spin;
use super::urdf::error::UrdfError;
use super::urdf::{self, Section};

/// Geometric Jacobian `j_tip_joints`: joint rates to the tip's twist \[linear; angular\] along
/// the axes of the chain's base, at the tip's origin. One column a joint; columns beyond the
/// arm's joints are zero.
pub type Jacobian = SMatrix<f64, 6, MAX_JOINTS>;

/// A serial chain of joints from a base link to a tip link: an arm of six or seven revolute
/// joints, or what else a [`Section`] admits.
///
/// Fixed joints are merged into their neighbours. The frame of every joint is turned so that
/// the joint rotates about its z, which leaves 30 products a joint in forward kinematics.
#[derive(Clone, Debug)]
pub struct Chain {
    base: String,
    tip: String,
    names: Vec<String>,
    kinds: Vec<JointKind>,
    limits: Vec<JointLimit>,
    /// From the frame before (turned by its joint) to the frame of each joint.
    joints: [Rigid; MAX_JOINTS],
    /// All axes, where they are not the joints one by one, each turning.
    axes: Option<Box<[Axis]>>,
    /// From the last joint's frame to the tip.
    last: Rigid,
    solver: Solver,
    spin: Option<Spin>,
}

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// Turns between two ends.
    Revolute,
    /// Turns without ends. Its limits are [`ENDLESS`] to either side.
    Continuous,
    /// Slides: its position and limits are metres, not radians.
    Prismatic,
}

/// Way of a sliding joint that counts as much as one radian of a turning one \[m\]: what such
/// different positions are compared by, the length of [`super::RateSettings`].
pub const SLIDE_OF_A_RADIAN: f64 = 0.1;

impl JointKind {
    /// What a radian is to this joint: 1 rad, or [`SLIDE_OF_A_RADIAN`] where it slides.
    pub const fn unit(self) -> f64 {
        match self {
            Self::Revolute | Self::Continuous => 1.0,
            Self::Prismatic => SLIDE_OF_A_RADIAN,
        }
    }

    /// A position in words: degrees, or millimetres where the joint slides.
    pub fn in_words(self, position: f64) -> String {
        match self {
            Self::Revolute | Self::Continuous => format!("{:.1} deg", position.to_degrees()),
            Self::Prismatic => format!("{:.1} mm", position * 1e3),
        }
    }
}

/// What stands for the ends of a continuous joint \[rad\]: a thousand turns, which no insertion
/// comes near.
pub const ENDLESS: f64 = 1000.0 * core::f64::consts::TAU;

/// An independent joint as a URDF has it.
pub(super) struct Independent {
    pub(super) name: String,
    pub(super) kind: JointKind,
    pub(super) limit: JointLimit,
}

/// An axis as a URDF has it.
pub(super) struct Placed {
    /// From the axis before, or the base, with the fixed joints between.
    pub(super) origin: Rigid,
    /// Unit vector.
    pub(super) axis: Vector3<f64>,
    pub(super) slides: bool,
    /// Index of the independent joint that moves it, and position = ratio * joint + offset.
    pub(super) joint: usize,
    pub(super) ratio: f64,
    pub(super) offset: f64,
}

impl Chain {
    /// Reads the arm from the root of a URDF to its link `tip`.
    ///
    /// # Errors
    /// The text is no valid URDF, or the chain to `tip` is not a serial one of six or seven
    /// revolute joints; the error names the element.
    pub fn from_urdf(xml: &str, tip: &str) -> Result<Self, UrdfError> {
        urdf::read(xml, &Section::arm(tip))
    }

    /// Reads a section of a URDF, as its file holds it: UTF-8 or UTF-16. Names in other encodings
    /// come out garbled, numbers do not.
    ///
    /// # Errors
    /// The text is no valid URDF, or the section holds joints that it does not admit; the error
    /// names the element.
    pub fn from_section(file: &[u8], section: &Section) -> Result<Self, UrdfError> {
        urdf::read(&urdf::decode(file), section)
    }

    /// Assembles a chain of at most [`MAX_JOINTS`] independent joints.
    pub(super) fn assemble(
        base: String,
        tip: String,
        independent: Vec<Independent>,
        placed: Vec<Placed>,
        after_last: Rigid,
    ) -> Self {
        let mut turned_back = Matrix3::identity();
        let mut axes = Vec::with_capacity(placed.len());
        for axis in placed {
            let onto_axis = z_onto(&axis.axis);
            axes.push(Axis {
                before: Rigid {
                    rotation: turned_back * axis.origin.rotation * onto_axis,
                    translation: turned_back * axis.origin.translation,
                },
                slides: axis.slides,
                joint: axis.joint,
                ratio: axis.ratio,
                offset: axis.offset,
            });
            turned_back = onto_axis.transpose();
        }
        let plain = axes.len() == independent.len()
            && axes.iter().enumerate().all(|(i, axis)| {
                let turns_alone = axis.joint == i && !axis.slides;
                turns_alone && (axis.ratio, axis.offset) == (1.0, 0.0)
            });
        let mut joints = [Rigid::IDENTITY; MAX_JOINTS];
        for (slot, axis) in joints.iter_mut().zip(&axes) {
            *slot = axis.before;
        }
        let mut chain = Self {
            base,
            tip,
            names: Vec::with_capacity(independent.len()),
            kinds: Vec::with_capacity(independent.len()),
            limits: Vec::with_capacity(independent.len()),
            joints,
            axes: (!plain).then(|| axes.into_boxed_slice()),
            last: Rigid {
                rotation: turned_back * after_last.rotation,
                translation: turned_back * after_last.translation,
            },
            solver: Solver::Numerical,
            spin: None,
        };
        for joint in independent {
            chain.names.push(joint.name);
            chain.kinds.push(joint.kind);
            chain.limits.push(joint.limit);
        }
        chain.settle();
        chain
    }

    /// Derives what follows from the geometry.
    fn settle(&mut self) {
        self.solver = if self.axes.is_some() {
            Solver::Numerical
        } else {
            Solver::choose(self)
        };
        self.spin = Spin::of(self);
    }

    /// The same chain with its tip at the pose `tip_from_tool` of the present one.
    #[must_use]
    pub fn with_tool(mut self, tip_from_tool: &Isometry3<f64>) -> Self {
        self.last = self.last.then(&Rigid::of(tip_from_tool));
        self.settle();
        self
    }

    /// Name of the base link.
    pub fn base(&self) -> &str {
        &self.base
    }

    /// Name of the tip link.
    pub fn tip(&self) -> &str {
        &self.tip
    }

    /// Number of independent joints, at most [`MAX_JOINTS`].
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
    /// ten times that for a last joint that turns, which turns only what it holds; a tenth in metres
    /// for joints that slide. A joint whose speed the URDF does not give has the speed 0: see
    /// [`Chain::without_speed`].
    pub fn limits(&self) -> &[JointLimit] {
        &self.limits
    }

    /// The kinds of the joints, base to tip.
    pub fn kinds(&self) -> &[JointKind] {
        &self.kinds
    }

    /// Names of the joints for which no speed is known. They can be positioned, not driven.
    pub fn without_speed(&self) -> impl Iterator<Item = &str> {
        let joints = self.names.iter().zip(&self.limits);
        joints
            .filter(|(_, limit)| limit.velocity == 0.0)
            .map(|(name, _)| name.as_str())
    }

    /// The same chain with `speed` \[rad/s or m/s\] for every joint whose own is not known.
    #[must_use]
    pub fn with_speed(mut self, speed: f64) -> Self {
        for limit in self.limits.iter_mut().filter(|limit| limit.velocity == 0.0) {
            limit.velocity = speed;
        }
        self
    }

    /// How a joint turns the tip about the tip's own z; nothing if all joints slide, or if others
    /// than those along that z are nearer to the tip.
    pub fn spin(&self) -> Option<&Spin> {
        self.spin.as_ref()
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
        if let Some(axes) = &self.axes {
            return coupled::forward(axes, q).then(&self.last).to_isometry();
        }
        let mut frame = Rigid::IDENTITY;
        for (i, joint) in self.joints[..self.names.len()].iter().enumerate() {
            frame = frame.then(joint).turned(value(q, i));
        }
        frame.then(&self.last).to_isometry()
    }

    /// `base_from_tip` and the geometric Jacobian at the tip's origin.
    pub fn forward_jacobian(&self, q: &Joints) -> (Isometry3<f64>, Jacobian) {
        if let Some(axes) = &self.axes {
            let tip = coupled::forward(axes, q).then(&self.last);
            let jacobian = coupled::jacobian(axes, &tip.translation, q);
            return (tip.to_isometry(), jacobian);
        }
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

    /// Origin of a joint's frame in the base \[m\].
    pub(super) fn joint_origin(&self, q: &Joints, joint: usize) -> Vector3<f64> {
        match &self.axes {
            Some(axes) => coupled::origin(axes, q, joint),
            None => self.frames(q).0[joint].translation,
        }
    }

    /// How inverse kinematics is solved.
    pub(super) fn solver(&self) -> &Solver {
        &self.solver
    }

    /// Frame of every joint (z is its axis) and of the tip, in the base; for chains whose joints
    /// are single turning axes.
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
