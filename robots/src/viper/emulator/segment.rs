//! Pieces of motion in closed form.

use std::time::Duration;

use hal::{JointLimits, Joints, Stamp};

use crate::viper::trapezoid::fastest;

/// One piece of motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Segment {
    pub(super) start: Stamp,
    pub(super) duration: Duration,
    from: Joints,
    profile: Profile,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Profile {
    /// All joints together over `by`, speeding up and slowing down for `ramp` seconds each.
    Trapezoid { by: Joints, ramp: f64 },
    /// At constant rates.
    Linear { rates: Joints },
    /// From these rates to rest.
    Brake { rates: Joints },
}

impl Segment {
    /// The fastest move that the limits of speed and acceleration allow.
    pub(super) fn trapezoid(start: Stamp, from: Joints, to: &Joints, limits: &JointLimits) -> Self {
        let by = to.zip(&from, |to, from| to - from);
        let (seconds, ramp) = fastest(&by, limits);
        Self {
            start,
            duration: Duration::from_secs_f64(seconds),
            from,
            profile: Profile::Trapezoid { by, ramp },
        }
    }

    /// A move in the given time.
    pub(super) fn linear(start: Stamp, from: Joints, to: &Joints, duration: Duration) -> Self {
        let seconds = duration.as_secs_f64().max(1e-9);
        let rates = to.zip(&from, |to, from| (to - from) / seconds);
        Self {
            start,
            duration,
            from,
            profile: Profile::Linear { rates },
        }
    }

    /// The hardest stop that the accelerations allow, without a change of direction.
    pub(super) fn brake(start: Stamp, from: Joints, rates: Joints, limits: &JointLimits) -> Self {
        let seconds = rates
            .iter()
            .zip(limits)
            .map(|(rate, limit)| rate.abs() / limit.acceleration)
            .fold(0.0, f64::max);
        Self {
            start,
            duration: Duration::from_secs_f64(seconds),
            from,
            profile: Profile::Brake { rates },
        }
    }

    pub(super) fn end(&self) -> Stamp {
        self.start + self.duration
    }

    /// Positions and rates at a time; those of the end afterwards, at rest.
    pub(super) fn at(&self, now: Stamp) -> (Joints, Joints) {
        let whole = self.duration.as_secs_f64();
        let ended = now >= self.end();
        let t = if ended {
            whole
        } else {
            now.secs_since(self.start).max(0.0)
        };
        let (positions, rates) = match self.profile {
            Profile::Trapezoid { by, ramp } => {
                let (share, speed) = trapezoid(t, whole, ramp);
                (
                    self.from.zip(&by, |q, by| q + by * share),
                    by.map(|by| by * speed),
                )
            }
            Profile::Linear { rates } => (self.from.zip(&rates, |q, rate| q + rate * t), rates),
            Profile::Brake { rates } if whole > 0.0 => (
                self.from
                    .zip(&rates, |q, rate| q + rate * t * (1.0 - 0.5 * t / whole)),
                rates.map(|rate| rate * (1.0 - t / whole)),
            ),
            Profile::Brake { rates } => (self.from, rates.zeroed()),
        };
        (positions, if ended { rates.zeroed() } else { rates })
    }
}

/// Share of the way and its speed \[1/s\] after `t` of `whole` seconds.
fn trapezoid(t: f64, whole: f64, ramp: f64) -> (f64, f64) {
    if t >= whole || ramp <= 0.0 {
        return (1.0, 0.0);
    }
    let top = 1.0 / (whole - ramp);
    if t < ramp {
        (0.5 * top * t * t / ramp, top * t / ramp)
    } else if t > whole - ramp {
        let left = whole - t;
        (1.0 - 0.5 * top * left * left / ramp, top * left / ramp)
    } else {
        (top * (t - 0.5 * ramp), top)
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "standstill is exactly zero")]
mod tests {
    use super::*;
    use crate::viper::viper_limits;

    #[test]
    fn trapezoids_reach_their_end_within_speed_and_acceleration() {
        let limits = viper_limits();
        let from = Joints::from([0.1, -0.2, 0.3, 0.0, 1.0, -2.0]);
        for size in [1e-4, 0.03, 1.0] {
            let to = from.zip(&Joints::from([1.0, -0.5, 0.2, 0.0, 0.7, 0.9]), |q, d| {
                q + size * d
            });
            let segment = Segment::trapezoid(Stamp::ZERO, from, &to, &limits);
            let steps = 1000;
            let mut before = segment.at(Stamp::ZERO).1;
            let h = segment.duration.as_secs_f64() / f64::from(steps);
            for step in 1..=steps {
                let (_, rates) = segment.at(Stamp::from_secs(h * f64::from(step)));
                for joint in 0..6 {
                    assert!(rates[joint].abs() <= limits[joint].velocity * (1.0 + 1e-9));
                    // Stamps are whole nanoseconds: a relative 1e-9 / h of a step.
                    let change = (rates[joint] - before[joint]).abs() / h;
                    assert!(
                        change <= limits[joint].acceleration * (1.0 + 1e-3),
                        "{change}"
                    );
                }
                before = rates;
            }
            let (end, rest) = segment.at(segment.end());
            assert!(end.zip(&to, |a, b| a - b).max_abs() < 1e-15);
            assert_eq!(rest.max_abs(), 0.0);
        }
    }

    #[test]
    fn brakes_stop_on_the_line_of_motion() {
        let limits = viper_limits();
        let rates = Joints::from([0.4, -0.2, 0.0, 0.0, 0.1, 2.0]);
        let brake = Segment::brake(Stamp::ZERO, rates.zeroed(), rates, &limits);
        let (end, rest) = brake.at(brake.end());
        assert_eq!(rest.max_abs(), 0.0);
        // Joint 1 is the slowest to stop: v^2 / 2 a.
        assert!((end[0] - 0.4 * 0.4 / 8.0).abs() < 1e-9);
        assert!((end[5] / end[0] - 5.0).abs() < 1e-9);
    }
}
