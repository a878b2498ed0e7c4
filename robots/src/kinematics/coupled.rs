//! Chains whose joints slide, or move several axes at once.

use hal::{Joints, MAX_JOINTS};
use nalgebra::Vector3;

use super::chain::Jacobian;
use super::rigid::Rigid;

/// One axis of a chain: z of its frame.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    /// From the frame of the axis before, moved by its joint.
    pub(super) before: Rigid,
    /// Whether it translates along z instead of turning about it.
    pub(super) slides: bool,
    /// The independent joint that moves it.
    pub(super) joint: usize,
    /// Position of the axis = ratio * joint + offset.
    pub(super) ratio: f64,
    /// See [`Axis::ratio`] \[rad or m\].
    pub(super) offset: f64,
}

impl Axis {
    fn moved(&self, frame: &Rigid, q: &Joints) -> Rigid {
        let joint = q.get(self.joint).copied().unwrap_or(0.0);
        let position = self.ratio * joint + self.offset;
        if self.slides {
            frame.slid(position)
        } else {
            frame.turned(position)
        }
    }
}

/// Pose of the frame after the last axis.
pub(super) fn forward(axes: &[Axis], q: &Joints) -> Rigid {
    axes.iter().fold(Rigid::IDENTITY, |frame, axis| {
        axis.moved(&frame.then(&axis.before), q)
    })
}

/// Origin of the first axis that `joint` moves.
pub(super) fn origin(axes: &[Axis], q: &Joints, joint: usize) -> Vector3<f64> {
    let mut frame = Rigid::IDENTITY;
    for axis in axes {
        frame = frame.then(&axis.before);
        if axis.joint == joint {
            break;
        }
        frame = axis.moved(&frame, q);
    }
    frame.translation
}

/// The Jacobian at `tip`, one column an independent joint: the sum over the axes that it moves.
pub(super) fn jacobian(axes: &[Axis], tip: &Vector3<f64>, q: &Joints) -> Jacobian {
    let mut jacobian = Jacobian::zeros();
    let mut frame = Rigid::IDENTITY;
    for axis in axes {
        frame = axis.moved(&frame.then(&axis.before), q);
        let z = frame.rotation.column(2).into_owned();
        let (linear, angular) = if axis.slides {
            (z, Vector3::zeros())
        } else {
            (z.cross(&(tip - frame.translation)), z)
        };
        let joint = axis.joint.min(MAX_JOINTS - 1);
        for k in 0..3 {
            jacobian[(k, joint)] += linear[k] * axis.ratio;
            jacobian[(k + 3, joint)] += angular[k] * axis.ratio;
        }
    }
    jacobian
}
