//! Duty cycling: eqs. (21)-(24) and the cycle's state machine.

use core::f64::consts::TAU;

use nalgebra::Vector3;

use crate::tasks::wrap;
use crate::view::RollTravel;

/// Duty cycle DC that turns the natural curvature into the effective one \[1/m\], within
/// 0 (insertion only) to 1 (spinning only): eq. (21) solved for DC.
pub fn duty_cycle(effective_curvature: f64, natural_curvature: f64) -> f64 {
    if natural_curvature > 0.0 {
        (1.0 - effective_curvature / natural_curvature).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

/// Angle between the desired tip velocity and the tip axis \[rad\]: Eq. (22).
pub fn heading_angle(desired: &Vector3<f64>) -> f64 {
    desired.x.hypot(desired.y).atan2(desired.z)
}

/// Angle by which one cycle of pure insertion turns the tip \[rad\]: Eq. (23).
pub fn cycle_angle(natural_curvature: f64, cycle_length: f64) -> f64 {
    natural_curvature * cycle_length
}

/// Curvature that aligns the tip within one cycle \[1/m\]: Eq. (24).
pub fn effective_curvature(heading: f64, cycle_length: f64) -> f64 {
    heading / cycle_length
}

/// Travel with which a spinning phase alternates where there is not enough for a full turn \[rad\]: what
/// a joint of 300 degrees has left within its reserves.
const SWEEP: f64 = 5.0;

/// A duty cycle in progress.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cycle {
    duty: f64,
    /// Signed rotations of the spinning phase, one after the other \[rad\].
    turns: [f64; 3],
    /// The one under way, and how far it has come \[rad\].
    turn: usize,
    turned: f64,
    /// Length of needle inserted in the spinning phase, and in the translation phase \[m\].
    spin_length: f64,
    insert_length: f64,
    advanced: f64,
}

/// What a cycle wants now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phase {
    /// Speed of insertion \[m/s\].
    pub speed: f64,
    /// Spin about the needle's axis \[rad/s\].
    pub spin: f64,
    /// Whether this is the spinning phase.
    pub spinning: bool,
}

impl Cycle {
    /// Plans a cycle of `length` \[m\] with duty cycle `duty` (0 to 1). The spinning phase makes
    /// one turn and takes out sigma, so that the bevel faces the desired way in the translation
    /// phase. `sense` (sign) is preferred; the other one is taken where the travel asks for it.
    /// Where neither fits, the spinning phase goes from the nearer end of the travel to the other
    /// one and back to where the bevel faces the desired way, or as near as it can; `None` where
    /// the travel is too short for that.
    pub fn plan(
        duty: f64,
        length: f64,
        sigma: f64,
        sense: f64,
        travel: &RollTravel,
    ) -> Option<Self> {
        let turns = [sense.signum(), -sense.signum()]
            .into_iter()
            .map(|s| s * TAU - wrap(sigma))
            .find(|&turn| travel.allows(turn))
            .map(|turn| [turn, 0.0, 0.0])
            .or_else(|| to_and_fro(wrap(-sigma), travel))?;
        let duty = duty.clamp(0.0, 1.0);
        Some(Self {
            duty,
            turns,
            turn: 0,
            spin_length: duty * length,
            insert_length: (1.0 - duty) * length,
            turned: 0.0,
            advanced: 0.0,
        })
    }

    /// The duty cycle in force.
    pub fn duty(&self) -> f64 {
        self.duty
    }

    /// Sense of the spinning phase: +1 or -1.
    pub fn sense(&self) -> f64 {
        self.turns[0].signum()
    }

    /// Whether both phases are over.
    pub fn is_done(&self) -> bool {
        self.spin_is_done() && self.advanced >= self.insert_length - 1e-9
    }

    fn spin_is_done(&self) -> bool {
        let over = |turn: usize| {
            let done = if turn == self.turn { self.turned } else { 0.0 };
            (self.turns[turn] - done).abs() < 1e-6
        };
        (self.turn..self.turns.len()).all(over)
    }

    /// The motion for the next `dt` \[s\], which is taken as executed: at most `speed` \[m/s\]
    /// and `omega_z_max` \[rad/s\]. In the spinning phase rotation and insertion keep their
    /// ratio, whichever of the two limits acts.
    pub fn advance(&mut self, speed: f64, omega_z_max: f64, dt: f64) -> Phase {
        if dt <= 0.0 || speed <= 0.0 || omega_z_max <= 0.0 {
            return Phase {
                speed: 0.0,
                spin: 0.0,
                spinning: !self.spin_is_done(),
            };
        }
        if self.spin_is_done() {
            let left = (self.insert_length - self.advanced).max(0.0);
            let step = left.min(speed * dt);
            self.advanced += step;
            return Phase {
                speed: step / dt,
                spin: 0.0,
                spinning: false,
            };
        }
        let whole: f64 = self.turns.iter().map(|turn| turn.abs()).sum();
        let duration = (whole / omega_z_max).max(self.spin_length / speed);
        if (self.turns[self.turn] - self.turned).abs() < 1e-6 {
            self.turn += 1;
            self.turned = 0.0;
        }
        let left = self.turns[self.turn] - self.turned;
        let step = left.signum() * left.abs().min(whole / duration * dt);
        self.turned += step;
        Phase {
            speed: self.spin_length * (step.abs() / whole) / dt,
            spin: step / dt,
            spinning: true,
        }
    }
}

