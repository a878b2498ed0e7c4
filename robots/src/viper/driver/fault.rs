//! Why the driver refuses, faults or loses its link.

use hal::{ErrorKind, FaultReason};

use crate::viper::wire::WireError;
use crate::viper::wire::steer::Refusal;

/// Why a link ended or did not come about.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LinkError {
    /// The host name has no address.
    #[error("host {host:?} does not resolve: {detail}")]
    Resolve {
        /// The name.
        host: String,
        /// The resolver's words.
        detail: String,
    },
    /// The connection was not made.
    #[error("cannot connect to {peer}: {detail}")]
    Connect {
        /// Address and port.
        peer: String,
        /// The system's words.
        detail: String,
    },
    /// The connection was not made in time.
    #[error("no connection in time")]
    ConnectTimeout,
    /// The controller accepted, but did not greet or report.
    #[error("connected, but the controller did not report in time")]
    Mute,
    /// The controller closed the connection.
    #[error("the controller closed the connection")]
    Closed,
    /// The connection broke.
    #[error("the connection broke: {detail}")]
    Broken {
        /// The system's words.
        detail: String,
    },
    /// The controller refused the greeting or a stop.
    #[error("the controller refused the greeting or a stop")]
    Refused,
    /// Nothing came for too long.
    #[error("the controller fell silent")]
    Silent,
    /// The driver closed it because of what came.
    #[error("protocol violated: {0}")]
    Protocol(#[from] ProtocolError),
    /// No attempt yet.
    #[error("not connected yet")]
    NotYet,
}

/// What the peer did against the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProtocolError {
    /// A frame that cannot be read.
    #[error(transparent)]
    Wire(#[from] WireError),
    /// A well-formed frame that does not belong here.
    #[error("a frame came that does not belong on the {port} port")]
    Unexpected {
        /// `motion` or `state`.
        port: &'static str,
    },
    /// An answer to something else than was asked.
    #[error("answer to sequence {found} where {expected} was asked")]
    Sequence {
        /// Expected number.
        expected: i32,
        /// Number found.
        found: i32,
    },
    /// An answer to nothing.
    #[error("answer to sequence {found} although nothing was asked")]
    Unasked {
        /// Number found.
        found: i32,
    },
    /// The greeting was answered by another program.
    #[error("the controller answers like the 2018 program, not like `steer`")]
    OtherDialect,
    /// The greeting was answered by another version.
    #[error("the controller's program has magic {magic:#x}, version {version}")]
    OtherVersion {
        /// Magic found.
        magic: i32,
        /// Version found.
        version: i32,
    },
    /// The controller speaks for another session.
    #[error("session {found} where {expected} is open")]
    Session {
        /// Expected number.
        expected: i32,
        /// Number found.
        found: i32,
    },
}

/// Why the arm is the wrong one.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Unfit {
    /// It has another number of joints.
    #[error("the controller's arm has {found} joints, ours {expected}")]
    Joints {
        /// Expected number.
        expected: usize,
        /// Number found.
        found: usize,
    },
    /// It has other limits.
    #[error(
        "joint {joint} (from 0) of the controller's arm has limits {lower_rad}..{upper_rad} rad \
         and {speed_rad_s} rad/s: not the configured arm"
    )]
    Limits {
        /// Joint, from 0.
        joint: usize,
        /// Its lower limit \[rad\].
        lower_rad: f64,
        /// Its upper limit \[rad\].
        upper_rad: f64,
        /// Its speed \[rad/s\].
        speed_rad_s: f64,
    },
    /// It stands where the configured arm cannot.
    #[error(
        "joint {joint} (from 0) stands at {position_rad} rad, outside the configured limits: \
         another arm, or one to be moved back by hand"
    )]
    Position {
        /// Joint, from 0.
        joint: usize,
        /// Its position \[rad\].
        position_rad: f64,
    },
}

/// Why the driver faulted, with its numbers.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    /// A command with a value that is not finite.
    #[error("command with a rate that is not finite")]
    NonFinite,
    /// The caller fell silent while the arm moved.
    #[error("no command for {age_s:.3} s while moving")]
    StaleCommand {
        /// Age of the last command \[s\].
        age_s: f64,
    },
    /// Feedback too old.
    #[error("no feedback for {age_s:.3} s")]
    StaleFeedback {
        /// Its age \[s\].
        age_s: f64,
    },
    /// An answer is missing.
    #[error("no answer to sequence {sequence} for {age_s:.3} s")]
    StaleAcknowledgement {
        /// The point's or stop's number.
        sequence: i32,
        /// Time since it was sent \[s\].
        age_s: f64,
    },
    /// The arm does not follow.
    #[error("joint {joint} (from 0) is {error_rad:.4} rad from its set points")]
    Tracking {
        /// Joint, from 0.
        joint: usize,
        /// Distance \[rad\].
        error_rad: f64,
    },
    /// The arm moves without a command.
    #[error("joint {joint} (from 0) moved by {error_rad:.4} rad without a command")]
    Uncommanded {
        /// Joint, from 0.
        joint: usize,
        /// Distance \[rad\].
        error_rad: f64,
    },
    /// The controller found the arm elsewhere than its feedback said.
    #[error("the controller finds the arm not at the first set point")]
    StartMismatch,
    /// A joint is outside its limits.
    #[error("joint {joint} (from 0) at {position_rad:.4} rad is outside its limits")]
    JointLimit {
        /// Joint, from 0.
        joint: usize,
        /// Its position \[rad\].
        position_rad: f64,
    },
    /// Emergency stop.
    #[error("emergency stop")]
    EmergencyStop,
    /// Drives without power.
    #[error("drives off")]
    DrivesOff,
    /// Not in automatic mode.
    #[error("controller not in automatic mode (mode {mode})")]
    NotAutomatic {
        /// The mode's number.
        mode: i32,
    },
    /// The controller is in error.
    #[error("controller in error {code}")]
    ControllerError {
        /// Its number.
        code: i32,
    },
    /// The controller refused a point or a stop.
    #[error("the controller refused sequence {sequence}: {refusal:?}")]
    Refused {
        /// The point's number.
        sequence: i32,
        /// Its reason, where the dialect tells.
        refusal: Option<Refusal>,
    },
    /// The controller disarmed itself.
    #[error("the controller disarmed itself: {0:?}")]
    Disarmed(Option<Refusal>),
    /// The arm did not stop.
    #[error("still moving {age_s:.1} s after a stop")]
    NotStopping {
        /// Time since the stop \[s\].
        age_s: f64,
    },
    /// The link was lost while enabled.
    #[error("link lost while enabled: {0}")]
    ConnectionLost(LinkError),
    /// The peer violated the protocol.
    #[error("protocol violated: {0}")]
    Protocol(ProtocolError),
}

