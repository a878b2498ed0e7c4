//! Learning environments: control steps of 64 at once, on one thread and on all cores.
#![expect(clippy::expect_used, reason = "a benchmark that cannot start stops")]

use std::num::NonZeroUsize;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use needle_steer::config;
use needle_steer::env::{Envs, OBSERVATION, Outcome, Settings, Step, Steps};

/// Environments.
const COUNT: usize = 64;

/// Insertion at the nominal third of full speed, with a little of everything else.
fn env(c: &mut Criterion) {
    let config = config::load(None, &["run.sensor=shape".to_owned()]).expect("a configuration");
    let mut group = c.benchmark_group("env");
    group.sample_size(20);
    group.throughput(Throughput::Elements(COUNT as u64));
    for (name, threads) in [("64", None), ("64 on one thread", NonZeroUsize::new(1))] {
        let mut envs =
            Envs::new(Settings::new(config.clone()), COUNT, threads, 1).expect("environments");
        let mut observations = vec![0.0; COUNT * OBSERVATION];
        let mut steps = vec![Step::default(); COUNT];
        let mut outcomes = vec![Outcome::default(); COUNT];
        let action = [0.0, 0.02, 0.33, 0.05, 0.0, 0.1];
        let actions: Vec<f32> = action.iter().copied().cycle().take(COUNT * 6).collect();
        group.bench_function(BenchmarkId::from_parameter(name), |b| {
            b.iter(|| {
                let into = Steps {
                    observations: &mut observations,
                    steps: &mut steps,
                    outcomes: &mut outcomes,
                };
                envs.step(&actions, into).expect("a step");
            });
        });
    }
    group.finish();
}

criterion_group!(benches, env);
criterion_main!(benches);
