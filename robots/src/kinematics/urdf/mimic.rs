//! Joints that follow others, as in hollow wrists and parallelograms.

use std::collections::HashMap;

use hal::JointLimit;
use urdf_rs::{Joint, JointType};

use super::Section;
use super::error::UrdfError;
use crate::kinematics::chain::Independent;

/// A joint that follows another one: position = ratio * leader + offset.
#[derive(Clone, Copy, Debug)]
pub(super) struct Follower<'a> {
    pub(super) leader: &'a str,
    pub(super) ratio: f64,
    pub(super) offset: f64,
}

/// The joints that follow others, each with the one at the end of its line, which follows none.
pub(super) fn followers<'a>(
    joints: &'a [Joint],
    section: &Section,
) -> Result<HashMap<&'a str, Follower<'a>>, UrdfError> {
    let find = |name: &str| joints.iter().find(|joint| joint.name == name);
    let mimics = |joint: &'a Joint| {
        let free = joint.joint_type != JointType::Fixed && !section.holds(&joint.name);
        joint.mimic.as_ref().filter(|_| free)
    };
    let mut followers = HashMap::new();
    for joint in joints {
        let (mut ratio, mut offset, mut leader) = (1.0, 0.0, joint);
        let mut steps = 0;
        while let Some(mimic) = mimics(leader) {
            let next = find(&mimic.joint).filter(|next| next.joint_type != JointType::Fixed);
            steps += 1;
            leader = next
                .filter(|_| steps <= joints.len())
                .ok_or_else(|| UrdfError::Mimic {
                    joint: joint.name.clone(),
                    mimicked: mimic.joint.clone(),
                })?;
            offset += ratio * mimic.offset.unwrap_or(0.0);
            ratio *= mimic.multiplier.unwrap_or(1.0);
        }
        if ![ratio, offset].iter().all(|x: &f64| x.is_finite()) {
            return Err(UrdfError::NonFinite {
                joint: joint.name.clone(),
                element: "mimic",
            });
        }
        if steps > 0 {
            let follower = Follower {
                leader: leader.name.as_str(),
                ratio,
                offset,
            };
            followers.insert(joint.name.as_str(), follower);
        }
    }
    Ok(followers)
}

impl Follower<'_> {
    /// The leader may only go where its follower can.
    pub(super) fn narrow(
        &self,
        joint: &Joint,
        own: Option<&JointLimit>,
        independent: &mut [Independent],
    ) -> Result<(), UrdfError> {
        let leader = independent
            .iter_mut()
            .find(|other| other.name == self.leader);
        let (Some(own), Some(leader)) = (own, leader) else {
            return Ok(());
        };
        if self.ratio == 0.0 {
            return Ok(());
        }
        let limit = &mut leader.limit;
        if joint.joint_type != JointType::Continuous {
            let ends = [own.lower, own.upper].map(|end| (end - self.offset) / self.ratio);
            limit.lower = limit.lower.max(ends[0].min(ends[1]));
            limit.upper = limit.upper.min(ends[0].max(ends[1]));
        }
        if own.velocity > 0.0 {
            let speed = own.velocity / self.ratio.abs();
            limit.velocity = if limit.velocity > 0.0 {
                limit.velocity.min(speed)
            } else {
                speed
            };
        }
        if limit.lower < limit.upper {
            return Ok(());
        }
        Err(UrdfError::NoTravel {
            joint: leader.name.clone(),
            lower: limit.lower,
            upper: limit.upper,
        })
    }
}
