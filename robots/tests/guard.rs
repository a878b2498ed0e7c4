//! The guard against arbitrary commands: nothing that comes out breaks a limit.
#![expect(clippy::unwrap_used, reason = "a helper that fails fails its test")]

use core::time::Duration;

use hal::guarded::{Course, Guard, Limiter, Motion, SpeedCaps, Workspace};
use hal::telemetry::Limit;
use hal::{JointLimit, Joints};
use nalgebra::Point3;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use robots::arms::{NEEDLE_BASE, VIPER_S650};
use robots::kinematics::{Chain, RateSettings};

const PERIOD: f64 = 0.016;
const HOLD: Duration = Duration::from_millis(48);
const MARGIN: f64 = 0.5 * core::f64::consts::PI / 180.0;
/// Relative rounding of speeds and accelerations.
const ROUNDING: f64 = 1e-9;
/// Rounding of rates of order 10 [rad/s], which a jerk shows divided by the period squared.
const RATE_ROUNDING: f64 = 1e-13;

fn viper() -> Chain {
    Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap()
}

fn random(
    limits: &[JointLimit],
    rng: &mut impl Rng,
    f: impl Fn(&JointLimit, f64) -> f64,
) -> Joints {
    let values: Vec<f64> = limits
        .iter()
        .map(|limit| f(limit, rng.random_range(-1.0..1.0)))
        .collect();
    Joints::from_slice(&values).unwrap()
}

/// A command as a bad program might give it: any size, sudden, repeated, reversed, zero.
fn arbitrary(limits: &[JointLimit], previous: &Joints, rng: &mut impl Rng) -> Joints {
    match rng.random_range(0..10) {
        0..=3 => *previous,
        4 => previous.map(|x| -x),
        5 => previous.zeroed(),
        6 => previous.map(|x| x * 0.3),
        7 => {
            let size = 10.0_f64.powi(rng.random_range(-12..9));
            random(limits, rng, |_, share| size * share)
        }
        8 => {
            let mut one = previous.zeroed();
            let joint = rng.random_range(0..one.len());
            one[joint] = limits[joint].velocity * rng.random_range(-3.0..3.0);
            one
        }
        _ => random(limits, rng, |limit, share| limit.velocity * share),
    }
}

fn assert_kept(limits: &[JointLimit], before: &Motion, after: &Motion, q: &Joints, dt: f64) {
    for (i, limit) in limits.iter().enumerate() {
        let (speed, acceleration) = (after.rates[i], after.accelerations[i]);
        let jerk = (acceleration - before.accelerations[i]) / dt;
        let slack = 1.0 + ROUNDING;
        assert!(speed.abs() <= limit.velocity * slack, "speed {i}: {speed}");
        assert!(
            acceleration.abs() <= limit.acceleration * slack,
            "acceleration {i}: {acceleration}"
        );
        assert!(
            jerk.abs() <= limit.jerk * slack + RATE_ROUNDING / (dt * dt),
            "jerk {i}: {jerk}"
        );
        // The margin, to rounding; the end itself, exactly.
        let overshoot = (limit.lower + MARGIN - q[i]).max(q[i] - limit.upper + MARGIN);
        assert!(
            overshoot <= 1e-12,
            "position {i}: {overshoot:e} beyond the margin"
        );
        assert!((limit.lower..=limit.upper).contains(&q[i]));
    }
}

/// Sine of the angle between two vectors.
fn bend(a: &Joints, b: &Joints) -> f64 {
    let dot = |x: &Joints, y: &Joints| x.iter().zip(y.iter()).map(|(x, y)| x * y).sum::<f64>();
    let (aa, bb) = (dot(a, a), dot(b, b));
    if aa == 0.0 || bb == 0.0 {
        return 0.0;
    }
    let along = dot(a, b) / bb;
    let across = a.zip(b, |a, b| a - along * b);
    (dot(&across, &across) / aa).sqrt()
}

