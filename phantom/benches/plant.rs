//! Speed of the plant.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use hal::{ShapeSensor, Stamp, Transform};
use nalgebra::Isometry3;
use phantom::experiment::default_setup;
use phantom::{Bench, Plant, RodPlant, Settings};

const RATE: f64 = 30.0;
const SPEED: f64 = 1e-3;

/// One 30 Hz step of insertion at 1 mm/s, 50 mm deep, population `paper`.
fn plant_step(c: &mut Criterion) {
    let Ok(settings) = Settings::preset("paper") else {
        return;
    };
    let setup = default_setup(&settings, 1);
    let base = setup.world_from_base;
    let Ok(mut deep) = RodPlant::new(&settings, &setup.world_from_phantom, &base, 1) else {
        return;
    };
    let at = |step: f64| -> Transform<_, _> {
        let way = step / RATE * SPEED;
        Transform::assume(base.isometry() * Isometry3::translation(0.0, 0.0, way))
    };
    let begin = 0.05 / SPEED * RATE;
    let mut step = 0.0;
    while step < begin {
        step += 1.0;
        deep.advance(&at(step), Stamp::from_secs(step / RATE));
    }
    let mut group = c.benchmark_group("plant_step");
    group.bench_function(BenchmarkId::from_parameter("30hz"), |b| {
        // A hundred steps from a fresh copy, so that the depth stays near 50 mm.
        b.iter_custom(|iterations| {
            let mut elapsed = core::time::Duration::ZERO;
            let mut left = iterations;
            while left > 0 {
                let mut plant = deep.clone();
                let batch = left.min(100);
                #[expect(clippy::disallowed_methods, reason = "a benchmark measures time")]
                let start = std::time::Instant::now();
                for i in 1..=batch {
                    let now = begin + i as f64;
                    plant.advance(&at(now), Stamp::from_secs(now / RATE));
                }
                elapsed += start.elapsed();
                left -= batch;
            }
            elapsed
        });
    });
    group.finish();
}

/// 80 mm at 1 mm/s with the fast sensor at 30 Hz: 80 s of real time.
fn insertion(c: &mut Criterion) {
    let Ok(settings) = Settings::preset("paper") else {
        return;
    };
    let setup = default_setup(&settings, 1);
    let base = setup.world_from_base;
    let mut group = c.benchmark_group("insertion_fast_sensor");
    group.sample_size(10);
    group.bench_function(BenchmarkId::from_parameter("80mm"), |b| {
        b.iter(|| {
            let mut bench = Bench::new(&settings, &setup).ok()?;
            let mut points = 0;
            for step in 1..=2400u32 {
                let seconds = f64::from(step) / RATE;
                let way = Isometry3::translation(0.0, 0.0, seconds * SPEED);
                let pose = Transform::assume(base.isometry() * way);
                bench.advance_to(Stamp::from_secs(seconds), &pose);
                if let Ok(Some(shape)) = ShapeSensor::poll(&mut bench) {
                    points += shape.points.len();
                }
            }
            Some((points, bench.truth().tip()))
        });
    });
    group.finish();
}

criterion_group!(benches, plant_step, insertion);
criterion_main!(benches);
