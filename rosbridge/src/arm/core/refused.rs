//! Why an order was refused.

use std::time::Duration;

use hal::{ArmMode, ErrorKind, FaultReason};

use super::reports::silent;

/// Stamps further behind than this are none: the publisher leaves them empty \[s\].
const UNSTAMPED: f64 = 1e8;

/// Why an order was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refused {
    /// No feedback has come yet.
    #[error("no feedback has come yet")]
    NoFeedback,
    /// The feedback is too old.
    #[error("last feedback {age_ms} ms ago")]
    StaleFeedback {
        /// Its age \[ms\].
        age_ms: u128,
    },
    /// Feedback comes, but not with the time of this computer.
    #[error("feedback arrives, but {}", skew("its", *behind_s))]
    Skew {
        /// How far its stamps are behind the clock of the run \[s\]; negative: ahead.
        behind_s: f64,
    },
    /// Not in this mode.
    #[error("not in mode {mode:?}")]
    Mode {
        /// The mode.
        mode: ArmMode,
    },
    /// A fault is latched.
    #[error("faulted: {reason:?}: {words}")]
    Faulted {
        /// The fault.
        reason: FaultReason,
        /// What happened, with figures.
        words: String,
    },
    /// The robot's controller says that it cannot move.
    #[error(
        "the robot's controller reports {reason:?} ({}); clear it there first",
        reported(*reason)
    )]
    Hindered {
        /// What it says.
        reason: FaultReason,
    },
    /// The robot's controller reports no more.
    #[error("{}", silent(*silence))]
    SilentRobot {
        /// For how long.
        silence: Duration,
    },
    /// Other nodes publish velocities for the same arm.
    #[error("{}", second_controller(.topic, .nodes))]
    SecondController {
        /// Topic of the velocities.
        topic: String,
        /// The other nodes.
        nodes: Vec<String>,
    },
    /// A value is not finite.
    #[error("a rate is not finite")]
    NonFinite,
    /// The wrong number of rates.
    #[error("{found} rates for {expected} joints")]
    Size {
        /// Rates in the command.
        found: usize,
        /// Joints of the arm.
        expected: usize,
    },
    /// The sequence number does not increase.
    #[error("command {sequence} after {last}")]
    Sequence {
        /// Number of the command.
        sequence: u64,
        /// Number of the last accepted command.
        last: u64,
    },
    /// The command is too old.
    #[error("command is {age_ms} ms old")]
    Late {
        /// Its age \[ms\].
        age_ms: u128,
    },
    /// The command is from the future: who sent it has another clock.
    #[error("command is {ahead_ms} ms ahead of the clock of the run")]
    Ahead {
        /// By how much \[ms\].
        ahead_ms: u128,
    },
}

impl Refused {
    /// The kind of error that a caller acts on.
    pub const fn kind(&self) -> ErrorKind {
        match self {
            Self::NoFeedback => ErrorKind::Disconnected,
            Self::StaleFeedback { .. } | Self::SilentRobot { .. } => ErrorKind::Timeout,
            Self::Skew { .. } => ErrorKind::ClockSkew,
            Self::Mode { .. } => ErrorKind::WrongMode,
            Self::Faulted { .. } | Self::Hindered { .. } | Self::SecondController { .. } => {
                ErrorKind::Faulted
            }
            Self::NonFinite
            | Self::Size { .. }
            | Self::Sequence { .. }
            | Self::Late { .. }
            | Self::Ahead { .. } => ErrorKind::Rejected,
        }
    }
}

/// The difference of two clocks in words: what carries the stamps (`its`), and how far they are
/// behind this computer's clock \[s\].
pub(crate) fn skew(whose: &str, behind_s: f64) -> String {
    if behind_s > UNSTAMPED {
        return format!("{whose} stamps are empty: the publisher has to fill header.stamp");
    }
    let way = if behind_s < 0.0 { "ahead of" } else { "behind" };
    format!(
        "{whose} stamps are {:.3} s {way} this computer's clock: synchronise the clocks of the \
         two computers (chrony, ntp)",
        behind_s.abs()
    )
}

/// What a controller's report means.
pub(crate) const fn reported(reason: FaultReason) -> &'static str {
    match reason {
        FaultReason::EmergencyStop => "e_stopped is TRUE on robot_status",
        FaultReason::DrivesOff => "drives_powered is FALSE on robot_status",
        FaultReason::NotAutomatic => "mode is MANUAL on robot_status",
        FaultReason::MotionImpossible => "motion_possible is FALSE on robot_status",
        _ => "in_error is TRUE on robot_status",
    }
}

/// Who else commands the arm, and what to do about it.
pub(crate) fn second_controller(topic: &str, nodes: &[String]) -> String {
    format!(
        "{topic} has another publisher ({}): two controllers would fight for one arm; end the \
         other one (a node that was killed is known until `rosnode cleanup` in ROS 1, and until its \
         lease ends in ROS 2)",
        nodes.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_skew_is_named_in_words() {
        let words = |behind_s| Refused::Skew { behind_s }.to_string();
        assert!(words(10.0).contains("10.000 s behind"), "{}", words(10.0));
        assert!(words(-2.5).contains("2.500 s ahead of"), "{}", words(-2.5));
        assert!(words(1.7e9).contains("empty"), "{}", words(1.7e9));
    }
}
