//! The loop closed through images: one step of control, and a whole insertion.
//!
//! The steps are those of real insertions, timed one by one; the world and its cameras run
//! between them and are not counted. Their quantiles are printed.
#![expect(
    clippy::disallowed_methods,
    clippy::print_stderr,
    clippy::unwrap_used,
    reason = "a benchmark measures and reports"
)]

use std::collections::VecDeque;
use std::hint::black_box;
use std::path::Path;
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use hal::telemetry::{Phase, Telemetry};
use needle_steer::config::{self, Config};
use needle_steer::controls::Controls;
use needle_steer::outcome::Summary;
use needle_steer::rig::Rig;
use needle_steer::run::{Observer, run};

fn config(width_px: usize, seed: u64) -> Config {
    let overrides = [
        "run.sensor=images".to_owned(),
        format!("cameras.width_px={width_px}"),
        format!("run.seed={seed}"),
    ];
    config::parse("", Path::new(""), &overrides).unwrap()
}

/// Durations of the steps while steering.
#[derive(Default)]
struct Stopwatch {
    newest: Duration,
    steering: Vec<Duration>,
}

impl Observer for Stopwatch {
    fn timed(&mut self, step: Duration) {
        self.newest = step;
    }

    fn step(&mut self, telemetry: &Telemetry) {
        if telemetry.phase == Phase::Steering {
            self.steering.push(self.newest);
        }
    }
}

fn insertion(config: &Config, observer: &mut dyn Observer) -> Summary {
    let mut rig = Rig::new(config).unwrap();
    run(config, &mut rig, observer, &Controls::default()).unwrap()
}

fn cycle_step(c: &mut Criterion) {
    let mut group = c.benchmark_group("cycle_step");
    let mut all: Vec<Duration> = Vec::new();
    let mut waiting: VecDeque<Duration> = VecDeque::new();
    let mut seed = 0;
    group.sample_size(10).warm_up_time(Duration::from_millis(1));
    group.measurement_time(Duration::from_millis(500));
    group.bench_function(BenchmarkId::from_parameter("1280"), |b| {
        b.iter_custom(|steps| {
            let mut total = Duration::ZERO;
            for _ in 0..steps {
                while waiting.is_empty() {
                    seed += 1;
                    let mut stopwatch = Stopwatch::default();
                    insertion(&config(1280, seed), &mut stopwatch);
                    all.extend_from_slice(&stopwatch.steering);
                    waiting.extend(stopwatch.steering);
                }
                total += waiting.pop_front().unwrap_or_default();
            }
            total
        });
    });
    group.finish();
    all.sort_unstable();
    let at = |share: f64| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "an index into the list"
        )]
        let index = (share * all.len() as f64) as usize;
        all.get(index.min(all.len().saturating_sub(1)))
            .map_or(f64::NAN, |d| d.as_secs_f64() * 1e6)
    };
    let (count, p50, p99, most) = (all.len(), at(0.5), at(0.99), at(1.0));
    eprintln!(
        "cycle_step/1280: {count} steps, p50 {p50:.0} us, p99 {p99:.0} us, most {most:.0} us"
    );
}

fn closed_loop(c: &mut Criterion) {
    let mut group = c.benchmark_group("closed_loop");
    let config = config(640, 1);
    let begun = Instant::now();
    let summary = insertion(&config, &mut Stopwatch::default());
    let ratio = summary.duration_s / begun.elapsed().as_secs_f64();
    eprintln!(
        "closed_loop/images: {} in {:.1} s of the needle's time, {ratio:.1} times real time",
        summary.ended, summary.duration_s
    );
    group.sample_size(10);
    group.bench_function(BenchmarkId::from_parameter("images"), |b| {
        b.iter(|| black_box(insertion(&config, &mut Stopwatch::default())));
    });
    group.finish();
}

criterion_group!(benches, cycle_step, closed_loop);
criterion_main!(benches);
