//! Enumerations of `hal` as the constants of the message definitions.

use hal::telemetry::{Limit, Phase, SteeringMode, Tracking, TruthEvent};
use hal::{ArmMode, FaultReason};

use crate::convert::ConvertError;
use crate::msg::{needle_steer_lockstep as lockstep, needle_steer_msgs as msgs};

/// A plain enumeration as a constant of its message, and back.
pub(crate) trait Code: Sized {
    fn code(self) -> u8;
    fn from_code(code: u8) -> Result<Self, ConvertError>;
}

macro_rules! codes {
    ($kind:ty, $message:ty, $field:literal: $($variant:ident = $constant:ident,)*) => {
        impl Code for $kind {
            fn code(self) -> u8 {
                match self {
                    $(Self::$variant => <$message>::$constant,)*
                }
            }

            fn from_code(code: u8) -> Result<Self, ConvertError> {
                match code {
                    $(<$message>::$constant => Ok(Self::$variant),)*
                    _ => Err(ConvertError::UnknownCode { field: $field, code }),
                }
            }
        }
    };
}

codes! { Phase, msgs::Step, "phase":
    Idle = IDLE,
    PreInsertion = PRE_INSERTION,
    Steering = STEERING,
    Paused = PAUSED,
    Retracting = RETRACTING,
    Ended = ENDED,
    Faulted = FAULTED,
}

codes! { Tracking, msgs::Step, "tracking":
    None = NONE,
    Tracked = TRACKED,
    Predicted = PREDICTED,
    Lost = LOST,
}

codes! { SteeringMode, msgs::Law, "mode":
    Straight = STRAIGHT,
    Manipulation = MANIPULATION,
    DutyCycleSpin = DUTY_CYCLE_SPIN,
    DutyCycleInsert = DUTY_CYCLE_INSERT,
    BevelTurn = BEVEL_TURN,
    BevelHold = BEVEL_HOLD,
    Hold = HOLD,
}

codes! { TruthEvent, lockstep::World, "events":
    Buckling = BUCKLING,
    Yielding = YIELDING,
    Tearing = TEARING,
    PulledOut = PULLED_OUT,
    Entered = ENTERED,
    Unconverged = UNCONVERGED,
    Refused = REFUSED,
}

/// Faults beyond the message's definition, which stays as it is so that logs of other builds can be
/// read.
impl msgs::ArmMode {
    const MOTION_IMPOSSIBLE: u8 = 18;
    const CLOCK_SKEW: u8 = 19;
    const SECOND_CONTROLLER: u8 = 20;
}

codes! { FaultReason, msgs::ArmMode, "fault":
    NonFiniteCommand = NON_FINITE_COMMAND,
    StaleCommand = STALE_COMMAND,
    StaleFeedback = STALE_FEEDBACK,
    StaleAcknowledgement = STALE_ACKNOWLEDGEMENT,
    TrackingError = TRACKING_ERROR,
    UncommandedMotion = UNCOMMANDED_MOTION,
    StartMismatch = START_MISMATCH,
    JointLimit = JOINT_LIMIT,
    Workspace = WORKSPACE,
    EmergencyStop = EMERGENCY_STOP,
    DrivesOff = DRIVES_OFF,
    NotAutomatic = NOT_AUTOMATIC,
    ControllerError = CONTROLLER_ERROR,
    MotionImpossible = MOTION_IMPOSSIBLE,
    ClockSkew = CLOCK_SKEW,
    SecondController = SECOND_CONTROLLER,
    ConnectionLost = CONNECTION_LOST,
    Protocol = PROTOCOL,
    DeadMan = DEAD_MAN,
    Injected = INJECTED,
}

impl From<ArmMode> for msgs::ArmMode {
    fn from(mode: ArmMode) -> Self {
        let (mode, fault) = match mode {
            ArmMode::Disconnected => (Self::DISCONNECTED, Self::NO_FAULT),
            ArmMode::Connected => (Self::CONNECTED, Self::NO_FAULT),
            ArmMode::Enabled => (Self::ENABLED, Self::NO_FAULT),
            ArmMode::Moving => (Self::MOVING, Self::NO_FAULT),
            ArmMode::Stopping => (Self::STOPPING, Self::NO_FAULT),
            ArmMode::Faulted(reason) => (Self::FAULTED, reason.code()),
        };
        Self { mode, fault }
    }
}

impl TryFrom<&msgs::ArmMode> for ArmMode {
    type Error = ConvertError;

    fn try_from(m: &msgs::ArmMode) -> Result<Self, ConvertError> {
        match m.mode {
            msgs::ArmMode::DISCONNECTED => Ok(Self::Disconnected),
            msgs::ArmMode::CONNECTED => Ok(Self::Connected),
            msgs::ArmMode::ENABLED => Ok(Self::Enabled),
            msgs::ArmMode::MOVING => Ok(Self::Moving),
            msgs::ArmMode::STOPPING => Ok(Self::Stopping),
            msgs::ArmMode::FAULTED => Ok(Self::Faulted(FaultReason::from_code(m.fault)?)),
            code => Err(ConvertError::UnknownCode { field: "arm", code }),
        }
    }
}

