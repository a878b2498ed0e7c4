//! Whether the arm stands where the insertion starts.

use hal::Joints;
use robots::kinematics::{Chain, JointKind};

use crate::host::degrees;

/// Distance from the start at which a joint counts as there \[rad\]; of sliding joints by their unit.
const AT_START: f64 = 0.01;

/// The arm does not stand where the insertion starts.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "the arm does not stand at the start of the insertion: the needle's base is {distance_mm:.1} mm \
     and {angle_deg:.1} deg away from it, joint {joint} (from 1) at {at} instead of {expected}. \
     Move it to {start} (the request home does where it is offered; \
     tissue.entry_mm, needle.length_mm and [arm] set that place)"
)]
pub struct NotAtStart {
    /// Distance of the needle's base from its start \[mm\].
    pub distance_mm: f64,
    /// Angle between the needle's base and its start \[deg\].
    pub angle_deg: f64,
    /// The joint that is farthest away, from 1.
    pub joint: usize,
    /// Where it stands, with the unit.
    pub at: String,
    /// Where it should.
    pub expected: String,
    /// All joints of the start, with their units.
    pub start: String,
    /// Where all joints stand \[rad\].
    pub found: Joints,
}

impl NotAtStart {
    /// Checks that an arm at `found` stands at `start`.
    ///
    /// # Errors
    /// It does not, by the figures.
    pub fn check(chain: &Chain, found: &Joints, start: &Joints) -> Result<(), Box<Self>> {
        let mut off = found.zip(start, |found, start| (found - start).abs());
        for (off, kind) in off.iter_mut().zip(chain.kinds()) {
            *off /= kind.unit();
        }
        // What is not a number is not there.
        if off.iter().all(|off| *off <= AT_START) {
            return Ok(());
        }
        let far = |a: &usize, b: &usize| off[*a].total_cmp(&off[*b]);
        let joint = (0..off.len()).max_by(far).unwrap_or(0);
        let (here, there) = (chain.forward(found), chain.forward(start));
        let way = here.translation.vector - there.translation.vector;
        Err(Box::new(Self {
            distance_mm: way.norm() * 1e3,
            angle_deg: here.rotation.angle_to(&there.rotation).to_degrees(),
            joint: joint + 1,
            at: in_words(chain, joint, found[joint]),
            expected: in_words(chain, joint, start[joint]),
            start: all_in_words(chain, start),
            found: *found,
        }))
    }
}

fn in_words(chain: &Chain, joint: usize, position: f64) -> String {
    let kind = chain.kinds().get(joint);
    kind.map_or_else(String::new, |kind| kind.in_words(position))
}

/// Degrees, as where all joints turn a person types them; each with its unit where some slide.
fn all_in_words(chain: &Chain, joints: &Joints) -> String {
    if chain.kinds().contains(&JointKind::Prismatic) {
        let each = joints.iter().enumerate();
        let words: Vec<String> = each.map(|(i, q)| in_words(chain, i, *q)).collect();
        return format!("[{}]", words.join(", "));
    }
    format!("{} deg", degrees(joints))
}

#[cfg(test)]
mod tests {
    use super::*;
    use robots::arms;

    #[test]
    fn an_arm_aside_of_the_start_is_refused_with_figures() {
        let chain = Chain::from_urdf(arms::VIPER_S650, arms::NEEDLE_BASE).unwrap();
        let start = Joints::from([0.1, -1.2, 2.4, 0.2, 0.9, -0.3]);
        assert_eq!(NotAtStart::check(&chain, &start, &start), Ok(()));
        let mut aside = start;
        aside[0] += 0.1;
        let refused = NotAtStart::check(&chain, &aside, &start).unwrap_err();
        let place = |q: &Joints| chain.forward(q).translation.vector;
        let apart = (place(&aside) - place(&start)).norm() * 1e3;
        assert_eq!(refused.joint, 1);
        assert!((refused.distance_mm - apart).abs() < 1e-9 && apart > 10.0);
        assert!(
            refused.to_string().contains(&format!("{apart:.1} mm")),
            "{refused}"
        );
        aside[2] = f64::NAN;
        assert!(NotAtStart::check(&chain, &aside, &start).is_err());
    }
}