/// Part of `x` outside the span of some vectors, relative to the longest of all \[1\].
fn outside(x: &Joints, span: &[Joints]) -> f64 {
    let dot = |x: &Joints, y: &Joints| x.iter().zip(y.iter()).map(|(x, y)| x * y).sum::<f64>();
    let size = |x: &Joints| dot(x, x).sqrt();
    let mut basis: Vec<Joints> = Vec::new();
    let across = |x: &Joints, basis: &[Joints]| {
        // Twice, for the rounding of nearly parallel vectors.
        (0..2).fold(*x, |x, _| {
            basis.iter().fold(x, |x, b| {
                let along = dot(&x, b);
                x.zip(b, |x, b| x - along * b)
            })
        })
    };
    for vector in span {
        let rest = across(vector, &basis);
        let length = size(&rest);
        if length > 1e-12 * size(vector) && length > 0.0 {
            basis.push(rest.map(|x| x / length));
        }
    }
    let longest = span.iter().map(size).fold(size(x), f64::max);
    size(&across(x, &basis)) / longest.max(f64::MIN_POSITIVE)
}

#[test]
fn a_million_random_commands_break_no_joint_limit_and_keep_their_direction() {
    let chain = viper();
    let limits = chain.limits();
    let limiter = Limiter::new(limits, MARGIN, HOLD).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut q = Joints::from([0.0, -1.2, 2.4, 0.0, 0.9, 0.0]);
    let mut motion = Motion::steady(q.zeroed());
    let mut wanted = q.zeroed();
    let (mut straight, mut blended, mut apart) = (0, 0, 0);
    for _ in 0..1_000_000 {
        if rng.random_bool(0.1) {
            wanted = arbitrary(limits, &wanted, &mut rng);
        }
        let dt = rng.random_range(0.001..HOLD.as_secs_f64());
        let limited = limiter.step(&q, &motion, &wanted, dt);
        let after = Motion {
            rates: limited.rates,
            accelerations: limited
                .rates
                .zip(&motion.rates, |new, old| (new - old) / dt),
        };
        q = q.zip(&limited.rates, |q, rate| q + rate * dt);
        assert_kept(limits, &motion, &after, &q, dt);
        if limited.course == Course::Blended {
            let span = [motion.rates, motion.accelerations, wanted];
            let outside = outside(&limited.rates, &span);
            let size = span.iter().map(Joints::max_abs).fold(0.0, f64::max);
            assert!(
                outside < 1e-9 + RATE_ROUNDING / size.max(1e-12),
                "a third direction: {outside:e} of {span:?} {limited:?}"
            );
        }
        if limited.course == Course::Straight && wanted.max_abs() > 0.0 {
            straight += 1;
            assert!(bend(&limited.rates, &wanted) < 1e-9);
        }
        blended += u32::from(limited.course == Course::Blended);
        apart += u32::from(limited.course == Course::Apart);
        let obeyed = limited.rates.zip(&wanted, |a, b| a - b).max_abs() <= 1e-12;
        assert!(
            obeyed || !limited.limits.is_empty(),
            "slowed without a reason: {limited:?}"
        );
        motion = after;
    }
    // The rest leaves another direction of motion, which takes the joints up to seconds; what
    // goes joint by joint is about to run into an end.
    println!("straight {straight}, blended {blended}, apart {apart}");
    assert!(straight > 250_000, "{straight}");
    assert!(apart < 30_000, "{apart}");
}

