//! Limits of position, speed, acceleration and jerk of all joints at once.

use core::time::Duration;

use super::axis::{Admissible, Axis, Bounds, Cause};
use super::binding::Binding;
use super::blend::Plane;
use super::motion::{Course, Limited, LimiterError, Motion};
use crate::telemetry::Limit;
use crate::{JointLimit, JointLimits, Joints, MAX_JOINTS};

/// Share of the command by which it may be missed and count as obeyed: rounding.
const ROUNDING: f64 = 1e-13;
/// Share of rates and accelerations that may point away from a line along which an arm moves:
/// rounding.
const STRAY: f64 = 1e-9;
/// Rounding allowed where the line of the command only just meets a limit, relative to rates.
const SLACK: f64 = 1e-14;

/// Pure limiter of joint rates; see [`Limiter::step`].
#[derive(Clone, Debug)]
pub struct Limiter {
    limits: Vec<JointLimit>,
    hold: f64,
}

impl Limiter {
    /// A limiter that keeps `margin` \[rad\] from the ends of every joint.
    ///
    /// `hold` is the longest time for which an arm keeps executing rates when the next command
    /// is late; braking starts early enough for that.
    ///
    /// # Errors
    /// Limits that are not positive, or that leave no range.
    pub fn new(limits: &JointLimits, margin: f64, hold: Duration) -> Result<Self, LimiterError> {
        if !(1..=MAX_JOINTS).contains(&limits.len()) {
            let joints = limits.len();
            return Err(LimiterError::Joints { joints });
        }
        if !(margin.is_finite() && margin >= 0.0) {
            let margin_rad = margin;
            return Err(LimiterError::Margin { margin_rad });
        }
        if hold.is_zero() {
            return Err(LimiterError::Hold);
        }
        let hold = hold.as_secs_f64();
        let mut kept = Vec::with_capacity(limits.len());
        for (joint, limit) in limits.iter().enumerate() {
            let dynamic = [limit.velocity, limit.acceleration, limit.jerk];
            if !dynamic.iter().all(|x| x.is_finite() && *x > 0.0) {
                return Err(LimiterError::NotPositive { joint });
            }
            let (lower, upper) = (limit.lower + margin, limit.upper - margin);
            let range_rad = upper - lower;
            // The hardest brake runs back by no more than this before it has died away.
            let back = limit.acceleration * limit.acceleration / (2.0 * limit.jerk);
            let needed = back * (2.0 * hold + 2.0 * back / limit.acceleration);
            if !(range_rad > needed && range_rad > 0.0) {
                return Err(LimiterError::Range { joint, range_rad });
            }
            kept.push(JointLimit {
                lower,
                upper,
                ..*limit
            });
        }
        Ok(Self { limits: kept, hold })
    }

    /// The limits kept: those given, less the margin.
    pub fn limits(&self) -> &JointLimits {
        &self.limits
    }

    /// The longest time for which rates may stand without a new command \[s\].
    pub fn hold(&self) -> f64 {
        self.hold
    }

    /// Rates for the coming period `dt` \[s\] of an arm at `positions` \[rad\] that executes
    /// `motion`, as close to `wanted` \[rad/s\] as the limits allow.
    ///
    /// * Rates change such that speed, acceleration (their change over `dt`) and jerk (the
    ///   change of that over `dt`) stay within the limits, and such that the arm can always
    ///   stop before the end of every joint. An arm that keeps executing what it is told never
    ///   passes an end, whatever is wanted.
    /// * The result is a multiple of `wanted` whenever the limits admit one, which they do unless
    ///   the arm moves in another direction already. On the way from one direction to another it
    ///   is a linear combination of motion and command, so that no third direction comes in;
    ///   only where a joint's end forbids that too, every joint goes for itself. See
    ///   [`Limited::course`].
    /// * An arm that stands outside its range is let back in, never further out.
    /// * Positions or rates that are not finite, or not one a joint, bring the arm to rest. A
    ///   period beyond the holding time counts as that.
    pub fn step(&self, positions: &Joints, motion: &Motion, wanted: &Joints, dt: f64) -> Limited {
        let joints = self.limits.len();
        let dt = self.period(dt);
        let usable = [positions, wanted]
            .iter()
            .all(|x| x.len() == joints && x.is_finite());
        if !usable {
            return self.stop(motion, dt);
        }
        let mut ranges = [None; MAX_JOINTS];
        for (i, range) in ranges.iter_mut().enumerate().take(self.limits.len()) {
            *range =
                Some(Self::axis(i, motion).admissible(&self.bounds(i, positions), dt, self.hold));
        }
        self.along_line(positions, motion, wanted, dt, &ranges)
            .or_else(|| {
                let target = self.attainable(motion, wanted, dt, &ranges);
                self.blended(motion, &target, dt, &ranges)
            })
            .or_else(|| {
                let rest = (wanted.zeroed(), nearest_end(&ranges));
                self.blended(motion, &rest, dt, &ranges)
            })
            .unwrap_or_else(|| self.joint_by_joint(motion, wanted, dt, &ranges))
    }