/// The rotations of a spinning phase that ends `wish` \[rad\] from here, or at the end next to it.
fn to_and_fro(wish: f64, travel: &RollTravel) -> Option<[f64; 3]> {
    if travel.total() < SWEEP {
        return None;
    }
    let (near, far) = if travel.positive < travel.negative {
        (travel.positive, -travel.negative)
    } else {
        (-travel.negative, travel.positive)
    };
    let last = [wish, wish - wish.signum() * TAU]
        .into_iter()
        .find(|&turn| travel.allows(turn))
        .unwrap_or_else(|| travel.end_next_to(wish));
    Some([near, far - near, last - far])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FREE: RollTravel = RollTravel {
        positive: 20.0,
        negative: 20.0,
    };

    #[test]
    fn curvature_is_linear_in_the_duty_cycle() {
        assert!((duty_cycle(0.5, 2.0) - 0.75).abs() < 1e-15);
        assert!(duty_cycle(3.0, 2.0).abs() < 1e-15);
        assert!(duty_cycle(1.0, 0.0).abs() < 1e-15);
    }

    #[test]
    fn aligning_within_a_cycle_asks_for_the_curvature_of_eq_24() {
        let heading = heading_angle(&Vector3::new(3e-3, 4e-3, 1.0));
        assert!((heading - 5e-3_f64.atan2(1.0)).abs() < 1e-15);
        let limit = cycle_angle(2.0, 3e-3);
        assert!((limit - 6e-3).abs() < 1e-15);
        // Heading equal to the limit: full curvature, no spinning.
        let k = effective_curvature(limit, 3e-3);
        assert!(duty_cycle(k, 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_cycle_without_travel_is_refused() {
        let travel = RollTravel {
            positive: 1.0,
            negative: 1.0,
        };
        assert_eq!(Cycle::plan(0.5, 3e-3, 0.1, 1.0, &travel), None);
        let travel = RollTravel {
            positive: 1.0,
            negative: 7.0,
        };
        assert!(Cycle::plan(0.5, 3e-3, 0.1, 1.0, &travel).unwrap().sense() < 0.0);
    }

    #[test]
    fn without_travel_for_a_turn_a_cycle_goes_to_and_fro() {
        for (positive, negative, sigma) in [(2.6, 2.6, 0.4), (0.0, 5.2, 0.4), (5.2, 0.0, -0.7)] {
            let travel = RollTravel { positive, negative };
            let mut cycle = Cycle::plan(0.5, 3e-3, sigma, 1.0, &travel).unwrap();
            let (mut at, mut inserted, dt) = (0.0, 0.0, 0.01);
            let (mut lowest, mut highest, mut steps) = (0.0_f64, 0.0_f64, 0);
            while !cycle.is_done() && steps < 10_000 {
                let phase = cycle.advance(1e-3, TAU, dt);
                assert!(phase.spin.abs() <= TAU * (1.0 + 1e-9) && phase.speed <= 1e-3 + 1e-12);
                at += phase.spin * dt;
                inserted += phase.speed * dt;
                (lowest, highest) = (lowest.min(at), highest.max(at));
                steps += 1;
            }
            assert!(cycle.is_done());
            assert!((inserted - 3e-3).abs() < 1e-8, "{inserted}");
            assert!((highest - positive).abs() < 1e-5 && (lowest + negative).abs() < 1e-5);
            let faces = wrap(at + sigma).abs();
            assert!(
                faces < 1e-5 || faces < 0.6 && !travel.allows(at + 0.1),
                "{faces}"
            );
        }
    }

    proptest! {
        #![proptest_config(crate::seeded())]

        /// A whole cycle inserts its length, turns 2 pi and takes out sigma, within both limits.
        #[test]
        fn a_cycle_keeps_its_promise(
            duty in 0.0_f64..1.0, sigma in -3.0_f64..3.0, sense in prop::bool::ANY,
            speed in 2e-4_f64..3e-3, omega in 0.3_f64..10.0, dt in 0.004_f64..0.05,
        ) {
            let sense = if sense { 1.0 } else { -1.0 };
            let mut cycle = Cycle::plan(duty, 3e-3, sigma, sense, &FREE).unwrap();
            let (mut inserted, mut turned, mut steps) = (0.0, 0.0, 0);
            while !cycle.is_done() && steps < 100_000 {
                let phase = cycle.advance(speed, omega, dt);
                prop_assert!(phase.speed <= speed * (1.0 + 1e-9));
                prop_assert!(phase.spin.abs() <= omega * (1.0 + 1e-9));
                inserted += phase.speed * dt;
                turned += phase.spin * dt;
                steps += 1;
            }
            prop_assert!(cycle.is_done());
            prop_assert!((inserted - 3e-3).abs() < 1e-8);
            prop_assert!((turned - (sense * TAU - sigma)).abs() < 1e-5);
        }
    }
}