#[test]
fn from_rest_the_direction_is_always_kept() {
    let chain = viper();
    let limits = chain.limits();
    let limiter = Limiter::new(limits, MARGIN, HOLD).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..2000 {
        let mut q = random(limits, &mut rng, |limit, share| {
            let middle = 0.5 * (limit.lower + limit.upper);
            middle + share * (0.5 * (limit.upper - limit.lower) - MARGIN)
        });
        let line = random(limits, &mut rng, |limit, share| limit.velocity * share);
        let mut motion = Motion::steady(q.zeroed());
        let mut amount = 1.0;
        for _ in 0..200 {
            if rng.random_bool(0.05) {
                amount = rng.random_range(-1.5..1.5);
            }
            let wanted = line.map(|x| x * amount);
            let limited = limiter.step(&q, &motion, &wanted, PERIOD);
            let after = Motion {
                rates: limited.rates,
                accelerations: limited
                    .rates
                    .zip(&motion.rates, |new, old| (new - old) / PERIOD),
            };
            q = q.zip(&limited.rates, |q, rate| q + rate * PERIOD);
            assert_kept(limits, &motion, &after, &q, PERIOD);
            assert!(
                limited.course == Course::Straight && bend(&limited.rates, &wanted) < 1e-7,
                "{limited:?}"
            );
            motion = after;
        }
    }
}

#[test]
fn sudden_changes_of_direction_bring_in_no_third_one() {
    let chain = viper();
    let limits = chain.limits();
    let limiter = Limiter::new(limits, MARGIN, HOLD).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let q = Joints::from([0.0, -1.2, 2.4, 0.0, 0.9, 0.0]);
    for dimensions in 1..=3 {
        for _ in 0..30 {
            let base: Vec<Joints> = (0..dimensions)
                .map(|_| random(limits, &mut rng, |_, share| share))
                .collect();
            let mut motion = Motion::steady(q.zeroed());
            let mut wanted = q.zeroed();
            for _ in 0..1000 {
                if rng.random_bool(0.05) {
                    let size = 10.0_f64.powi(rng.random_range(-4..3));
                    wanted = base.iter().fold(q.zeroed(), |sum, b| {
                        let share = size * rng.random_range(-1.0..1.0);
                        sum.zip(b, |sum, b| sum + share * b)
                    });
                }
                let limited = limiter.step(&q, &motion, &wanted, PERIOD);
                assert_ne!(limited.course, Course::Apart, "far from all ends");
                let accelerations = limited.rates.zip(&motion.rates, |n, o| (n - o) / PERIOD);
                motion = Motion {
                    rates: limited.rates,
                    accelerations,
                };
                let third = outside(&motion.rates, &base);
                // Rates that fade away leave the rounding of larger ones.
                let rounding = 1e-12 / motion.rates.max_abs().max(1e-12);
                assert!(third < 1e-9 + rounding, "{third:e} of {motion:?}");
            }
        }
    }
}

#[test]
fn a_needle_pushed_and_turned_by_fits_and_starts_does_not_move_sideways() {
    let chain = viper();
    let limiter = Limiter::new(chain.limits(), MARGIN, HOLD).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let start = Joints::from([0.0, -1.2, 2.4, 0.0, 0.9, 0.0]);
    let (mut sideways, mut fastest) = (0.0_f64, 0.0_f64);
    for _ in 0..200 {
        let (mut q, mut motion) = (start, Motion::steady(start.zeroed()));
        let (mut push, mut spin) = (0.0, 0.0);
        for tick in 0..100 {
            if tick == 0 || rng.random_bool(0.05) {
                push = rng.random_range(-0.01..0.01);
                spin = rng.random_range(-3.0..3.0);
            }
            let axis = chain.forward(&q).rotation * nalgebra::Vector3::z();
            let twist = hal::Twist {
                linear: axis * push,
                angular: axis * spin,
            };
            let wanted = chain.rates(&q, &twist, &RateSettings::default()).rates;
            let limited = limiter.step(&q, &motion, &wanted, PERIOD);
            assert_ne!(limited.course, Course::Apart);
            let accelerations = limited.rates.zip(&motion.rates, |n, o| (n - o) / PERIOD);
            motion = Motion {
                rates: limited.rates,
                accelerations,
            };
            let velocity = hal::guarded::Tool::twist(&chain, &q, &motion.rates).linear;
            sideways = sideways.max((velocity - axis * velocity.dot(&axis)).norm());
            fastest = fastest.max(velocity.norm());
            q = q.zip(&motion.rates, |q, rate| q + rate * PERIOD);
        }
    }
    println!("sideways {sideways:.2e} of {fastest:.2e} m/s");
    // Rates keep their direction while the arm that turns under them does not: by up to 0.03
    // rad/s, in the 0.2 s that the fastest change of the spin takes.
    assert!(sideways < 6e-3 * fastest, "{sideways:e} of {fastest:e}");
    assert!(fastest < 0.0101, "faster than ever wanted: {fastest}");
}

