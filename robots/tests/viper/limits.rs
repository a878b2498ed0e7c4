//! T10, T11, T12: limits of joints and workspace, singularities.

use hal::guarded::{SpeedCaps, Tool, Workspace};
use hal::{Arm, ArmMode, Joints, Twist};
use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use robots::arms::{NEEDLE_BASE, VIPER_S650};
use robots::kinematics::{Chain, RateSettings};
use robots::viper::driver::{Core, ToolLimits};
use robots::viper::emulator::EmulatorConfig;
use robots::viper::{Config, Dialect, Emulator, Lockstep, viper_limits};

use crate::bench::{Bench, HOME, PERIOD};

const DT: f64 = 0.016;

/// Rounding of sums of rates over a period.
const ROUNDING: f64 = 1e-9;

/// Follows the set points and checks every one against the limits.
struct Judge {
    q: Joints,
    rates: Joints,
    accelerations: Joints,
    margin: f64,
}

impl Judge {
    fn new(q: Joints) -> Self {
        let rest = q.zeroed();
        Self {
            q,
            rates: rest,
            accelerations: rest,
            margin: 0.5_f64.to_radians(),
        }
    }

    fn check(&mut self, q: Joints) {
        let rates = q.zip(&self.q, |new, old| (new - old) / DT);
        let accelerations = rates.zip(&self.rates, |new, old| (new - old) / DT);
        let jerks = accelerations.zip(&self.accelerations, |new, old| (new - old) / DT);
        for (joint, limit) in viper_limits().iter().enumerate() {
            let room =
                (limit.upper - self.margin - q[joint]).min(q[joint] - limit.lower - self.margin);
            assert!(room >= -ROUNDING, "joint {joint} at {}", q[joint]);
            assert!(rates[joint].abs() <= limit.velocity + ROUNDING / DT);
            assert!(accelerations[joint].abs() <= limit.acceleration + ROUNDING / DT / DT);
            assert!(
                jerks[joint].abs() <= limit.jerk + ROUNDING / DT / DT / DT,
                "joint {joint}: {} rad/s3",
                jerks[joint]
            );
        }
        (self.q, self.rates, self.accelerations) = (q, rates, accelerations);
    }
}

fn silent(start: [f64; 6]) -> Bench {
    let mut emulator = EmulatorConfig::viper(Dialect::Steer, Joints::from(start));
    emulator.journal = 0;
    let mut bench = Bench::with(Config::viper("emulated", Dialect::Steer), emulator);
    bench.rest(20);
    bench.arm().enable().unwrap();
    bench
}

fn random_commands(commands: u32, seed: u64) {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut bench = silent(HOME);
    let mut judge = Judge::new(Joints::from(HOME));
    let mut rates = [0.0; 6];
    let mut farthest: f64 = 0.0;
    for _ in 0..commands {
        if random.random_bool(0.05) {
            // From crawling to a thousand times too fast; some joints at rest.
            let size = 10_f64.powf(random.random_range(-3.0..4.0));
            for rate in &mut rates {
                *rate = if random.random_bool(0.3) {
                    0.0
                } else {
                    size * random.random_range(-1.0..1.0)
                };
            }
        }
        bench.command(rates).unwrap();
        bench.tick();
        let ordered = bench.arm().monitor().set_point().unwrap();
        judge.check(ordered);
        // The truth is what was ordered, to the wire's rounding: half a unit of 4..8 rad.
        let off = bench.travel(&ordered);
        assert!(off <= 2.5e-7, "{off}");
        farthest = farthest.max(
            ordered
                .zip(&Joints::from(HOME), |a, b| (a - b).abs())
                .max_abs(),
        );
    }
    assert_eq!(bench.mode(), ArmMode::Moving);
    assert!(
        farthest > 2.0,
        "the commands lead to the limits: {farthest} rad"
    );
}

#[test]
fn t10_a_million_random_commands_keep_all_joint_limits() {
    std::thread::scope(|scope| {
        for shard in 0..2 {
            scope.spawn(move || random_commands(500_000, 10 + shard));
        }
    });
}

fn chain() -> Chain {
    Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap()
}

fn guarded(workspace: Option<Workspace>, caps: SpeedCaps, start: [f64; 6]) -> Bench {
    let config = Config::viper("emulated", Dialect::Steer);
    let limits = ToolLimits {
        tool: Box::new(chain()),
        workspace,
        caps,
    };
    let core = Core::new(config).unwrap().with_tool(limits);
    let emulator = Emulator::new(EmulatorConfig::viper(Dialect::Steer, Joints::from(start)));
    let (arm, rig) = Lockstep::in_memory(core, emulator);
    let mut bench = Bench {
        arm: Some(arm),
        rig,
        now: hal::Stamp::ZERO,
        sequence: 0,
    };
    bench.rest(20);
    bench.arm().enable().unwrap();
    bench
}