impl From<Limit> for msgs::Limit {
    fn from(limit: Limit) -> Self {
        let (kind, joint) = match limit {
            Limit::JointPosition(joint) => (Self::JOINT_POSITION, joint),
            Limit::JointVelocity(joint) => (Self::JOINT_VELOCITY, joint),
            Limit::JointAcceleration(joint) => (Self::JOINT_ACCELERATION, joint),
            Limit::JointJerk(joint) => (Self::JOINT_JERK, joint),
            Limit::Workspace => (Self::WORKSPACE, 0),
            Limit::InsertionSpeed => (Self::INSERTION_SPEED, 0),
            Limit::LateralSpeed => (Self::LATERAL_SPEED, 0),
            Limit::TiltSpeed => (Self::TILT_SPEED, 0),
            Limit::SpinSpeed => (Self::SPIN_SPEED, 0),
            Limit::Singularity => (Self::SINGULARITY, 0),
            Limit::EntryForce => (Self::ENTRY_FORCE, 0),
            Limit::EntryStretch => (Self::ENTRY_STRETCH, 0),
            Limit::TissueStretch => (Self::TISSUE_STRETCH, 0),
            Limit::RemoteCentre => (Self::REMOTE_CENTRE, 0),
            Limit::BevelCurvature => (Self::BEVEL_CURVATURE, 0),
            Limit::RemainingTurns => (Self::REMAINING_TURNS, 0),
        };
        Self { kind, joint }
    }
}

impl TryFrom<&msgs::Limit> for Limit {
    type Error = ConvertError;

    fn try_from(m: &msgs::Limit) -> Result<Self, ConvertError> {
        Ok(match m.kind {
            msgs::Limit::JOINT_POSITION => Self::JointPosition(m.joint),
            msgs::Limit::JOINT_VELOCITY => Self::JointVelocity(m.joint),
            msgs::Limit::JOINT_ACCELERATION => Self::JointAcceleration(m.joint),
            msgs::Limit::JOINT_JERK => Self::JointJerk(m.joint),
            msgs::Limit::WORKSPACE => Self::Workspace,
            msgs::Limit::INSERTION_SPEED => Self::InsertionSpeed,
            msgs::Limit::LATERAL_SPEED => Self::LateralSpeed,
            msgs::Limit::TILT_SPEED => Self::TiltSpeed,
            msgs::Limit::SPIN_SPEED => Self::SpinSpeed,
            msgs::Limit::SINGULARITY => Self::Singularity,
            msgs::Limit::ENTRY_FORCE => Self::EntryForce,
            msgs::Limit::ENTRY_STRETCH => Self::EntryStretch,
            msgs::Limit::TISSUE_STRETCH => Self::TissueStretch,
            msgs::Limit::REMOTE_CENTRE => Self::RemoteCentre,
            msgs::Limit::BEVEL_CURVATURE => Self::BevelCurvature,
            msgs::Limit::REMAINING_TURNS => Self::RemainingTurns,
            code => {
                return Err(ConvertError::UnknownCode {
                    field: "limit",
                    code,
                });
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn every_code_is_taken_once<T: Code>(count: u8, first: u8) {
        for code in 0..=u8::MAX {
            let back = T::from_code(code).map(Code::code);
            if (first..first + count).contains(&code) {
                assert_eq!(back.unwrap(), code);
            } else {
                assert!(back.is_err());
            }
        }
    }

    #[test]
    fn plain_enumerations_round_trip_and_refuse_the_rest() {
        every_code_is_taken_once::<Phase>(7, 0);
        every_code_is_taken_once::<Tracking>(4, 0);
        every_code_is_taken_once::<SteeringMode>(7, 0);
        every_code_is_taken_once::<TruthEvent>(7, 0);
        every_code_is_taken_once::<FaultReason>(20, 1);
    }

    #[test]
    fn limits_and_modes_round_trip_and_refuse_the_rest() {
        for kind in 0..16 {
            let joint = if kind < 4 { 3 } else { 0 };
            let message = msgs::Limit { kind, joint };
            assert_eq!(
                msgs::Limit::from(Limit::try_from(&message).unwrap()),
                message
            );
        }
        assert!(Limit::try_from(&msgs::Limit { kind: 16, joint: 0 }).is_err());
        for mode in 0..6 {
            let message = msgs::ArmMode {
                mode,
                fault: if mode == 5 { 17 } else { 0 },
            };
            assert_eq!(
                msgs::ArmMode::from(ArmMode::try_from(&message).unwrap()),
                message
            );
        }
        assert!(ArmMode::try_from(&msgs::ArmMode { mode: 6, fault: 0 }).is_err());
        assert!(ArmMode::try_from(&msgs::ArmMode { mode: 5, fault: 0 }).is_err());
    }
}
