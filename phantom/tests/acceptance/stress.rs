//! Base motions that no surgeon would make: nothing freezes, hangs or turns into NaN.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use phantom::{Event, Plant, Settings};

use crate::support::{Dice, Rig, finite};

/// Kinds of motion.
const MOTIONS: [&str; 8] = [
    "steering",
    "lateral",
    "retraction",
    "rotation",
    "buckling",
    "pull-out",
    "tilting",
    "random",
];

/// What a run showed.
#[derive(Clone, Copy, Debug, Default)]
struct Record {
    steps: u64,
    unconverged: u64,
    longest: u64,
    iterations: u64,
    buckled: u64,
    torn: u64,
    not_finite: u64,
    jump: f64,
}

struct Ride {
    rig: Rig,
    record: Record,
    streak: u64,
}

impl Ride {
    fn go(&mut self, pose: Isometry3<f64>, seconds: f64) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "small"
        )]
        let steps = (seconds * 30.0).ceil().max(1.0) as u32;
        let record = &mut self.record;
        let streak = &mut self.streak;
        let mut last = self.rig.truth().tip();
        self.rig.go_with(pose, seconds, steps, |plant, _| {
            record.steps += 1;
            record.iterations = plant.iterations();
            if !finite(plant.truth()) {
                record.not_finite += 1;
            }
            let tip = plant.truth().tip();
            record.jump = record.jump.max((tip - last).norm());
            last = tip;
            let has = |f: fn(&Event) -> bool| plant.truth().events.iter().any(f);
            if has(|e| matches!(e, Event::Unconverged { .. })) {
                record.unconverged += 1;
                *streak += 1;
                record.longest = record.longest.max(*streak);
            } else {
                *streak = 0;
            }
            record.buckled += u64::from(has(|e| matches!(e, Event::Buckling)));
            record.torn += u64::from(has(|e| matches!(e, Event::Tearing { .. })));
        });
    }

    /// Moves the base by a displacement and a rotation vector in its own frame.
    fn by(&mut self, way: Vector3<f64>, turn: Vector3<f64>, seconds: f64) {
        let pose = self.rig.pose * Isometry3::new(way, turn);
        self.go(pose, seconds);
    }

    fn forward(&mut self, metres: f64, speed: f64) {
        self.by(
            Vector3::z() * metres,
            Vector3::zeros(),
            metres.abs() / speed,
        );
    }
}