    /// An invalid period, or one beyond the holding time, counts as the holding time.
    pub(super) fn period(&self, dt: f64) -> f64 {
        if dt > 0.0 {
            dt.min(self.hold)
        } else {
            self.hold
        }
    }

    /// `wanted`, slowed to what every joint can do, and the limit that slows it. A joint that is
    /// stopped by its end slows all: else the others would go on as they did.
    fn attainable(
        &self,
        motion: &Motion,
        wanted: &Joints,
        dt: f64,
        ranges: &[Option<Admissible>; MAX_JOINTS],
    ) -> (Joints, Option<Limit>) {
        let (mut scale, mut slowed) = (1.0, None);
        let joints = self.limits.iter().zip(ranges.iter().flatten()).enumerate();
        for ((i, (limit, range)), joint) in joints.zip(0_u8..) {
            let (rate, x) = (motion.rates[i], wanted[i]);
            let mut consider = |most: f64, by: Limit| {
                if most < scale * x.abs() {
                    (scale, slowed) = (most / x.abs(), Some(by));
                }
            };
            consider(limit.velocity, Limit::JointVelocity(joint));
            if x > 0.0 && range.high_cause == Cause::Position {
                let most = (rate + range.high * dt).max(0.0);
                consider(most, Limit::JointPosition(joint));
            } else if x < 0.0 && range.low_cause == Cause::Position {
                let most = (-rate - range.low * dt).max(0.0);
                consider(most, Limit::JointPosition(joint));
            }
        }
        (wanted.map(|x| x * scale), slowed)
    }

    /// Towards a target ([`Limiter::attainable`]) in the plane of what the arm does and what it shall do, if the joints'
    /// limits admit a point of it.
    fn blended(
        &self,
        motion: &Motion,
        (target, slowed): &(Joints, Option<Limit>),
        dt: f64,
        ranges: &[Option<Admissible>; MAX_JOINTS],
    ) -> Option<Limited> {
        let change = target.zip(&motion.rates, |to, from| to - from);
        let axis = Axis {
            velocity: 0.0,
            acceleration: 0.0,
        };
        // The joint that limits the jerk along the change.
        let (slowest, jerk) = (0_u8..)
            .zip(self.limits.iter().zip(change.iter()))
            .map(|(i, (limit, x))| (i, limit.jerk / x.abs()))
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        let plane = Plane::new(&change, &motion.accelerations, axis.towards(1.0, jerk, dt));
        let chosen = plane.closest(ranges.iter().flatten())?;
        let mut rates = motion.rates;
        for (i, range) in ranges.iter().flatten().enumerate() {
            rates[i] += chosen.accelerations[i].clamp(range.low, range.high) * dt;
        }
        let missed = rates.zip(target, |x, target| x - target).max_abs();
        if missed <= ROUNDING * (1.0 + target.max_abs()) {
            return Some(Limited {
                rates: *target,
                limits: slowed.iter().copied().collect(),
                course: Course::Straight,
            });
        }
        let mut limits = Vec::new();
        for (joint, (i, range)) in (0_u8..).zip(ranges.iter().flatten().enumerate()) {
            let binding = Binding::all(joint);
            if chosen.held.contains(&(i, true)) {
                limits.push(binding.limit(range.high_cause, true));
            } else if chosen.held.contains(&(i, false)) {
                limits.push(binding.limit(range.low_cause, false));
            }
        }
        if limits.is_empty() {
            limits.push(Limit::JointJerk(slowest));
        }
        Some(Limited {
            rates,
            limits,
            course: Course::Blended,
        })
    }

