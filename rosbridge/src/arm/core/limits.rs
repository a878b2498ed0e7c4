//! Whether a command needs no limiting.

use hal::guarded::Motion;
use hal::{Joints, Limiter};

/// Room for rounding in limits that another guard has kept.
const ROUNDING: f64 = 1.0 + 1e-6;

/// Periods within which any arm can stop.
const LONGEST_STOP: usize = 256;

/// Whether an arm that executes `motion` may go on with `wanted` for `period` \[s\] as it is:
/// speed, acceleration and jerk are kept, and after it the arm can stop before every end.
pub(super) fn keeps_limits(
    limiter: &Limiter,
    positions: &Joints,
    motion: &Motion,
    wanted: &Joints,
    period: f64,
) -> bool {
    let accelerations = wanted.zip(&motion.rates, |new, old| (new - old) / period);
    let jerks = accelerations.zip(&motion.accelerations, |new, old| (new - old) / period);
    let gentle = limiter.limits().iter().enumerate().all(|(i, limit)| {
        wanted[i].abs() <= limit.velocity * ROUNDING
            && accelerations[i].abs() <= limit.acceleration * ROUNDING
            && jerks[i].abs() <= limit.jerk * ROUNDING
    });
    let after = Motion {
        rates: *wanted,
        accelerations,
    };
    let next = positions.zip(wanted, |q, rate| q + rate * period);
    gentle && stops_in_time(limiter, next, after, period)
}

fn stops_in_time(limiter: &Limiter, mut q: Joints, mut motion: Motion, period: f64) -> bool {
    let inside = |q: &Joints| {
        let mut joints = q.iter().zip(limiter.limits());
        joints.all(|(q, limit)| (limit.lower..=limit.upper).contains(q))
    };
    let rest = q.zeroed();
    for _ in 0..LONGEST_STOP {
        if !inside(&q) {
            return false;
        }
        if motion.is_rest() {
            return true;
        }
        let rates = limiter.step(&q, &motion, &rest, period).rates;
        motion = Motion {
            rates,
            accelerations: rates.zip(&motion.rates, |new, old| (new - old) / period),
        };
        q = q.zip(&rates, |q, rate| q + rate * period);
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::JointLimit;
    use std::time::Duration;

    #[test]
    fn a_command_within_every_limit_passes_and_no_other() {
        let limits = [JointLimit {
            lower: -2.0,
            upper: 2.0,
            velocity: 1.0,
            acceleration: 20.0,
            jerk: 2000.0,
        }];
        let joint = |q: f64| Joints::from_slice(&[q]).unwrap();
        let limiter = Limiter::new(&limits, 0.0, Duration::from_millis(16)).unwrap();
        let passes = |q: f64, motion: f64, wanted: f64| {
            keeps_limits(
                &limiter,
                &joint(q),
                &Motion::steady(joint(motion)),
                &joint(wanted),
                0.016,
            )
        };
        assert!(passes(0.0, 0.5, 0.5) && passes(0.0, 0.5, 0.7));
        assert!(!passes(0.0, 0.99, 1.01), "speed");
        assert!(!passes(0.0, 0.0, 0.4), "acceleration");
        assert!(
            passes(1.9, 0.9, 0.9) && !passes(1.99, 0.9, 0.9),
            "an end ahead"
        );
        assert!(!passes(0.0, 0.5, f64::NAN));
    }
}
