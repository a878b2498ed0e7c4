//! Invariance, determinism, convergence.

use nalgebra::{Isometry3, Vector3};
use phantom::{Settings, Truth};

use crate::support::{Rig, ideal, standing};

/// Insertion with base motion, twist and every effect of `paper`.
fn winding(settings: &Settings, seed: u64, world_from_phantom: Isometry3<f64>) -> Rig {
    let mut rig = Rig::at(settings, seed, world_from_phantom);
    rig.insert(0.02);
    let tilt = rig.pose
        * Isometry3::new(
            Vector3::new(1e-3, -0.5e-3, 0.0),
            Vector3::new(0.01, 0.02, 0.8),
        );
    rig.go(tilt, 1.0, 30);
    rig.insert(0.02);
    rig
}

fn paper() -> Settings {
    Settings::preset("paper").unwrap()
}

#[test]
fn a_rigid_motion_of_the_laboratory_changes_nothing() {
    let here = winding(&paper(), 5, standing());
    let elsewhere = Isometry3::new(Vector3::new(-0.3, 0.7, 1.1), Vector3::new(0.4, -1.2, 2.0));
    let there = winding(&paper(), 5, elsewhere);
    let gap = (here.tip() - there.tip()).norm();
    println!("tips differ by {gap:.1e} m");
    // Rounding of coordinates of 1 m, amplified by the shaft's compliance.
    assert!(gap < 1e-9, "{gap}");
    assert!((here.direction() - there.direction()).norm() < 1e-7);
}

#[test]
fn needle_and_tissue_moving_together_is_rest() {
    // The base follows a steady drift of the tissue across and along the needle.
    let drift_mm_min = [30.0, -20.0, 10.0];
    let still = {
        let mut rig = Rig::new(&ideal("tip.cut_angle_deg = 1.75"), 1);
        rig.insert(0.04);
        rig
    };
    let mut moving = Rig::new(
        &ideal("tip.cut_angle_deg = 1.75\nmotion.drift_mm_min = [30.0, -20.0, 10.0]"),
        1,
    );
    let seconds = 40.0;
    let carried = Vector3::from(drift_mm_min) * (1e-3 / 60.0 * seconds);
    let mut pose = moving.pose;
    pose.translation.vector += carried + Vector3::z() * 0.04;
    moving.go(pose, seconds, 400);
    let gap = (moving.tip() - carried - still.tip()).norm();
    println!("tips differ by {gap:.1e} m");
    // Steps are cut at 0.1 mm of the base's way, which differs: an error of the step's order.
    assert!(gap < 2e-6, "{gap}");
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_one_does_not() {
    let bits = |rig: &Rig| {
        let truth: &Truth = rig.truth();
        let mut bits: Vec<u64> = truth
            .needle
            .centreline
            .iter()
            .chain(&truth.cut_path)
            .flat_map(|p| p.iter().map(|x| x.to_bits()).collect::<Vec<_>>())
            .collect();
        bits.push(truth.torsion.to_bits());
        bits.push(truth.base_wrench.moment.x.to_bits());
        bits
    };
    for name in ["paper", "harsh"] {
        let settings = Settings::preset(name).unwrap();
        let first = winding(&settings, 7, standing());
        assert_eq!(bits(&first), bits(&winding(&settings, 7, standing())));
        assert_ne!(bits(&first), bits(&winding(&settings, 8, standing())));
    }
}

/// Tip after 60 mm with `elements` edges in `steps` calls.
fn tip(elements: usize, steps: u32) -> Vector3<f64> {
    let changes = format!("needle.elements = {elements}\ntip.cut_angle_deg = 1.75");
    let mut rig = Rig::new(&ideal(&changes), 1);
    let pose = rig.pose * Isometry3::translation(0.0, 0.0, 0.06);
    rig.go(pose, 60.0, steps);
    rig.tip()
}

#[test]
fn converges_in_step_and_element_size() {
    let by_step: Vec<_> = [600, 1200, 2400, 4800].map(|n| tip(252, n)).to_vec();
    let gaps: Vec<f64> = by_step.windows(2).map(|w| (w[1] - w[0]).norm()).collect();
    println!("step 0.1, 0.05, 0.025, 0.0125 mm: tip moves by {gaps:?} m");
    // Halving the step: the change shrinks, and the default step is far below the sensor.
    assert!(gaps[0] < 5e-6, "{gaps:?}");
    assert!(gaps[2] < 0.6 * gaps[0], "{gaps:?}");
    let by_element: Vec<_> = [63, 126, 252, 504].map(|n| tip(n, 1200)).to_vec();
    let gaps: Vec<f64> = by_element
        .windows(2)
        .map(|w| (w[1] - w[0]).norm())
        .collect();
    let order = (gaps[0] / gaps[1]).log2();
    println!("elements 2, 1, 0.5, 0.25 mm: tip moves by {gaps:?} m, order {order:.2}");
    // First order at worst (the tip's direction is that of its last edge), and the default mesh
    // is right to about a micrometre.
    assert!(order > 1.0, "{gaps:?}");
    assert!(gaps[2] < 1e-6, "{gaps:?}");
}
