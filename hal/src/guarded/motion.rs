//! What goes into and comes out of a limiter.

use serde::{Deserialize, Serialize};

use crate::telemetry::Limit;
use crate::{Joints, MAX_JOINTS};

/// Rates within the limits.
#[derive(Clone, Debug, PartialEq)]
pub struct Limited {
    /// Rates to execute for one period \[rad/s\].
    pub rates: Joints,
    /// Limits that made them differ from those wanted, in no order.
    pub limits: Vec<Limit>,
    /// How `rates` relate to those wanted.
    pub course: Course,
}

/// How limited rates relate to those wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Course {
    /// A multiple of those wanted (to stop: of those executed); from 0 to 1 times, unless the arm
    /// came along the same line, faster, backwards or speeding up.
    Straight,
    /// A linear combination of those wanted and of the motion's rates and accelerations: the arm
    /// leaves another direction of motion. A linear condition that motion and command keep, such
    /// as no motion of the tool across the needle, is kept.
    Blended,
    /// Every joint goes for itself: one of them has to brake before its end more than that.
    Apart,
}

/// What an arm was last told to do: rates \[rad/s\] and their change \[rad/s2\].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Rates \[rad/s\].
    pub rates: Joints,
    /// Accelerations \[rad/s2\].
    pub accelerations: Joints,
}

impl Motion {
    /// Moving at constant rates.
    pub fn steady(rates: Joints) -> Self {
        Self {
            rates,
            accelerations: rates.zeroed(),
        }
    }

    /// Whether nothing moves and nothing is about to.
    pub fn is_rest(&self) -> bool {
        self.rates
            .iter()
            .chain(self.accelerations.iter())
            .all(|x| *x == 0.0)
    }
}

/// Why a limiter cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LimiterError {
    /// The number of joints is not 1 to [`MAX_JOINTS`].
    #[error("{joints} joints; 1 to {MAX_JOINTS} are supported")]
    Joints {
        /// The number of joints.
        joints: usize,
    },
    /// A limit is not a positive finite number.
    #[error("joint {joint}: speed, acceleration and jerk have to be positive and finite")]
    NotPositive {
        /// Number of the joint, from 0.
        joint: usize,
    },
    /// The margins leave no range, or one too short to stop in.
    #[error("joint {joint}: a range of {range_rad} rad between the margins is too short")]
    Range {
        /// Number of the joint, from 0.
        joint: usize,
        /// What is left \[rad\].
        range_rad: f64,
    },
    /// The margin is not a finite number of at least zero.
    #[error("the margin of {margin_rad} rad is no finite number of at least zero")]
    Margin {
        /// The margin \[rad\].
        margin_rad: f64,
    },
    /// The holding time is zero.
    #[error("the time for which rates may stand has to be positive")]
    Hold,
}
