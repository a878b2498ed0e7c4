//! Why an arm cannot carry out an insertion.

use robots::kinematics::Chain;

/// Why an arm cannot carry out the insertion; nothing moved.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Misfit {
    /// Joints whose speed is not known.
    #[error(
        "the URDF gives no speed for {joints} (velocity of <limit> is 0 or missing): \
         arm.joint_speed_deg_s gives it"
    )]
    NoSpeed {
        /// Their names.
        joints: String,
    },
    /// The needle is not along the axis of the joint that turns it.
    #[error(
        "z of {tip} is {tilt_deg:.1} degrees off the axis of {joint}, which must turn the needle, \
         and its origin {aside_mm:.1} mm beside it; {remedy}"
    )]
    OffAxis {
        /// The tip link.
        tip: String,
        /// The joint.
        joint: String,
        /// Angle between them \[deg\].
        tilt_deg: f64,
        /// Distance of the tip from the axis \[mm\].
        aside_mm: f64,
        /// Keys that put the needle onto the axis.
        remedy: String,
    },
    /// The joint that turns the needle has not enough travel.
    #[error(
        "{joint} must turn the needle, but turns from {lower_deg:.1} to {upper_deg:.1} deg only: \
         {travel_deg:.1} of the 300 deg that steering needs"
    )]
    ShortTurn {
        /// The joint.
        joint: String,
        /// Its ends \[deg\].
        lower_deg: f64,
        /// See `lower_deg`.
        upper_deg: f64,
        /// Its travel \[deg\].
        travel_deg: f64,
    },
    /// A joint is too slow for an insertion.
    #[error(
        "{joint} is too slow: {speed}{needed}; velocity of <limit> is in rad/s, in m/s where a joint \
         slides"
    )]
    Slow {
        /// The joint.
        joint: String,
        /// Its speed, with the unit.
        speed: String,
        /// What is asked of it, in words.
        needed: String,
    },
    /// The ends of a joint are degrees.
    #[error(
        "{joint} turns from {lower} to {upper} rad: are these degrees? limits of a URDF are in rad; a \
         joint without ends has the type continuous"
    )]
    Degrees {
        /// The joint.
        joint: String,
        /// Its ends \[rad\].
        lower: f64,
        /// See `lower`.
        upper: f64,
    },
    /// The lengths of the URDF are millimetres.
    #[error(
        "with its joints at 0, {tip} is {distance:.0} m from {base}: are these millimetres? lengths of \
         a URDF are in m"
    )]
    Millimetres {
        /// The base link.
        base: String,
        /// The tip link.
        tip: String,
        /// From one to the other \[m\].
        distance: f64,
    },
    /// A joint starts at its end.
    #[error("{joint} starts at its end ({position} of {lower} to {upper}) and has no room{PLACE}")]
    StartsAtEnd {
        /// The joint.
        joint: String,
        /// Where it starts, with the unit.
        position: String,
        /// Its ends.
        lower: String,
        /// See `lower`.
        upper: String,
    },
    /// A joint comes to its end on the way.
    #[error(
        "{joint} comes to its end ({end}) {depth_mm:.0} mm deep{tilted}; the insertion \
         needs {needed_mm:.0} mm{PLACE}"
    )]
    MeetsEnd {
        /// The joint.
        joint: String,
        /// The end, with the unit.
        end: String,
        /// Depth of the tip \[mm\].
        depth_mm: f64,
        /// Depth of the whole insertion \[mm\].
        needed_mm: f64,
        /// The tilt or shift of the base that leads there, in words; empty without.
        tilted: String,
    },
    /// A device is mounted elsewhere than the insertion starts.
    #[error(
        "the device holds the needle {across_mm:.1} mm beside the start of the insertion, \
         {askew_deg:.1} deg askew and {along_mm:+.1} mm along it, and cannot get nearer{PLACE}"
    )]
    Mounted {
        /// Distance across the needle \[mm\].
        across_mm: f64,
        /// Along it, positive where the tip is in the tissue \[mm\].
        along_mm: f64,
        /// Angle between the needle and the insertion's axis \[deg\].
        askew_deg: f64,
    },
    /// No joint of a device inserts the needle.
    #[error("no joint moves {tip} along its z: nothing inserts the needle")]
    NoInsertion {
        /// The tip link.
        tip: String,
    },
    /// The arm comes to a singularity or to the end of its reach on the way.
    #[error(
        "the arm comes to a singularity or the end of its reach {depth_mm:.0} mm deep{tilted}; the \
         insertion needs {needed_mm:.0} mm{PLACE}"
    )]
    Singular {
        /// Depth of the tip \[mm\].
        depth_mm: f64,
        /// Depth of the whole insertion \[mm\].
        needed_mm: f64,
        /// The tilt or shift of the base that leads there, in words; empty without.
        tilted: String,
    },
}

/// What helps against a bad place.
pub(in crate::rig) const PLACE: &str = "; needle-steer check --suggest looks for a place to stand";

impl Misfit {
    /// A joint that is too slow for what is `needed` of it.
    pub(super) fn slow(chain: &Chain, joint: usize, needed: String) -> Self {
        Self::Slow {
            joint: chain.names()[joint].clone(),
            speed: format!(
                "{}/s",
                chain.kinds()[joint].in_words(chain.limits()[joint].velocity)
            ),
            needed,
        }
    }
}