/// One joint stands at its end, the others still move fast, and a slow motion is wanted that
/// would take all of them further: they must slow down, though the first cannot follow.
#[test]
fn a_joint_at_its_end_does_not_keep_the_others_going() {
    let chain = viper();
    let limits = chain.limits();
    let limiter = Limiter::new(limits, MARGIN, HOLD).unwrap();
    for at_end in 0..6 {
        let mut q = Joints::from([0.0, -1.2, 2.4, 0.0, 0.9, 0.0]);
        q[at_end] = limits[at_end].upper - MARGIN;
        let mut motion = Motion::steady(q.zeroed());
        let mut wanted = q.zeroed();
        for joint in 0..6 {
            motion.rates[joint] = if joint == at_end { 0.0 } else { 0.05 };
            wanted[joint] = 0.005;
        }
        for _ in 0..12 {
            let limited = limiter.step(&q, &motion, &wanted, PERIOD);
            let after = Motion {
                rates: limited.rates,
                accelerations: limited
                    .rates
                    .zip(&motion.rates, |new, old| (new - old) / PERIOD),
            };
            q = q.zip(&limited.rates, |q, rate| q + rate * PERIOD);
            assert_kept(limits, &motion, &after, &q, PERIOD);
            motion = after;
        }
        // After 0.2 s, in which every joint can stop.
        assert!(
            motion.rates.max_abs() < 0.006,
            "joint {at_end}: {:?}",
            motion.rates
        );
    }
}

#[test]
fn full_speed_into_every_limit_ends_at_the_margin() {
    let chain = viper();
    let limits = chain.limits();
    let limiter = Limiter::new(limits, MARGIN, HOLD).unwrap();
    for joint in 0..6 {
        for sense in [1.0, -1.0] {
            let mut q = Joints::from([0.0, -1.2, 2.4, 0.0, 0.9, 0.0]);
            let mut motion = Motion::steady(q.zeroed());
            let mut wanted = q.zeroed();
            wanted[joint] = sense * limits[joint].velocity;
            let mut blamed = false;
            for _ in 0..1000 {
                let limited = limiter.step(&q, &motion, &wanted, PERIOD);
                let after = Motion {
                    rates: limited.rates,
                    accelerations: limited
                        .rates
                        .zip(&motion.rates, |new, old| (new - old) / PERIOD),
                };
                q = q.zip(&limited.rates, |q, rate| q + rate * PERIOD);
                assert_kept(limits, &motion, &after, &q, PERIOD);
                motion = after;
                let number = u8::try_from(joint).unwrap();
                blamed = limited.limits == [Limit::JointPosition(number)];
            }
            let end = if sense > 0.0 {
                limits[joint].upper - MARGIN
            } else {
                limits[joint].lower + MARGIN
            };
            assert!(
                (q[joint] - end).abs() < 1e-3,
                "joint {joint}: {} from its end",
                q[joint] - end
            );
            assert!(blamed);
        }
    }
}

