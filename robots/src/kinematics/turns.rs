//! Turns of a joint that turns a needle: how many are left, and which are refused.

use core::f64::consts::{PI, TAU};

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

/// A roll that the joint has not enough travel for.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "a roll of {asked_rad} rad is refused: {} rad are left forwards, {} rad backwards",
    remaining.positive, remaining.negative
)]
pub struct NotEnoughTravel {
    /// The roll asked for \[rad\].
    pub asked_rad: f64,
    /// What is left.
    pub remaining: RemainingTravel,
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

    /// Admits a roll of `roll` \[rad\] from `q`, in its sense and in full.
    ///
    /// # Errors
    /// Not enough travel is left, or the roll is not finite.
    pub fn admit(&self, q: f64, roll: f64) -> Result<f64, NotEnoughTravel> {
        let remaining = self.remaining(q);
        if (-remaining.negative..=remaining.positive).contains(&roll) {
            return Ok(roll);
        }
        Err(NotEnoughTravel {
            asked_rad: roll,
            remaining,
        })
    }

    /// A roll by `amount` \[rad\] whose sense does not matter, as in a spinning phase: the
    /// sense with more travel left, so that successive phases alternate.
    ///
    /// # Errors
    /// Neither sense has enough travel.
    pub fn either(&self, q: f64, amount: f64) -> Result<f64, NotEnoughTravel> {
        let remaining = self.remaining(q);
        let sense = if remaining.positive >= remaining.negative {
            1.0
        } else {
            -1.0
        };
        self.admit(q, sense * amount.abs())
    }

    /// The shortest admissible roll that turns a bevel by `turn` \[rad\], full turns not
    /// counting: the short way, else the long way round.
    ///
    /// # Errors
    /// Neither way has enough travel.
    pub fn reorient(&self, q: f64, turn: f64) -> Result<f64, NotEnoughTravel> {
        let mut short = turn.rem_euclid(TAU);
        if short > PI {
            short -= TAU;
        }
        let long = short - TAU.copysign(short);
        self.admit(q, short)
            .or_else(|refused| self.admit(q, long).map_err(|_| refused))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const JOINT_6: JointLimit = JointLimit {
        lower: -TAU,
        upper: TAU,
        velocity: 10.0,
        acceleration: 40.0,
        jerk: 400.0,
    };

    #[test]
    fn forty_alternating_turns_stay_in_range_and_single_sense_is_refused() {
        let budget = TurnBudget::new(&JOINT_6, 0.01);
        let mut q = 0.3;
        for _ in 0..40 {
            q += budget.either(q, TAU).unwrap();
            assert!((-TAU..=TAU).contains(&q));
        }
        let mut turns = 0;
        let refused = loop {
            match budget.admit(q, TAU) {
                Ok(roll) => q += roll,
                Err(refused) => break refused,
            }
            turns += 1;
        };
        assert!(turns <= 1);
        assert!((refused.remaining.positive - (TAU - 0.01 - q)).abs() < 1e-12);
        assert!(refused.to_string().contains("refused"));
        assert!(budget.admit(q, f64::NAN).is_err());
    }

    #[test]
    fn reorientation_goes_the_long_way_round_at_the_end_of_the_travel() {
        let budget = TurnBudget::new(&JOINT_6, 0.0);
        assert!((budget.reorient(0.0, 1.5 * PI).unwrap() + 0.5 * PI).abs() < 1e-12);
        let roll = budget.reorient(TAU - 0.1, 0.5).unwrap();
        assert!((roll - (0.5 - TAU)).abs() < 1e-12);
        assert!(budget.reorient(1.0, 0.0).unwrap().abs() < 1e-15);
    }
}