#[test]
fn t10_random_commands_keep_the_box_and_the_insertion_speed() {
    let chain = chain();
    let centre = Point3::from(chain.pose(&Joints::from(HOME)).translation.vector);
    let half = Vector3::new(0.04, 0.03, 0.02);
    let workspace = Workspace {
        lower: centre - half,
        upper: centre + half,
    };
    let mut bench = guarded(Some(workspace), SpeedCaps::INSERTING, HOME);
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let mut judge = Judge::new(Joints::from(HOME));
    let (mut rates, mut worst, mut reached) = ([0.0; 6], 0.0_f64, 0.0_f64);
    for tick in 0..4000 {
        if tick % 60 == 0 {
            rates = std::array::from_fn(|_| random.random_range(-0.5..0.5));
        }
        let before = bench.arm().monitor().set_point().unwrap();
        bench.command(rates).unwrap();
        bench.tick();
        let ordered = bench.arm().monitor().set_point().unwrap();
        judge.check(ordered);
        let point = Point3::from(chain.pose(&ordered).translation.vector);
        worst = worst.max(workspace.excess(&point));
        reached = reached.max((point - centre).amax());
        let step = ordered.zip(&before, |new, old| (new - old) / DT);
        let speed = chain.twist(&before, &step).linear.norm();
        // While the caps come into force the arm slows down within its accelerations.
        assert!(speed <= 0.0095 * 1.5, "{speed} m/s at tick {tick}");
    }
    assert!(worst <= 1e-12, "{worst} m outside");
    assert!(reached > 0.019, "the box was reached: {reached} m");
}

#[test]
fn t11_no_joint_overshoots_its_limit_at_full_speed() {
    let limits = viper_limits();
    for (joint, limit) in limits.iter().enumerate() {
        for sense in [-1.0, 1.0] {
            let mut bench = silent(HOME);
            let mut judge = Judge::new(Joints::from(HOME));
            let mut rates = [0.0; 6];
            rates[joint] = sense * 10.0 * limit.velocity;
            for _ in 0..500 {
                bench.go(rates, 1);
                judge.check(bench.arm().monitor().set_point().unwrap());
                let truth = bench.truth()[joint];
                assert!((limit.lower..=limit.upper).contains(&truth));
            }
            let end = if sense > 0.0 {
                limit.upper
            } else {
                limit.lower
            };
            let left = (end - bench.truth()[joint]).abs();
            // Half a degree of margin, and what is not worth creeping for.
            assert!(
                (0.0087..0.03).contains(&left),
                "joint {joint} ends {left} rad before {end}"
            );
        }
    }
}

/// Drives the tool at needle speed along `direction` for `ticks`; the largest joint rate, the
/// smallest dexterity.
fn drive(bench: &mut Bench, twist: &Twist, ticks: u32) -> (f64, f64) {
    let chain = chain();
    let (mut fastest, mut least) = (0.0_f64, f64::INFINITY);
    let mut before = bench.truth();
    for _ in 0..ticks {
        let at = bench.arm().monitor().set_point().unwrap();
        let mapped = chain.rates(&at, twist, &RateSettings::default());
        least = least.min(mapped.dexterity);
        bench.go(mapped.rates.to_vec().try_into().unwrap(), 1);
        let truth = bench.truth();
        fastest = fastest.max(
            truth
                .zip(&before, |a, b| (a - b) / PERIOD.as_secs_f64())
                .max_abs(),
        );
        before = truth;
    }
    (fastest, least)
}

#[test]
fn t12_through_the_three_singularities_at_needle_speed() {
    let chain = chain();
    let elbow = 106.966_f64.to_radians();
    // Just short of the singularity, to be driven into it.
    let wrist = [0.1, -0.8, 2.1, 0.2, 0.10, 0.3];
    let elbow = [0.1, -0.8, elbow + 0.05, 0.2, 0.8, 0.3];
    let shoulder = [0.1, -2.0, 2.55, 0.2, 0.8, 0.3];
    for (name, start) in [("wrist", wrist), ("elbow", elbow), ("shoulder", shoulder)] {
        // Towards less dexterity: the gradient along the directions of translation.
        let q = Joints::from(start);
        let base = chain.dexterity(&q, 0.1);
        let directions = [Vector3::x(), Vector3::y(), Vector3::z()];
        let best = directions.into_iter().flat_map(|d| [d, -d]).min_by(|a, b| {
            let ahead = |d: &Vector3<f64>| {
                let twist = Twist {
                    linear: d * 0.005,
                    angular: Vector3::zeros(),
                };
                let rates = chain.rates(&q, &twist, &RateSettings::default()).rates;
                chain.dexterity(&q.zip(&rates, |q, rate| q + rate), 0.1)
            };
            ahead(a).total_cmp(&ahead(b))
        });
        let twist = Twist {
            linear: best.unwrap() * 0.005,
            angular: Vector3::zeros(),
        };
        let mut bench = silent(start);
        let (fastest, least) = drive(&mut bench, &twist, 1200);
        println!("{name}: dexterity {base:.3} to {least:.3}, fastest joint {fastest:.3} rad/s");
        assert_eq!(
            bench.mode(),
            ArmMode::Moving,
            "{name}: {:?}",
            bench.arm().monitor().fault()
        );
        assert!(least < base, "{name}: not driven towards the singularity");
        // 5 mm/s over the mapping's length and threshold: 0.05 / 0.05 = 1 rad/s.
        assert!(fastest <= 1.0 + 1e-3, "{name}: {fastest} rad/s");
    }
}