#[test]
fn the_tool_never_leaves_its_workspace_nor_its_speed() {
    let chain = viper();
    let limits = chain.limits();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let start = Joints::from([0.0, -1.2, 2.4, 0.0, 0.9, 0.0]);
    let centre = chain.forward(&start).translation.vector;
    let workspace = Workspace {
        lower: Point3::from(centre.add_scalar(-0.06)),
        upper: Point3::from(centre.add_scalar(0.06)),
    };
    let limiter = Limiter::new(limits, MARGIN, HOLD).unwrap();
    let mut guard =
        Guard::new(limiter).with_tool(Box::new(chain.clone()), Some(workspace), SpeedCaps::NONE);
    let mut q = start;
    let mut wanted = q.zeroed();
    let (mut acted, mut nearest) = (0, f64::INFINITY);
    for _ in 0..60_000 {
        if rng.random_bool(0.05) {
            wanted = arbitrary(limits, &wanted, &mut rng);
        }
        let before = *guard.motion();
        let limited = guard.step(&q, &wanted, PERIOD);
        q = q.zip(&limited.rates, |q, rate| q + rate * PERIOD);
        assert_kept(limits, &before, guard.motion(), &q, PERIOD);
        let point = Point3::from(chain.forward(&q).translation.vector);
        assert!(
            workspace.excess(&point) <= 0.0,
            "{:e}",
            workspace.excess(&point)
        );
        acted += u32::from(limited.limits.contains(&Limit::Workspace));
        let to_wall = (0..3).fold(f64::INFINITY, |m: f64, k| {
            m.min(point[k] - workspace.lower[k])
                .min(workspace.upper[k] - point[k])
        });
        nearest = nearest.min(to_wall);
    }
    // The walls were in the way, and are of use up to a millimetre.
    assert!(acted > 1000 && nearest < 1e-3, "{acted} {nearest}");
}

#[test]
fn speed_caps_slow_the_tool_in_its_direction() {
    let chain = viper();
    let limiter = Limiter::new(chain.limits(), MARGIN, HOLD).unwrap();
    let caps = SpeedCaps::INSERTING;
    let mut guard = Guard::new(limiter).with_tool(Box::new(chain.clone()), None, caps);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let q = Joints::from([0.0, -1.2, 2.4, 0.0, 0.9, 0.0]);
    for _ in 0..200 {
        let wanted = random(chain.limits(), &mut rng, |_, share| 0.3 * share);
        guard.assume(Motion::steady(q.zeroed()));
        let mut last = guard.step(&q, &wanted, PERIOD);
        for _ in 0..100 {
            last = guard.step(&q, &wanted, PERIOD);
        }
        let twist = hal::guarded::Tool::twist(&chain, &q, &last.rates).linear;
        let axis = chain.forward(&q).rotation * nalgebra::Vector3::z();
        let along = twist.dot(&axis);
        let across = (twist - axis * along).norm();
        assert!(along.abs() <= caps.along * (1.0 + ROUNDING));
        assert!(across <= caps.across * (1.0 + ROUNDING));
        let full = along.abs() > caps.along * 0.999 || across > caps.across * 0.999;
        assert!(full && bend(&last.rates, &wanted) < 1e-9);
    }
}

#[test]
fn caps_boxes_and_periods_that_are_no_numbers_let_nothing_loose() {
    let chain = viper();
    let q = Joints::from([0.0, -1.2, 2.4, 0.0, 0.9, 0.0]);
    let everywhere = Workspace {
        lower: Point3::new(-9.0, -9.0, -9.0),
        upper: Point3::new(9.0, 9.0, 9.0),
    };
    let nowhere = Workspace {
        lower: Point3::new(-9.0, f64::NAN, -9.0),
        ..everywhere
    };
    let cap = |along, across| SpeedCaps { along, across };
    for (workspace, caps, wanted) in [
        (everywhere, cap(f64::NAN, 0.01), 0.1),
        (everywhere, cap(0.01, f64::NAN), 0.1),
        (everywhere, cap(-1.0, 0.01), 0.1),
        (nowhere, SpeedCaps::NONE, 0.1),
        (everywhere, SpeedCaps::INSERTING, f64::MAX),
    ] {
        let limiter = Limiter::new(chain.limits(), MARGIN, HOLD).unwrap();
        let mut guard =
            Guard::new(limiter).with_tool(Box::new(chain.clone()), Some(workspace), caps);
        for _ in 0..20 {
            let limited = guard.step(&q, &q.map(|_| wanted), PERIOD);
            assert!(limited.rates.max_abs() == 0.0, "{limited:?}");
            assert!(!limited.limits.is_empty());
        }
    }
    for dt in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9] {
        let limiter = Limiter::new(chain.limits(), MARGIN, HOLD).unwrap();
        let mut guard = Guard::new(limiter);
        for _ in 0..20 {
            let before = *guard.motion();
            let limited = guard.step(&q, &q.map(|_| 0.3), dt);
            assert!(limited.rates.is_finite());
            assert_kept(
                chain.limits(),
                &before,
                guard.motion(),
                &q,
                HOLD.as_secs_f64(),
            );
        }
        assert!(guard.motion().rates.max_abs() > 0.1);
    }
}