/// One run of `settings` under the motion `kind`.
fn ride(settings: &Settings, kind: usize, seed: u64) -> Record {
    let mut ride = Ride {
        rig: Rig::new(settings, seed),
        record: Record::default(),
        streak: 0,
    };
    let mut dice = Dice(seed * 64 + kind as u64);
    let mut d = || dice.throw();
    match MOTIONS[kind] {
        "steering" => {
            ride.forward(0.005, 1e-3);
            for _ in 0..75 {
                let way = Vector3::new(1.5e-3 * d(), 1.5e-3 * d(), 1e-3);
                let turn = Vector3::new(0.01 * d(), 0.01 * d(), 0.6 * d());
                ride.by(way, turn, 0.7);
            }
        }
        "lateral" => {
            ride.forward(0.03 + 0.02 * d(), 5e-3);
            for _ in 0..12 {
                let way = Vector3::new(20e-3 * d(), 20e-3 * d(), 1e-3 * d());
                ride.by(way, Vector3::zeros(), 0.3 + 0.25 * d());
            }
            ride.forward(0.02, 2e-3);
        }
        "retraction" => {
            for _ in 0..6 {
                ride.forward(0.04 + 0.01 * d(), 5e-3);
                ride.by(
                    Vector3::new(5e-3 * d(), 5e-3 * d(), 0.0),
                    Vector3::z() * 3.0 * d(),
                    1.0,
                );
                ride.forward(-0.03 + 0.01 * d(), 10e-3);
            }
        }
        "rotation" => {
            for _ in 0..5 {
                ride.forward(0.012, 2e-3);
                for _ in 0..16 {
                    ride.by(Vector3::zeros(), Vector3::z() * 2.5, 0.3);
                }
                ride.by(
                    Vector3::new(3e-3 * d(), 3e-3 * d(), 0.0),
                    Vector3::z() * 2.0 * d(),
                    0.5,
                );
            }
        }
        "buckling" => {
            ride.forward(0.01 + 0.008 * d(), 5e-3);
            ride.by(
                Vector3::zeros(),
                Vector3::new(0.5 * d(), 0.5 * d(), 0.0),
                0.5,
            );
            ride.forward(0.05, 20e-3);
            ride.forward(0.03, 50e-3);
            ride.forward(-0.04, 50e-3);
        }
        "pull-out" => {
            for _ in 0..6 {
                ride.forward(0.025 + 0.01 * d(), 10e-3);
                let side = 3e-3 * d();
                ride.by(Vector3::x() * side, Vector3::zeros(), 0.3);
                let out = ride.rig.pose.translation.vector.z + 0.126 + 4e-3 * (1.0 + d());
                ride.forward(-out, 20e-3);
                ride.by(
                    Vector3::new(1e-3 * d(), 1e-3 * d(), 0.0),
                    Vector3::z() * d(),
                    0.2,
                );
            }
        }
        "tilting" => {
            ride.forward(0.04 + 0.02 * d(), 5e-3);
            for _ in 0..12 {
                // About the entry, so that the shaft levers in its hole.
                let arm = -ride.rig.pose.translation.vector.z;
                let (x, y) = (0.4 * d(), 0.4 * d());
                let mut pose = ride.rig.pose;
                pose.rotation = UnitQuaternion::from_scaled_axis(Vector3::new(x, y, 0.0));
                pose.translation.vector = pose.rotation * Vector3::z() * -arm;
                ride.go(pose, 0.5 + 0.4 * d());
                ride.forward(2e-3, 2e-3);
            }
        }
        _ => {
            ride.forward(0.02, 5e-3);
            for _ in 0..60 {
                let size = 10f64.powf(d());
                let way = Vector3::new(1e-3 * d(), 1e-3 * d(), 1e-3 * (0.5 + d())) * size;
                let turn = Vector3::new(0.02 * d(), 0.02 * d(), 0.3 * d()) * size;
                ride.by(way, turn, 0.3 + 0.25 * d());
            }
        }
    }
    ride.record
}

/// Rides under every motion with `seeds`: what happened, and what should not have.
fn survive(seeds: &core::ops::Range<u64>) -> [Vec<String>; 2] {
    let settings = Settings::preset("harsh").unwrap();
    let (mut report, mut bad) = (Vec::new(), Vec::new());
    for (kind, motion) in MOTIONS.iter().enumerate() {
        let mut sum = Record::default();
        for seed in seeds.clone() {
            let record = ride(&settings, kind, seed);
            // Out of balance for a moment, where the shaft snaps; never for good. Bounded work:
            // 60 halvings at once, four a call.
            if record.not_finite > 0
                || record.longest > 3
                || record.iterations >= 2000 * record.steps
            {
                bad.push(format!("{motion} {seed}: {record:?}"));
            }
            sum.steps += record.steps;
            sum.unconverged += record.unconverged;
            sum.torn += record.torn;
            sum.buckled += record.buckled;
            sum.longest = sum.longest.max(record.longest);
        }
        report.push(format!(
            "{motion}: {} steps, unconverged {}, at most {} in a row, tearing {}, buckling {}",
            sum.steps, sum.unconverged, sum.longest, sum.torn, sum.buckled
        ));
        if sum.unconverged * 500 > sum.steps {
            bad.push(format!("{motion}: {} of {}", sum.unconverged, sum.steps));
        }
    }
    [report, bad]
}

#[test]
fn nothing_freezes_under_nasty_motions() {
    let [report, bad] = survive(&(0..2));
    println!("{}", report.join("\n"));
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}

#[test]
#[ignore = "200 runs take minutes"]
fn nothing_freezes_in_two_hundred_runs() {
    let [report, bad] = survive(&(100..125));
    println!("{}", report.join("\n"));
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}
