//! Time to render one stereo pair with every flaw on, once warm.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use hal::{Stamp, Transform};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use phantom::NeedleView;
use phantom::camera::{CameraSettings, StereoRig};

/// A needle that has bent by 5 mm over `depth`, in nodes of 0.5 mm.
fn needle(world_from_phantom: &Isometry3<f64>, depth: f64) -> NeedleView {
    let bend = 0.8;
    let at = |z: f64| Point3::new(0.0, bend * z.max(0.0).powi(2), z);
    let phantom_from_tip = Isometry3::from_parts(
        Translation3::from(at(depth).coords),
        UnitQuaternion::from_scaled_axis(Vector3::x() * -(2.0 * bend * depth).atan()),
    );
    NeedleView {
        stamp: Stamp::ZERO,
        centreline: (0..=252)
            .map(|i| depth - 0.126 + 0.5e-3 * f64::from(i))
            .map(|z| (world_from_phantom * at(z)).coords)
            .collect(),
        world_from_tip: Transform::assume(world_from_phantom * phantom_from_tip),
        outer_diameter: 0.7e-3,
        bevel_angle: 24f64.to_radians(),
        entry_arc: 0.126 - depth,
    }
}

fn render_pair(c: &mut Criterion) {
    let mut group = c.benchmark_group("render_pair");
    let world_from_phantom = Isometry3::new(
        Vector3::new(0.4, 0.0, 0.25),
        Vector3::x() * std::f64::consts::PI,
    );
    let view = needle(&world_from_phantom, 0.08);
    let settings = CameraSettings::paper();
    for (width, settings) in [(640, settings.clone()), (1280, settings.at_1280())] {
        let Ok(mut rig) = StereoRig::new(&settings, &world_from_phantom, 1) else {
            continue;
        };
        let mut sequence = 0;
        group.bench_function(BenchmarkId::from_parameter(width), |b| {
            b.iter(|| {
                sequence += 1;
                rig.render(black_box(&view), sequence)
            });
        });
    }
    group.finish();
}

criterion_group!(benches, render_pair);
criterion_main!(benches);