    /// The way to rest when nothing else is known.
    fn stop(&self, motion: &Motion, dt: f64) -> Limited {
        let mut anywhere = motion.rates.zeroed();
        for (q, limit) in anywhere.iter_mut().zip(&self.limits) {
            *q = 0.5 * (limit.lower + limit.upper);
        }
        let rest = motion.rates.zeroed();
        self.step(&anywhere, motion, &rest, dt)
    }

    fn axis(i: usize, motion: &Motion) -> Axis {
        Axis {
            velocity: motion.rates[i],
            acceleration: motion.accelerations[i],
        }
    }

    fn bounds(&self, i: usize, positions: &Joints) -> Bounds {
        let limit = &self.limits[i];
        Bounds {
            velocity: limit.velocity,
            acceleration: limit.acceleration,
            jerk: limit.jerk,
            up: limit.upper - positions[i],
            down: positions[i] - limit.lower,
        }
    }

    /// All joints together along the line of the command (of the motion, to stop), if that is
    /// where the arm moves or it stands, and if the joints' own limits admit a point of it.
    fn along_line(
        &self,
        positions: &Joints,
        motion: &Motion,
        wanted: &Joints,
        dt: f64,
        ranges: &[Option<Admissible>; MAX_JOINTS],
    ) -> Option<Limited> {
        let stopping = wanted.iter().all(|x| *x == 0.0);
        if stopping && motion.is_rest() {
            return Some(Limited {
                rates: wanted.zeroed(),
                limits: Vec::new(),
                course: Course::Straight,
            });
        }
        let (line, target) = if stopping {
            (&motion.rates, 0.0)
        } else {
            (wanted, 1.0)
        };
        let squared: f64 = line.iter().map(|x| x * x).sum();
        if squared <= f64::MIN_POSITIVE || !squared.is_finite() {
            return None;
        }
        let along = |x: &Joints| x.iter().zip(line.iter()).map(|(x, l)| x * l).sum::<f64>();
        let axis = Axis {
            velocity: along(&motion.rates) / squared,
            acceleration: along(&motion.accelerations) / squared,
        };
        let off = |x: &Joints, share: f64| x.zip(line, |x, l| x - share * l).max_abs();
        let astray =
            off(&motion.rates, axis.velocity) + off(&motion.accelerations, axis.acceleration) * dt;
        let fast = motion.rates.max_abs() + motion.accelerations.max_abs() * dt;
        if astray > STRAY * fast + ROUNDING {
            return None;
        }
        let (bounds, joint_of) = self.bounds_along(line, positions);
        let range = axis.admissible(&bounds, dt, self.hold);
        let ideal = axis.towards(target, bounds.jerk, dt);
        let mut factor = axis.velocity + ideal.clamp(range.low, range.high) * dt;
        let cause = if ideal > range.high {
            joint_of.limit(range.high_cause, true)
        } else if ideal < range.low {
            joint_of.limit(range.low_cause, false)
        } else {
            joint_of.limit(Cause::Jerk, true)
        };
        if (factor - target).abs() <= ROUNDING {
            factor = target;
        }

        // What each joint admits, as an interval of the line.
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        for (i, range) in ranges.iter().enumerate() {
            let Some(range) = range else { break };
            let slack = SLACK * (1.0 + motion.rates[i].abs());
            let from = motion.rates[i] + range.low * dt - slack;
            let to = motion.rates[i] + range.high * dt + slack;
            let x = line[i];
            if x == 0.0 {
                if from > 0.0 || to < 0.0 {
                    return None;
                }
                continue;
            }
            let (a, b) = (from / x, to / x);
            low = low.max(a.min(b));
            high = high.min(a.max(b));
        }
        if low > high {
            return None;
        }
        let factor = factor.clamp(low, high);
        let limits = if (factor - target).abs() <= ROUNDING {
            Vec::new()
        } else {
            vec![cause]
        };
        Some(Limited {
            rates: line.map(|x| x * factor),
            limits,
            course: Course::Straight,
        })
    }

