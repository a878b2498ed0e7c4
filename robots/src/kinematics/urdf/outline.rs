//! Which chains of a URDF may be arms.

use std::collections::HashMap;

use hal::MAX_JOINTS;

use super::error::UrdfError;
use super::scan::{Joint, scan};

/// Names of links at which makers end an arm, the likeliest first.
const TIPS: [&str; 8] = [
    "needle_base",
    "tool0",
    "tip",
    "tcp",
    "ee_link",
    "end_effector",
    "flange",
    "link_ee",
];
/// Parts of the names of what a gripper moves.
const GRIPPER: [&str; 7] = [
    "finger", "gripper", "knuckle", "thumb", "pad", "hand", "jaw",
];

/// Base and tip link of the chains of a URDF that may be arms, six or seven turning joints
/// long, the likeliest first.
///
/// # Errors
/// The text is no URDF.
pub fn arm_sections(file: &[u8]) -> Result<Vec<(String, String)>, UrdfError> {
    let scan = scan(&super::decode(file))?;
    let mut above: HashMap<&str, &Joint> = HashMap::new();
    for joint in &scan.joints {
        if let Some(child) = &joint.child {
            above.insert(child, joint);
        }
    }
    let mut found: Vec<(usize, usize, String, String)> = Vec::new();
    for link in &scan.links {
        let (mut base, mut turning, mut steps) = (link.as_str(), 0, 0);
        while let Some(joint) = above.get(base)
            && steps <= scan.joints.len()
        {
            steps += 1;
            let turns = ["revolute", "continuous"].contains(&joint.kind.as_str());
            let follows = joint.mimics;
            let goes_on = joint.kind == "fixed" || turns && (follows || turning < MAX_JOINTS);
            let Some(parent) = joint.parent.as_deref().filter(|_| goes_on) else {
                break;
            };
            turning += usize::from(turns && !follows);
            base = parent;
        }
        let lower = link.to_lowercase();
        if turning < 6 || GRIPPER.iter().any(|part| lower.contains(part)) {
            continue;
        }
        let rank = TIPS.iter().position(|tip| lower.ends_with(tip));
        found.push((
            rank.unwrap_or(TIPS.len()),
            // Else the link farthest from the base.
            usize::MAX - steps,
            base.to_owned(),
            link.clone(),
        ));
    }
    found.sort();
    Ok(found
        .into_iter()
        .map(|(_, _, base, tip)| (base, tip))
        .collect())
}
