//! Motion along one line under limits of position, speed, acceleration and jerk.
//!
//! An acceleration is admissible if, after one period with it, braking as hard as the jerk and
//! acceleration limits allow still keeps speed and position within their limits. If that holds
//! now, the hardest brake is admissible next time too, for any period up to `hold`: so a limit,
//! once kept, is kept for ever. (Discrete velocities under the hardest brake stay below the
//! continuous ones; `stopping_distance` adds what a late command and the held velocity cost.)

/// Speed and acceleration along the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Axis {
    pub(super) velocity: f64,
    pub(super) acceleration: f64,
}

/// Limits along the line; the rooms are the distances left upwards and downwards.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) velocity: f64,
    pub(super) acceleration: f64,
    pub(super) jerk: f64,
    pub(super) up: f64,
    pub(super) down: f64,
}

/// What bounds an acceleration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cause {
    Position,
    Velocity,
    Acceleration,
    Jerk,
}

/// Admissible accelerations and what bounds them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Admissible {
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) low_cause: Cause,
    pub(super) high_cause: Cause,
}

/// Enough halvings to reach the resolution of an f64.
const BISECTIONS: usize = 52;

impl Axis {
    /// Accelerations that the limits admit for the coming period `dt` \[s\]; `hold` \[s\] is
    /// the longest time for which a velocity may stand.
    pub(super) fn admissible(&self, bounds: &Bounds, dt: f64, hold: f64) -> Admissible {
        let (high, high_cause) = self.highest(bounds, dt, hold);
        let (low, low_cause) = self.mirrored().highest(&bounds.mirrored(), dt, hold);
        // Both sides at once bind only in a range shorter than its own braking distances.
        let low = (-low).min(high);
        Admissible {
            low,
            high,
            low_cause,
            high_cause,
        }
    }

    fn highest(&self, bounds: &Bounds, dt: f64, hold: f64) -> (f64, Cause) {
        let step = bounds.jerk * dt;
        let floor = (self.acceleration - step).max(-bounds.acceleration);
        let rising = self.acceleration + step;
        let (top, cause) = if rising <= bounds.acceleration {
            (rising, Cause::Jerk)
        } else {
            (bounds.acceleration.max(floor), Cause::Acceleration)
        };
        let Some(violated) = self.violation(top, bounds, dt, hold) else {
            return (top, cause);
        };
        let (mut good, mut bad) = (floor, top);
        if floor < 0.0 && top > 0.0 {
            // Standing still stays exactly still.
            if self.violation(0.0, bounds, dt, hold).is_none() {
                good = 0.0;
            } else {
                bad = 0.0;
            }
        }
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (good + bad);
            if self.violation(middle, bounds, dt, hold).is_none() {
                good = middle;
            } else {
                bad = middle;
            }
        }
        (good, violated)
    }

    /// Which upper limit one period with `acceleration` would make unavoidable to break.
    fn violation(&self, acceleration: f64, bounds: &Bounds, dt: f64, hold: f64) -> Option<Cause> {
        let next = Self {
            velocity: self.velocity + acceleration * dt,
            acceleration,
        };
        if next.velocity + next.rise(bounds) > bounds.velocity {
            return Some(Cause::Velocity);
        }
        let needed = next.velocity * dt + next.stopping_distance(bounds, hold);
        (needed > bounds.up.max(0.0)).then_some(Cause::Position)
    }

    /// How much the velocity still rises while the acceleration is brought to zero.
    fn rise(&self, bounds: &Bounds) -> f64 {
        let a = self.acceleration.max(0.0);
        a * a / (2.0 * bounds.jerk)
    }

    /// How far upwards the hardest brake still goes, with every velocity held for up to `hold`.
    fn stopping_distance(&self, bounds: &Bounds, hold: f64) -> f64 {
        let rise = self.rise(bounds);
        let peak = self.velocity + rise;
        if peak <= 0.0 {
            return 0.0;
        }
        (peak + rise) * hold + self.brake(bounds)
    }

    /// Largest displacement while braking in continuous time: acceleration falling at the
    /// jerk limit to minus the acceleration limit, then constant.
    fn brake(&self, bounds: &Bounds) -> f64 {
        let (v, a) = (self.velocity, self.acceleration);
        let (a_max, jerk) = (bounds.acceleration, bounds.jerk);
        let ramp = ((a + a_max) / jerk).max(0.0);
        let v_ramp = v + a * ramp - 0.5 * jerk * ramp * ramp;
        let travelled = |t: f64| v * t + 0.5 * a * t * t - jerk * t * t * t / 6.0;
        let distance = if v_ramp > 0.0 {
            travelled(ramp) + v_ramp * v_ramp / (2.0 * a_max)
        } else {
            let discriminant = a * a + 2.0 * jerk * v;
            if discriminant < 0.0 {
                return 0.0;
            }
            travelled(((a + discriminant.sqrt()) / jerk).max(0.0))
        };
        distance.max(0.0)
    }

    fn mirrored(&self) -> Self {
        Self {
            velocity: -self.velocity,
            acceleration: -self.acceleration,
        }
    }

    /// The acceleration that reaches the velocity `target` soonest and arrives there without
    /// acceleration, for a constant period and under the jerk limit alone.
    ///
    /// With accelerations m, m-1, ... steps of `jerk * dt`, the velocity changes by
    /// (n+1) m - n (n+1) / 2 steps of `jerk * dt * dt`, n being the whole part of m.
    pub(super) fn towards(&self, target: f64, jerk: f64, dt: f64) -> f64 {
        let change = target - self.velocity;
        let quantum = jerk * dt * dt;
        if quantum <= 0.0 || !quantum.is_finite() {
            return change / dt;
        }
        let r = change.abs() / quantum;
        let n = (0.5 * ((1.0 + 8.0 * r).sqrt() - 1.0)).floor();
        let m = (r + 0.5 * n * (n + 1.0)) / (n + 1.0);
        change.signum() * m * jerk * dt
    }
}

impl Bounds {
    fn mirrored(&self) -> Self {
        Self {
            up: self.down,
            down: self.up,
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Bounds = Bounds {
        velocity: 2.0,
        acceleration: 4.0,
        jerk: 40.0,
        up: f64::INFINITY,
        down: f64::INFINITY,
    };

    #[test]
    fn target_is_reached_without_overshoot_and_without_acceleration() {
        let (dt, target) = (0.016, 0.3);
        let mut axis = Axis {
            velocity: 0.0,
            acceleration: 0.0,
        };
        for _ in 0..40 {
            let range = axis.admissible(&BOUNDS, dt, dt);
            let a = axis
                .towards(target, BOUNDS.jerk, dt)
                .clamp(range.low, range.high);
            axis = Axis {
                velocity: axis.velocity + a * dt,
                acceleration: a,
            };
            assert!(axis.velocity <= target + 1e-12);
        }
        assert!((axis.velocity - target).abs() < 1e-12);
        assert!(axis.acceleration.abs() < 1e-10);
    }

    #[test]
    fn braking_distance_is_that_of_the_integrated_brake() {
        let axis = Axis {
            velocity: 1.3,
            acceleration: 2.5,
        };
        let (mut v, mut a, mut x, h) = (axis.velocity, axis.acceleration, 0.0, 1e-6);
        while v > 0.0 {
            x += v * h;
            v += a * h;
            a = (a - BOUNDS.jerk * h).max(-BOUNDS.acceleration);
        }
        // Euler's rule: error of order speed times step.
        assert!((axis.brake(&BOUNDS) - x).abs() < 1e-5);
    }
}