    /// Limits along a line in the space of joint rates, in multiples of `line`, and the joints
    /// that set them.
    fn bounds_along(&self, line: &Joints, positions: &Joints) -> (Bounds, Binding) {
        let mut bounds = Bounds {
            velocity: f64::INFINITY,
            acceleration: f64::INFINITY,
            jerk: f64::INFINITY,
            up: f64::INFINITY,
            down: f64::INFINITY,
        };
        let mut binding = Binding::default();
        for (i, (limit, x)) in (0_u8..).zip(self.limits.iter().zip(line.iter())) {
            let size = x.abs();
            if size == 0.0 {
                continue;
            }
            let to_upper = (limit.upper - positions[usize::from(i)]) / size;
            let to_lower = (positions[usize::from(i)] - limit.lower) / size;
            let (up, down) = if *x > 0.0 {
                (to_upper, to_lower)
            } else {
                (to_lower, to_upper)
            };
            for (bound, value, joint) in [
                (
                    &mut bounds.velocity,
                    limit.velocity / size,
                    &mut binding.velocity,
                ),
                (
                    &mut bounds.acceleration,
                    limit.acceleration / size,
                    &mut binding.acceleration,
                ),
                (&mut bounds.jerk, limit.jerk / size, &mut binding.jerk),
                (&mut bounds.up, up, &mut binding.up),
                (&mut bounds.down, down, &mut binding.down),
            ] {
                if value < *bound {
                    *bound = value;
                    *joint = i;
                }
            }
        }
        (bounds, binding)
    }

    /// Every joint for itself, all arriving at about the same time.
    fn joint_by_joint(
        &self,
        motion: &Motion,
        wanted: &Joints,
        dt: f64,
        ranges: &[Option<Admissible>; MAX_JOINTS],
    ) -> Limited {
        let (target, _) = self.attainable(motion, wanted, dt, ranges);
        let duration = |i: usize| {
            let (limit, change) = (&self.limits[i], (target[i] - motion.rates[i]).abs());
            let ramp = limit.acceleration / limit.jerk;
            if change > limit.acceleration * ramp {
                change / limit.acceleration + ramp
            } else {
                2.0 * (change / limit.jerk).sqrt()
            }
        };
        let longest = (0..self.limits.len()).map(duration).fold(dt, f64::max);
        let mut rates = motion.rates;
        let mut limits = Vec::new();
        for (i, limit) in (0_u8..).zip(&self.limits) {
            let joint = usize::from(i);
            let Some(range) = ranges[joint] else { break };
            let slowness = duration(joint) / longest;
            let axis = Self::axis(joint, motion);
            let most = limit.acceleration * slowness;
            let ideal = axis
                .towards(target[joint], limit.jerk * slowness * slowness, dt)
                .clamp(-most, most);
            rates[joint] += ideal.clamp(range.low, range.high) * dt;
            if ideal > range.high {
                limits.push(Binding::all(i).limit(range.high_cause, true));
            } else if ideal < range.low {
                limits.push(Binding::all(i).limit(range.low_cause, false));
            } else if (rates[joint] - wanted[joint]).abs() > ROUNDING {
                limits.push(Limit::JointJerk(i));
            }
        }
        Limited {
            rates,
            limits,
            course: Course::Apart,
        }
    }
}

/// The limit for which an arm brakes: that of a joint close to its end, or else of any.
fn nearest_end(ranges: &[Option<Admissible>; MAX_JOINTS]) -> Option<Limit> {
    let bounds = (0_u8..)
        .zip(ranges.iter().flatten())
        .flat_map(|(joint, range)| {
            let binding = Binding::all(joint);
            [
                binding.limit(range.high_cause, true),
                binding.limit(range.low_cause, false),
            ]
        });
    let is_end = |limit: &Limit| matches!(limit, Limit::JointPosition(_));
    let mut rest = bounds.clone();
    bounds.into_iter().find(is_end).or_else(|| rest.next())
}
