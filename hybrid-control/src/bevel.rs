//! Bevel modulation by curvature debt: a sigma-delta modulator in space.
//!
//! The bevel bends the path by a curvature of fixed size in the direction that it faces. The
//! debt is what the plan has asked for and the bevel has not yet given, in metres of full
//! curvature. The bevel stays where it is until the debt exceeds a threshold that its present
//! direction does not pay off; then it turns to face the debt. Any direction and any curvature
//! from nothing to all come out on average, lag and turning included, and the needle never winds
//! up.

use nalgebra::{Rotation2, Vector2};

use crate::tasks::wrap;
use crate::view::RollTravel;

/// Speed of turning falls linearly below this remaining angle \[rad\], as eq. (15) does below
/// pi/4.
const SLOW_DOWN: f64 = 0.3;

/// Angle from the end of the travel within which the bevel stands at it \[rad\].
const AT_END: f64 = 0.1;

/// Angle before its wish at which a bevel may come to the end of the travel \[rad\]: it still gives
/// 97 % of its curvature there.
const JUST_BEFORE: f64 = 0.25;

/// Remaining angle below which a turn is over \[rad\].
const ARRIVED: f64 = 0.01;

/// The modulator's state.
#[derive(Clone, Debug, PartialEq)]
pub struct BevelModulator {
    /// Debt above which the bevel turns \[m\].
    threshold: f64,
    /// What the bevel has not given yet \[m\].
    debt: Vector2<f64>,
    /// Rotation that is still to be made \[rad\], signed.
    remaining: f64,
    turning: bool,
}

impl BevelModulator {
    /// A modulator without debt; `threshold` is e_h \[m\].
    pub fn new(threshold: f64) -> Self {
        Self {
            threshold,
            debt: Vector2::zeros(),
            remaining: 0.0,
            turning: false,
        }
    }

    /// The debt \[m of full curvature\].
    pub fn debt(&self) -> Vector2<f64> {
        self.debt
    }

    /// Whether a turn is under way.
    pub fn is_turning(&self) -> bool {
        self.turning
    }

    /// Forgets debt and turn.
    pub fn reset(&mut self) {
        *self = Self::new(self.threshold);
    }

    /// Books `advance` \[m\] of insertion with the bevel at `azimuth` \[rad\] and `wanted`
    /// curvature (fraction of the full one, norm at most 1), and answers the spin \[rad/s\]
    /// for the next `dt` \[s\].
    ///
    /// Azimuths grow with positive spin. `travel` bounds the turns.
    pub fn step(
        &mut self,
        wanted: &Vector2<f64>,
        azimuth: f64,
        advance: f64,
        travel: &RollTravel,
        omega_max: f64,
        dt: f64,
    ) -> f64 {
        let present = Rotation2::new(azimuth) * Vector2::x();
        let wanted = wanted.cap_magnitude(1.0);
        self.debt += (wanted - present) * advance.max(0.0);
        self.debt = self.debt.cap_magnitude(3.0 * self.threshold);
        let size = self.debt.norm();
        // The less curvature is to spare, the nearer the bevel must face the debt.
        let paying = present.dot(&self.debt) > (0.5 + 0.45 * wanted.norm()) * size;
        if size > self.threshold && (self.turning || !paying) {
            let wish = wrap(self.debt.y.atan2(self.debt.x) - azimuth);
            // Under way the target moves a little; the sense stays unless travel forbids it.
            let keep = self.turning && wish.signum() != self.remaining.signum() && wish.abs() > 1.0;
            let first = if keep { other_way(wish) } else { wish };
            self.remaining = if travel.allows(first) {
                first
            } else if let Some(end) = self.end_on_the_way(first, travel) {
                end
            } else if travel.allows(other_way(first)) {
                other_way(first)
            } else {
                self.end(wish, azimuth, travel)
            };
            self.turning = true;
        }
        if self.turning && self.remaining.abs() < ARRIVED {
            self.turning = false;
            self.remaining = 0.0;
        }
        if !self.turning || dt <= 0.0 {
            return 0.0;
        }
        let pace = (self.remaining.abs() / SLOW_DOWN).min(1.0) * omega_max;
        let spin = self.remaining.signum() * pace.min(self.remaining.abs() / dt);
        self.remaining -= spin * dt;
        spin
    }

    /// Under way, the end of the travel that lies just before `angle`. A wish that wavers about the
    /// ends of a joint with one turn would else send the bevel round and round.
    fn end_on_the_way(&self, angle: f64, travel: &RollTravel) -> Option<f64> {
        let end = angle.clamp(-travel.negative, travel.positive);
        let on = self.turning && angle.signum() == self.remaining.signum();
        (on && (angle - end).abs() < JUST_BEFORE).then_some(end)
    }