impl Fault {
    /// The reason in hal's terms.
    pub const fn reason(&self) -> FaultReason {
        match self {
            Self::NonFinite => FaultReason::NonFiniteCommand,
            Self::StaleCommand { .. } => FaultReason::StaleCommand,
            Self::StaleFeedback { .. } => FaultReason::StaleFeedback,
            Self::StaleAcknowledgement { .. } => FaultReason::StaleAcknowledgement,
            Self::Tracking { .. } => FaultReason::TrackingError,
            Self::Uncommanded { .. } | Self::NotStopping { .. } => FaultReason::UncommandedMotion,
            Self::StartMismatch => FaultReason::StartMismatch,
            Self::JointLimit { .. } => FaultReason::JointLimit,
            Self::EmergencyStop => FaultReason::EmergencyStop,
            Self::DrivesOff => FaultReason::DrivesOff,
            Self::NotAutomatic { .. } => FaultReason::NotAutomatic,
            Self::ControllerError { .. } | Self::Refused { .. } | Self::Disarmed(_) => {
                FaultReason::ControllerError
            }
            Self::ConnectionLost(_) => FaultReason::ConnectionLost,
            Self::Protocol(_) => FaultReason::Protocol,
        }
    }
}

/// Why a call was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refused {
    /// There is no link.
    #[error("no link: {0}")]
    NoLink(LinkError),
    /// A fault is latched.
    #[error("faulted: {0}")]
    Faulted(Fault),
    /// The cause of the fault is still there.
    #[error("cannot reset: {0}")]
    CauseRemains(Fault),
    /// The controller is not ready.
    #[error("controller not ready: {0}")]
    NotReady(Fault),
    /// Another arm than the configured one.
    #[error(transparent)]
    Unfit(#[from] Unfit),
    /// The wrist is too straight for Cartesian motion.
    #[error("joint 5 at {position_rad:.4} rad is within {least_rad:.4} rad of its singularity")]
    Singular {
        /// Position of joint 5 \[rad\].
        position_rad: f64,
        /// Least bend \[rad\].
        least_rad: f64,
    },
    /// The mode does not allow the call.
    #[error("not allowed while {0:?}")]
    Mode(hal::ArmMode),
    /// A command with another number of joints.
    #[error("command of {found} joints, the arm has {expected}")]
    Joints {
        /// Expected number.
        expected: usize,
        /// Number found.
        found: usize,
    },
    /// A command with a value that is not finite.
    #[error("command with a rate that is not finite")]
    NonFinite,
    /// A repeated or falling sequence number.
    #[error("command {found} after command {last}")]
    Sequence {
        /// Last accepted number.
        last: u64,
        /// Number found.
        found: u64,
    },
    /// A command computed too long ago.
    #[error("command is {age_s:.3} s old")]
    Late {
        /// Its age \[s\].
        age_s: f64,
    },
    /// A command from the future: the caller uses another clock.
    #[error("command is {ahead_s:.3} s in the future")]
    Future {
        /// By how much \[s\].
        ahead_s: f64,
    },
    /// Feedback too old.
    #[error("feedback is {age_s:.3} s old")]
    StaleFeedback {
        /// Its age \[s\].
        age_s: f64,
    },
}

impl Refused {
    /// The kind in hal's terms.
    pub const fn kind(&self) -> ErrorKind {
        match self {
            Self::NoLink(_) => ErrorKind::Disconnected,
            Self::Faulted(_) | Self::CauseRemains(_) => ErrorKind::Faulted,
            Self::NotReady(_) | Self::Mode(_) | Self::Singular { .. } => ErrorKind::WrongMode,
            Self::Unfit(_) => ErrorKind::Configuration,
            Self::Joints { .. }
            | Self::NonFinite
            | Self::Sequence { .. }
            | Self::Late { .. }
            | Self::Future { .. } => ErrorKind::Rejected,
            Self::StaleFeedback { .. } => ErrorKind::Timeout,
        }
    }
}
