//! Which joint's limit acted.

use super::axis::Cause;
use crate::telemetry::Limit;

/// The joints that set the limits along a line.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Binding {
    pub(super) velocity: u8,
    pub(super) acceleration: u8,
    pub(super) jerk: u8,
    pub(super) up: u8,
    pub(super) down: u8,
}

impl Binding {
    pub(super) fn all(joint: u8) -> Self {
        Self {
            velocity: joint,
            acceleration: joint,
            jerk: joint,
            up: joint,
            down: joint,
        }
    }

    pub(super) fn limit(self, cause: Cause, upwards: bool) -> Limit {
        match cause {
            Cause::Position if upwards => Limit::JointPosition(self.up),
            Cause::Position => Limit::JointPosition(self.down),
            Cause::Velocity => Limit::JointVelocity(self.velocity),
            Cause::Acceleration => Limit::JointAcceleration(self.acceleration),
            Cause::Jerk => Limit::JointJerk(self.jerk),
        }
    }
}