    /// Neither way is free: the end of the travel next to the debt. Where the debt lies between
    /// the ends, the bevel alternates between them, staying at each until the other one
    /// would pay off more than a threshold.
    fn end(&self, wish: f64, azimuth: f64, travel: &RollTravel) -> f64 {
        if self.turning {
            return if self.remaining < 0.0 {
                -travel.negative
            } else {
                travel.positive
            };
        }
        let pays = |end: f64| (Rotation2::new(azimuth + end) * Vector2::x()).dot(&self.debt);
        let next = travel.end_next_to(wish);
        let here = if travel.positive < travel.negative {
            travel.positive
        } else {
            -travel.negative
        };
        let stays = here.abs() < AT_END && pays(next) - pays(here) < self.threshold;
        if stays { here } else { next }
    }
}

/// The same direction reached the other way round.
fn other_way(angle: f64) -> f64 {
    angle - angle.signum() * core::f64::consts::TAU
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::PI;
    use proptest::prelude::*;

    /// Inserts 60 mm at 1 mm/s and returns the mean curvature given and the largest rotation.
    fn insert(wanted: Vector2<f64>, start: f64, omega: f64) -> (Vector2<f64>, f64) {
        insert_within(1.5 * PI, wanted, start, omega)
    }

    /// As [`insert`], with as much travel to either side of the start.
    fn insert_within(
        range: f64,
        wanted: Vector2<f64>,
        start: f64,
        omega: f64,
    ) -> (Vector2<f64>, f64) {
        let mut modulator = BevelModulator::new(0.75e-3);
        let (mut roll, mut given, mut extreme) = (0.0_f64, Vector2::zeros(), 0.0_f64);
        let (dt, speed) = (1.0 / 30.0, 1e-3);
        let steps = 1800;
        for _ in 0..steps {
            let travel = RollTravel {
                positive: range - roll,
                negative: range + roll,
            };
            let azimuth = start + roll;
            let spin = modulator.step(&wanted, azimuth, speed * dt, &travel, omega, dt);
            roll += spin * dt;
            extreme = extreme.max(roll.abs());
            given += Rotation2::new(start + roll) * Vector2::x() / f64::from(steps);
        }
        (given, extreme)
    }

    proptest! {
        #![proptest_config(crate::seeded())]
        /// Any wanted curvature inside the disc comes out on average: the debt stays bounded by
        /// a few thresholds, and so does its mean over 60 mm.
        #[test]
        fn mean_curvature_is_the_wanted_one(
            size in 0.0_f64..0.85, direction in -3.1_f64..3.1, start in -3.1_f64..3.1,
        ) {
            let wanted = Rotation2::new(direction) * Vector2::new(size, 0.0);
            let (given, extreme) = insert(wanted, start, 2.0 * PI);
            prop_assert!((given - wanted).norm() < 3.0 * 0.75 / 60.0 + 5e-3, "{given} {wanted}");
            prop_assert!(extreme <= 1.5 * PI + 1e-9);
        }
    }

    proptest! {
        #![proptest_config(crate::seeded())]
        /// With less than a turn in all, the bevel alternates between the ends for what lies
        /// beyond them, and not without pause.
        #[test]
        fn less_than_a_turn_steers_to_all_sides(
            size in 0.0_f64..0.6, direction in -3.1_f64..3.1, start in -3.1_f64..3.1,
            degrees in 147.0_f64..178.0,
        ) {
            let wanted = Rotation2::new(direction) * Vector2::new(size, 0.0);
            let range = degrees.to_radians();
            let (given, extreme) = insert_within(range, wanted, start, 2.0 * PI);
            prop_assert!((given - wanted).norm() < 3.0 * 0.75 / 60.0 + 2e-2, "{given} {wanted}");
            prop_assert!(extreme <= range + 1e-9);
        }
    }

    /// A joint with exactly one turn, its ends where the bevel is wanted.
    #[test]
    fn a_wish_that_wavers_about_the_ends_is_met() {
        for omega in [2.0 * PI, 1.0] {
            let mut modulator = BevelModulator::new(0.75e-3);
            let (mut roll, mut given, mut advanced) = (0.0_f64, 0.0, 0.0);
            let (dt, way) = (1.0 / 30.0, 1e-3 / 30.0);
            for step in 0..1800 {
                let waver = 0.06 * (f64::from(step) * 0.7).sin();
                let wanted = Rotation2::new(PI + waver) * Vector2::x();
                let travel = RollTravel {
                    positive: PI - roll,
                    negative: PI + roll,
                };
                // As the law does, insertion waits for a slow joint.
                let turning = if modulator.is_turning() {
                    omega / (2.0 * PI)
                } else {
                    1.0
                };
                roll += modulator.step(&wanted, roll, way * turning, &travel, omega, dt) * dt;
                advanced += turning;
                given += turning * (Rotation2::new(roll) * Vector2::x()).dot(&-Vector2::x());
            }
            assert!(
                given > 0.8 * advanced,
                "{given} of {advanced} at {omega} rad/s"
            );
        }
    }

    #[test]
    fn full_curvature_needs_one_turn_only() {
        let (given, _) = insert(Vector2::new(0.0, 1.0), 0.0, 2.0 * PI);
        assert!(given.y > 0.95, "{given}");
    }
}
