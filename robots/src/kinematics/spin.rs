//! How the joint nearest to the tip turns what the arm holds.

use core::f64::consts::PI;

use hal::Joints;
use nalgebra::{Isometry3, Unit, UnitQuaternion, Vector3};

use super::chain::{Chain, JointKind};

/// Cosine below which an axis is at a right angle to the tip's z.
const RIGHT_ANGLE: f64 = 0.02;
/// Sine of the angle to the needle up to which a joint slides along it.
const ALONG: f64 = 0.02;
/// Angle between joint and needle beyond which a device does not mean to spin it \[rad\].
const ASKEW: f64 = 0.35;
/// Length that says nothing about a direction \[m\].
const SHORT: f64 = 1e-6;

/// The last joint that turns as the one that spins a needle about its own axis, the tip's z. Only
/// joints that slide along that axis may lie between them, so that all numbers are the same in
/// every posture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spin {
    /// Index of the joint.
    pub joint: usize,
    /// 1 where the joint counts a turn about the tip's z as positive, else -1.
    pub sense: f64,
    /// Angle between the joint's axis and the tip's z, whichever way they point \[rad\].
    pub tilt: f64,
    /// Distance of the tip's origin from the joint's axis \[m\].
    pub aside: f64,
}

impl Spin {
    pub(super) fn of(chain: &Chain) -> Option<Self> {
        let rest = Joints::zeros(chain.len()).ok()?;
        let (pose, jacobian) = chain.forward_jacobian(&rest);
        let slides = |joint: usize| chain.kinds()[joint] == JointKind::Prismatic;
        let joint = (0..chain.len()).rev().find(|joint| !slides(*joint))?;
        let needle = pose.rotation * Vector3::z();
        let along = |joint: usize| {
            let way = jacobian.column(joint).fixed_rows::<3>(0).into_owned();
            way.cross(&needle).norm() <= ALONG * way.norm()
        };
        if !(joint + 1..chain.len()).all(along) {
            return None;
        }
        let column = jacobian.column(joint);
        let axis = column.fixed_rows::<3>(3).into_owned();
        let length = axis.norm();
        if length < f64::EPSILON {
            return None;
        }
        let across = column.fixed_rows::<3>(0).norm();
        let along = axis.dot(&needle) / length;
        let tilt = (axis.cross(&needle).norm() / length).atan2(along.abs());
        // An arm has to spin the needle, and what is wrong with its holder can be said. A device of
        // fewer joints may be made for something else.
        if chain.len() < 6 && tilt > ASKEW {
            return None;
        }
        Some(Self {
            joint,
            sense: if along < 0.0 { -1.0 } else { 1.0 },
            tilt,
            aside: across / length,
        })
    }
}

impl Chain {
    /// From the tip to the nearest pose on the axis of the joint that spins it whose z is that axis,
    /// whichever way it points: the way that is nearer, or, at a right angle, away from the joint
    /// before. Nothing if no joint spins it.
    pub fn tool_on_last_axis(&self) -> Option<Isometry3<f64>> {
        let joint = self.spin()?.joint;
        let rest = Joints::zeros(self.len()).ok()?;
        let (pose, jacobian) = self.forward_jacobian(&rest);
        let column = jacobian.column(joint);
        let axis = Unit::try_new(column.fixed_rows::<3>(3).into_owned(), f64::EPSILON)?;
        // The axis passes the tip at this distance: v = axis x (tip - point).
        let to_axis = axis.cross(&column.fixed_rows::<3>(0).into_owned());
        let back = pose.rotation.inverse();
        let mut direction = back * axis;
        let nearer = direction.z;
        let outwards = if nearer.abs() > RIGHT_ANGLE {
            nearer
        } else {
            self.outwards(joint, &rest, &pose, &axis)
        };
        if outwards < 0.0 {
            direction = -direction;
        }
        let turn = UnitQuaternion::rotation_between(&Vector3::z(), &direction)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
        Some(Isometry3::from_parts((back * to_axis).into(), turn))
    }

    /// How far the tip lies along the axis of `joint` from the joint before; 1 where that says
    /// nothing.
    fn outwards(
        &self,
        joint: usize,
        rest: &Joints,
        pose: &Isometry3<f64>,
        axis: &Vector3<f64>,
    ) -> f64 {
        let before = self.joint_origin(rest, joint.saturating_sub(1));
        let way = (pose.translation.vector - before).dot(axis);
        if way.abs() > SHORT { way } else { 1.0 }
    }
}
