//! The state of a robot's controller, as ROS-Industrial's drivers report it.

use hal::{ArmMode, FaultReason};

use crate::codes::Code;
use crate::msg::industrial_msgs::{RobotMode, RobotStatus, TriState};
use crate::msg::std_msgs::Header;

/// Why the controller cannot move the robot, if it says so; what it does not know hinders nothing.
pub(crate) fn hindrance(status: &RobotStatus) -> Option<FaultReason> {
    if status.e_stopped.val == TriState::TRUE {
        Some(FaultReason::EmergencyStop)
    } else if status.drives_powered.val == TriState::FALSE {
        Some(FaultReason::DrivesOff)
    } else if status.mode.val == RobotMode::MANUAL {
        Some(FaultReason::NotAutomatic)
    } else if status.in_error.val == TriState::TRUE {
        Some(FaultReason::ControllerError)
    } else if status.motion_possible.val == TriState::FALSE {
        Some(FaultReason::MotionImpossible)
    } else {
        None
    }
}

/// An arm's mode as the state of a controller; `error_code` is the fault's number.
pub(crate) fn of_arm(header: Header, mode: ArmMode) -> RobotStatus {
    let fault = match mode {
        ArmMode::Faulted(reason) => Some(reason),
        _ => None,
    };
    let truth = |is: bool| TriState {
        val: if is { TriState::TRUE } else { TriState::FALSE },
    };
    let stopped = fault == Some(FaultReason::EmergencyStop);
    let unpowered = fault == Some(FaultReason::DrivesOff);
    let manual = fault == Some(FaultReason::NotAutomatic);
    RobotStatus {
        header,
        mode: RobotMode {
            val: if manual {
                RobotMode::MANUAL
            } else {
                RobotMode::AUTO
            },
        },
        e_stopped: truth(stopped),
        drives_powered: truth(!stopped && !unpowered),
        motion_possible: truth(fault.is_none()),
        in_motion: truth(matches!(mode, ArmMode::Moving | ArmMode::Stopping)),
        in_error: truth(fault.is_some()),
        error_code: fault.map_or(0, |reason| i32::from(reason.code())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hindrances_survive_the_wire_and_unknowns_hinder_nothing() {
        let through = |mode| hindrance(&of_arm(Header::default(), mode));
        assert_eq!(through(ArmMode::Moving), None);
        assert_eq!(through(ArmMode::Connected), None);
        for (fault, told) in [
            (FaultReason::EmergencyStop, FaultReason::EmergencyStop),
            (FaultReason::DrivesOff, FaultReason::DrivesOff),
            (FaultReason::NotAutomatic, FaultReason::NotAutomatic),
            (FaultReason::TrackingError, FaultReason::ControllerError),
        ] {
            assert_eq!(through(ArmMode::Faulted(fault)), Some(told));
        }
        let unknown = || TriState {
            val: TriState::UNKNOWN,
        };
        let mut status = RobotStatus {
            mode: RobotMode {
                val: RobotMode::UNKNOWN,
            },
            e_stopped: unknown(),
            drives_powered: unknown(),
            motion_possible: unknown(),
            in_motion: unknown(),
            in_error: unknown(),
            ..RobotStatus::default()
        };
        assert_eq!(hindrance(&status), None);
        status.motion_possible.val = TriState::FALSE;
        assert_eq!(hindrance(&status), Some(FaultReason::MotionImpossible));
        status.mode.val = RobotMode::MANUAL;
        assert_eq!(hindrance(&status), Some(FaultReason::NotAutomatic));
    }
}
