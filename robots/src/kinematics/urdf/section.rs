//! Which part of a URDF makes the chain.

use std::collections::BTreeMap;

use hal::MAX_JOINTS;
use urdf_rs::{Joint, JointType};

use super::error::UrdfError;
use crate::kinematics::chain::{Independent, JointKind};

/// Moving joints of an arm, at least.
const LEAST_OF_ARM: usize = 6;

/// Part of a URDF: from a base link to a tip link, with joints that are held still.
#[derive(Clone, Debug, PartialEq)]
pub struct Section {
    base: Option<String>,
    tip: String,
    held: BTreeMap<String, f64>,
    arm: bool,
}

impl Section {
    /// From the root to `tip`: six or seven revolute or continuous joints.
    pub fn arm(tip: &str) -> Self {
        Self {
            base: None,
            tip: tip.to_owned(),
            held: BTreeMap::new(),
            arm: true,
        }
    }

    /// From the root to `tip`: one to seven joints, also prismatic ones, as guides and stages
    /// have them.
    pub fn mechanism(tip: &str) -> Self {
        Self {
            arm: false,
            ..Self::arm(tip)
        }
    }

    /// Beginning at the link `base` instead of the root.
    #[must_use]
    pub fn from(mut self, base: &str) -> Self {
        self.base = Some(base.to_owned());
        self
    }

    /// With `joint` held still at `position` \[rad, or m of a prismatic joint\].
    #[must_use]
    pub fn holding(mut self, joint: &str, position: f64) -> Self {
        self.held.insert(joint.to_owned(), position);
        self
    }

    pub(super) fn base(&self) -> Option<&str> {
        self.base.as_deref()
    }

    pub(super) fn tip(&self) -> &str {
        &self.tip
    }

    pub(super) fn holds(&self, joint: &str) -> bool {
        self.held.contains_key(joint)
    }

    pub(super) fn held_at(&self, joint: &str) -> Option<f64> {
        self.held.get(joint).copied()
    }

    /// Whether the joints held still are in the chain and can be where they are held.
    pub(super) fn check_held(&self, joints: &[Joint]) -> Result<(), UrdfError> {
        for (name, position) in &self.held {
            let Some(joint) = joints.iter().find(|joint| joint.name == *name) else {
                let moving = joints.iter().filter(|j| j.joint_type != JointType::Fixed);
                let known: Vec<&str> = moving.map(|j| j.name.as_str()).collect();
                return Err(UrdfError::UnknownJoint {
                    joint: name.clone(),
                    known: known.join(", "),
                });
            };
            let (lower, upper) = (joint.limit.lower, joint.limit.upper);
            let bounded = matches!(joint.joint_type, JointType::Revolute | JointType::Prismatic);
            // 0 to 0 is what a missing <limit> looks like.
            let known = bounded && lower < upper;
            if !position.is_finite() || known && !(lower..=upper).contains(position) {
                return Err(UrdfError::HeldOutside {
                    joint: name.clone(),
                    position: *position,
                    lower,
                    upper,
                });
            }
        }
        Ok(())
    }

    /// The kind of a joint that moves, if the section admits it; `before` it stand so many.
    pub(super) fn admit(&self, joint: &Joint, before: usize) -> Result<JointKind, UrdfError> {
        let found = match joint.joint_type {
            JointType::Revolute => return Ok(JointKind::Revolute),
            JointType::Continuous => return Ok(JointKind::Continuous),
            JointType::Prismatic if !self.arm => return Ok(JointKind::Prismatic),
            JointType::Prismatic => "prismatic",
            JointType::Floating => "floating",
            JointType::Planar => "planar",
            JointType::Spherical => "spherical",
            JointType::Fixed => "fixed",
        };
        Err(UrdfError::JointType {
            joint: joint.name.clone(),
            found,
            admitted: if self.arm {
                "revolute, continuous and fixed"
            } else {
                "revolute, continuous, prismatic and fixed"
            },
            child: joint.child.link.clone(),
            above: (before >= LEAST_OF_ARM).then(|| joint.parent.link.clone()),
        })
    }

    /// Whether as many joints move as the section admits.
    pub(super) fn check_count(
        &self,
        base: &str,
        joints: &[Joint],
        moving: &[Independent],
    ) -> Result<(), UrdfError> {
        let (least, admitted) = if self.arm {
            (LEAST_OF_ARM, "6 or 7")
        } else {
            (1, "1 to 7")
        };
        if (least..=MAX_JOINTS).contains(&moving.len()) {
            return Ok(());
        }
        // The link below the last joint that is one too many.
        let surplus = moving.len().checked_sub(MAX_JOINTS + 1);
        let below = surplus
            .and_then(|last| moving.get(last))
            .and_then(|joint| joints.iter().find(|other| other.name == joint.name))
            .map(|joint| joint.child.link.as_str());
        let hint = match (below, moving.len()) {
            (Some(link), _) => format!(
                ": begin it lower (--base LINK, arm.base_link), at {link} or below, end it sooner \
                 (--tip LINK, arm.tip_link), or hold joints still (--hold JOINT=VALUE, \
                 arm.held_joints_deg)"
            ),
            (None, 0) => ": end it further out (--tip LINK, arm.tip_link)".to_owned(),
            (None, _) => {
                ": end it further out (--tip LINK, arm.tip_link), or take it for a device \
                          of fewer joints (--mechanism, arm.mechanism = true)"
                    .to_owned()
            }
        };
        Err(UrdfError::JointCount {
            base: base.to_owned(),
            tip: self.tip.clone(),
            found: moving.len(),
            admitted,
            hint,
        })
    }
}
