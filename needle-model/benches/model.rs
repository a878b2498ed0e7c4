//! Equilibrium, derivatives, insertion, estimation and roll-out of the needle model.
#![expect(
    missing_docs,
    reason = "criterion's macros generate undocumented items"
)]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use needle_model::{
    Bevel, Equilibrium, EstimationSettings, Estimator, Insertion, InsertionSettings, Needle,
    PathLaw, Prediction, RestPoint, Spring, TipLoad, Tissue,
};

const COUNTS: [usize; 5] = [10, 20, 40, 80, 160];
/// Depth of the needle, and of the part that carries springs \[m\].
const DEPTH: f64 = 0.1;
const SPRUNG: f64 = 0.095;

/// The biopsy needle 100 mm deep on a bent path with `count` springs.
fn bent(count: usize) -> (Equilibrium, Vec<Spring>, TipLoad) {
    let pitch = SPRUNG / count as f64;
    let springs: Vec<_> = (0..count)
        .map(|i| {
            let z = pitch * (i as f64 + 0.5);
            Spring {
                rest: Vector3::new(0.3 * z * z, -0.7 * z * z, z),
                stiffness: 1e4 * pitch,
            }
        })
        .collect();
    let base = Isometry3::translation(0.0, 0.0, DEPTH - Needle::biopsy().length());
    let load = TipLoad {
        force: -6e-3,
        bending: -2e-6,
    };
    let mut needle = Equilibrium::new(Needle::biopsy(), base);
    if let Err(error) = needle.solve(&base, &springs, load) {
        unreachable!("{error}");
    }
    (needle, springs, load)
}

/// Base poses 0.1 mm and 0.1 degree apart, visited in turn so that each solve has work to do.
fn poses(from: &Isometry3<f64>) -> [Isometry3<f64>; 2] {
    let turn = UnitQuaternion::new(Vector3::new(1.2e-3, 1.2e-3, 1e-3));
    let mut other = *from;
    other.translation.vector += Vector3::new(6e-5, 5e-5, 6e-5);
    other.rotation = turn * other.rotation;
    [*from, other]
}

fn equilibrium(c: &mut Criterion) {
    for jacobian in [false, true] {
        let name = if jacobian {
            "equilibrium_and_jacobian"
        } else {
            "equilibrium"
        };
        let mut group = c.benchmark_group(name);
        for count in COUNTS {
            let (mut needle, springs, load) = bent(count);
            let poses = poses(needle.world_from_base());
            let mut turn = 0;
            group.bench_function(BenchmarkId::from_parameter(count), |b| {
                b.iter(|| {
                    turn = 1 - turn;
                    black_box(needle.solve(&poses[turn], &springs, load).ok());
                    if jacobian {
                        black_box(needle.tip_jacobian().ok());
                    }
                });
            });
        }
        group.finish();
    }
}

fn insertion(c: &mut Criterion) {
    let needle = Needle::biopsy();
    let base = |depth: f64| Isometry3::translation(0.0, 0.0, depth - needle.length());
    let settings = InsertionSettings {
        rest_point: RestPoint::CuttingEdge,
        ..Default::default()
    };
    let start = Tissue::uniform(Vector3::zeros(), Vector3::z(), 1e4)
        .ok()
        .and_then(|tissue| {
            let bevel = Bevel::plane_cut(24_f64.to_radians(), 0.7e-3).ok()?;
            Insertion::new(needle, bevel, tissue, settings, &base(0.0)).ok()
        });
    let Some(start) = start else {
        unreachable!("a valid insertion")
    };
    c.bench_function("insertion/80mm", |b| {
        b.iter(|| {
            let mut insertion = start.clone();
            for i in 1..=800 {
                black_box(insertion.insert(&base(1e-4 * f64::from(i)), None).ok());
            }
            insertion.equilibrium().tip_position()
        });
    });
}

fn estimate(c: &mut Criterion) {
    let (needle, springs, load) = bent(40);
    let points: Vec<_> = (0..40)
        .map(|i| needle.point(0.027 + 0.0025 * f64::from(i)) + Vector3::x() * 2e-4)
        .collect();
    let mut start = needle.clone();
    let softer: Vec<_> = springs
        .iter()
        .map(|s| Spring {
            stiffness: s.stiffness * 0.8,
            ..*s
        })
        .collect();
    let base = *needle.world_from_base();
    let (Ok(_), Ok(mut estimator)) = (
        start.solve(&base, &softer, load),
        Estimator::new(EstimationSettings::joint(), &needle),
    ) else {
        unreachable!("a valid needle")
    };
    c.bench_function("estimate/40", |b| {
        b.iter(|| black_box(estimator.fit(&start, 8e3, &points).ok()));
    });
}

fn rollout(c: &mut Criterion) {
    let base = Isometry3::translation(0.0, 0.0, 0.01 - Needle::biopsy().length());
    let law = PathLaw {
        axial_load: 0.4,
        tip_compliance: 0.035,
        ..PathLaw::default()
    };
    let path = (0..=4).map(|i| Vector3::z() * (2.5e-3 * f64::from(i)));
    let prediction = Tissue::uniform(Vector3::zeros(), Vector3::z(), 1e4)
        .ok()
        .and_then(|tissue| {
            let frame = Isometry3::identity();
            Prediction::new(&Needle::biopsy(), &tissue, law, &frame, &base, path).ok()
        });
    let Some(prediction) = prediction else {
        unreachable!("a valid prediction")
    };
    c.bench_function("rollout/80mm", |b| {
        b.iter(|| black_box(prediction.roll_out(0.09, 1.25e-3).ok()));
    });
}

criterion_group!(benches, equilibrium, insertion, estimate, rollout);
criterion_main!(benches);
