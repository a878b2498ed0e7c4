//! The controller's step at 40 springs, and whole insertions with the fast sensor.
#![expect(
    clippy::expect_used,
    clippy::disallowed_methods,
    reason = "a benchmark that cannot start stops, and reads the clock"
)]

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use hal::frame::LeftCamera;
use hal::telemetry::{Phase, Telemetry};
use hal::{ArmState, Position, SensedShape, Stamp};
use needle_steer::config::{self, Config};
use needle_steer::controls::Controls;
use needle_steer::cycle::{Cycle, Snapshot};
use needle_steer::rig::Rig;
use needle_steer::run::{Observer, run, simulate};

/// Steps that are timed: the last before the end, about five seconds with 25 plans.
const WINDOW: u32 = 150;

/// What the steps of a run read.
#[derive(Default)]
struct Recording {
    steps: Vec<(Stamp, ArmState, Option<SensedShape>, Phase)>,
    springs: usize,
    target: Option<Position<LeftCamera>>,
}

impl Observer for Recording {
    fn inputs(&mut self, arm: &ArmState, shape: Option<&SensedShape>) {
        self.steps
            .push((arm.stamp, *arm, shape.cloned(), Phase::Idle));
    }

    fn step(&mut self, telemetry: &Telemetry) {
        if let Some(last) = self.steps.last_mut() {
            last.0 = telemetry.stamp;
            last.3 = telemetry.phase;
        }
        self.springs = telemetry.model.spring_points.len();
        if telemetry.phase == Phase::Steering {
            self.target = Some(telemetry.target);
        }
    }
}

/// A run of `law` with springs so close that 40 stand at its end.
fn configuration(law: &str) -> Config {
    let overrides = [
        format!("run.law={law}"),
        "run.sensor=shape".to_owned(),
        "tissue.spring_spacing_mm=2.15".to_owned(),
    ];
    config::load(None, &overrides).expect("a valid configuration")
}

/// Time of the window's steps on a cycle that has lived through all before.
fn window(config: &Config, rig: &Rig, recording: &Recording, first: &ArmState) -> Duration {
    let mut cycle = Cycle::new(config, rig.bearings.clone(), first).expect("a cycle");
    let begin = recording.steps.len() - WINDOW as usize;
    let mut before = first.stamp;
    let mut elapsed = Duration::ZERO;
    let mut target = recording.target;
    for (i, (now, arm, shape, phase)) in recording.steps.iter().enumerate() {
        let snapshot = Snapshot {
            now: *now,
            dt: now.secs_since(before),
            arm,
            shape: shape.as_ref(),
            pair: None,
            marker: None,
            phase: *phase,
        };
        before = *now;
        if *phase == Phase::Steering
            && let Some(target) = target.take()
        {
            cycle.set_target(target);
        }
        let start = Instant::now();
        black_box(cycle.step(black_box(&snapshot)));
        if i >= begin {
            elapsed += start.elapsed();
        }
    }
    elapsed
}

fn control_step(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("control_step");
    group.sample_size(10);
    for law in ["paper", "hybrid"] {
        let config = configuration(law);
        let mut rig = Rig::new(&config).expect("a rig");
        let first = hal::Arm::state(&mut rig.arm).expect("an arm's state");
        let mut recording = Recording::default();
        run(&config, &mut rig, &mut recording, &Controls::default()).expect("a run");
        assert!(
            (39..=41).contains(&recording.springs),
            "{} springs",
            recording.springs
        );
        group.bench_function(BenchmarkId::from_parameter(law), |bencher| {
            bencher.iter_custom(|iterations| {
                // One pass lives through the whole insertion, however many steps are asked for.
                let per_step = window(&config, &rig, &recording, &first) / WINDOW;
                per_step * u32::try_from(iterations).unwrap_or(u32::MAX)
            });
        });
    }
    group.finish();
}

fn closed_loop(criterion: &mut Criterion) {
    let config =
        config::load(None, &["run.sensor=shape".to_owned()]).expect("a valid configuration");
    let seconds = simulate(&config).expect("a run").duration_s;
    let mut group = criterion.benchmark_group("closed_loop");
    group.sample_size(10);
    // Elements a second are simulated milliseconds a second: 1000 is real time.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a positive number of milliseconds"
    )]
    group.throughput(Throughput::Elements((seconds * 1e3) as u64));
    group.bench_function(BenchmarkId::from_parameter("fast_sensor"), |bencher| {
        bencher.iter(|| simulate(black_box(&config)).expect("a run"));
    });
    group.finish();
}

criterion_group!(benches, control_step, closed_loop);
criterion_main!(benches);
