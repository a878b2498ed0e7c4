//! Travel that is left to a joint that turns a needle.

use hal::JointLimit;

/// Travel of a joint, less a margin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurnBudget {
    lower: f64,
    upper: f64,
}

/// Travel left \[rad\], both at least zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RemainingTravel {
    /// In the positive sense.
    pub positive: f64,
    /// In the negative sense.
    pub negative: f64,
}

impl TurnBudget {
    /// Keeps `margin` \[rad\] from both ends of the joint.
    pub fn new(limit: &JointLimit, margin: f64) -> Self {
        Self {
            lower: limit.lower + margin,
            upper: limit.upper - margin,
        }
    }

    /// What is left at position `q` \[rad\].
    pub fn remaining(&self, q: f64) -> RemainingTravel {
        RemainingTravel {
            positive: (self.upper - q).max(0.0),
            negative: (q - self.lower).max(0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use core::f64::consts::TAU;

    use super::*;

    const JOINT_6: JointLimit = JointLimit {
        lower: -TAU,
        upper: TAU,
        velocity: 10.0,
        acceleration: 40.0,
        jerk: 400.0,
    };

    #[test]
    fn travel_ends_at_the_margin_and_is_never_negative() {
        let budget = TurnBudget::new(&JOINT_6, 0.01);
        let left = budget.remaining(0.3);
        assert!((left.positive - (TAU - 0.31)).abs() < 1e-12);
        assert!((left.negative - (TAU + 0.29)).abs() < 1e-12);
        assert!(budget.remaining(TAU).positive.abs() < 1e-300);
        assert!(budget.remaining(-TAU).negative.abs() < 1e-300);
    }
}