/// Everything at once: `cargo test --release -p robots --test guard million -- --ignored --nocapture`
#[test]
#[ignore = "minutes; run by hand"]
fn a_million_random_commands_through_the_whole_guard_break_nothing() {
    let chain = viper();
    let limits = chain.limits();
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut q = Joints::from([0.0, -1.2, 2.4, 0.0, 0.9, 0.0]);
    let centre = chain.forward(&q).translation.vector;
    let workspace = Workspace {
        lower: Point3::from(centre.add_scalar(-0.06)),
        upper: Point3::from(centre.add_scalar(0.06)),
    };
    let limiter = Limiter::new(limits, MARGIN, HOLD).unwrap();
    let mut guard =
        Guard::new(limiter).with_tool(Box::new(chain.clone()), Some(workspace), SpeedCaps::NONE);
    let mut wanted = q.zeroed();
    let (mut walls, mut straight) = (0, 0);
    for _ in 0..1_000_000 {
        if rng.random_bool(0.05) {
            wanted = arbitrary(limits, &wanted, &mut rng);
            if rng.random_bool(0.02) {
                wanted[0] = [f64::NAN, f64::INFINITY, -f64::INFINITY][rng.random_range(0..3)];
            }
        }
        let before = *guard.motion();
        let limited = guard.step(&q, &wanted, PERIOD);
        q = q.zip(&limited.rates, |q, rate| q + rate * PERIOD);
        assert_kept(limits, &before, guard.motion(), &q, PERIOD);
        let point = Point3::from(chain.forward(&q).translation.vector);
        assert!(workspace.excess(&point) <= 0.0, "{point:?}");
        let wall = limited.limits.contains(&Limit::Workspace);
        walls += u32::from(wall);
        // What stops before a wall stops along its own way.
        let wants = wanted.is_finite() && wanted.max_abs() > 0.0 && !wall;
        if wants && limited.course == Course::Straight {
            straight += 1;
            assert!(bend(&limited.rates, &wanted) < 1e-9);
        }
        if !wanted.is_finite() {
            wanted = wanted.zeroed();
        }
    }
    println!("{walls} held by the box, {straight} straight");
    assert!(walls > 10_000 && straight > 100_000, "{walls} {straight}");
}

#[test]
fn values_that_are_no_numbers_bring_the_arm_to_rest() {
    let chain = viper();
    let limiter = Limiter::new(chain.limits(), MARGIN, HOLD).unwrap();
    let q = Joints::from([0.0, -1.2, 2.4, 0.0, 0.9, 0.0]);
    let motion = Motion::steady(q.map(|_| 0.1));
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for (positions, wanted) in [(q, q.map(|_| bad)), (q.map(|_| bad), q)] {
            let limited = limiter.step(&positions, &motion, &wanted, PERIOD);
            assert!(limited.rates.is_finite());
            assert!(limited.rates.max_abs() < 0.1);
        }
    }
    assert!(Limiter::new(chain.limits(), f64::NAN, HOLD).is_err());
    assert!(Limiter::new(chain.limits(), 3.0, HOLD).is_err());
    assert!(Limiter::new(chain.limits(), 0.0, Duration::ZERO).is_err());
}
