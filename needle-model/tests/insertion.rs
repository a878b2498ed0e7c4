//! Insertions: independence of steps, continuity, the hole, rest points.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use needle_model::{Bevel, Insertion, InsertionSettings, Needle, RestPoint, Tissue};

const GAP: f64 = 0.0;

fn base_at(depth: f64) -> Isometry3<f64> {
    Isometry3::translation(0.0, 0.0, depth - Needle::biopsy().length() - GAP)
}

fn start(settings: InsertionSettings) -> Insertion {
    let tissue = Tissue::uniform(Vector3::zeros(), Vector3::z(), 1e4).unwrap();
    let bevel = Bevel::plane_cut(24_f64.to_radians(), 0.7e-3).unwrap();
    Insertion::new(Needle::biopsy(), bevel, tissue, settings, &base_at(0.0)).unwrap()
}

fn inserted(settings: InsertionSettings, step: f64, depth: f64) -> Insertion {
    let mut insertion = start(settings);
    let steps = (depth / step).round() as usize;
    for i in 1..=steps {
        insertion
            .insert(&base_at(depth * i as f64 / steps as f64), None)
            .unwrap();
    }
    insertion
}

#[test]
fn the_step_size_does_not_matter() {
    for rest_point in [RestPoint::ModelCentre, RestPoint::CuttingEdge] {
        let settings = InsertionSettings {
            rest_point,
            ..InsertionSettings::default()
        };
        let tip = |step| inserted(settings, step, 0.08).equilibrium().tip_position();
        let fine = tip(0.02e-3);
        println!("{rest_point:?}: tip {fine:?}");
        for step in [0.1e-3, 0.37e-3, 1e-3] {
            let gap = (tip(step) - fine).norm();
            println!("step {step}: {gap:e}");
            assert!(gap < 5e-6, "step {step}: {gap:e}");
        }
    }
}
