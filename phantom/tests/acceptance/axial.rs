//! Forces along the needle: cutting, membranes, friction, stick and slip.

use nalgebra::{Isometry3, Vector3};
use phantom::Plant;

use crate::support::{Rig, ideal};

/// Push of the holder along the needle \[N\].
fn push(rig: &Rig) -> f64 {
    let axis = rig.world_from_phantom.rotation * Vector3::z();
    rig.plant.truth().base_wrench.force.dot(&axis)
}

#[test]
fn the_holder_pushes_against_cutting_and_friction() {
    let mut rig = Rig::new(
        &ideal("tip = { cut_angle_deg = 0, cutting_n = 0.4 }\nfriction.shaft_n_m = 10"),
        1,
    );
    rig.insert(0.05);
    let inward = push(&rig);
    rig.insert(-0.01);
    let outward = push(&rig);
    println!("50 mm deep: {inward:.4} N of 0.9 inwards; 40 mm: {outward:.4} N of -0.4 outwards");
    // Half an edge of the mesh is 2.5 mN of friction.
    assert!((inward - 0.9).abs() < 5e-3, "{inward}");
    assert!((outward + 0.4).abs() < 5e-3, "{outward}");
}

#[test]
fn a_membrane_holds_the_tip_until_it_is_punctured() {
    let layer = "tip = { cut_angle_deg = 0, cutting_n = 0.3 }\n[[tissue.layers]]\nfrom_mm = 20\n\
                 stiffness_ratio = 1\ncut_ratio = 1\npuncture_n = 0.8";
    let mut rig = Rig::new(&ideal(layer), 1);
    rig.insert(0.017);
    let before = push(&rig);
    let mut most: f64 = 0.0;
    // The edge is a bevel length ahead of O.
    for _ in 0..100 {
        rig.insert(2e-5);
        most = most.max(push(&rig));
    }
    let after = push(&rig);
    println!("cutting {before:.3} N, membrane {most:.3} N of 0.8, then {after:.3} N");
    assert!((before - 0.3).abs() < 3e-3, "{before}");
    // It gives way between two steps of 2 % of its travel.
    assert!((0.78..0.801).contains(&most), "{most}");
    assert!((after - 0.3).abs() < 3e-3, "{after}");
}

#[test]
fn friction_sticks_and_slips() {
    let settings = ideal(
        "tip.cut_angle_deg = 0\nfriction = { shaft_n_m = 10, presliding_um = 20, static_ratio = 1.3 }",
    );
    let mut rig = Rig::new(&settings, 1);
    rig.insert(0.05);
    let sliding = push(&rig);
    let mut most: f64 = 0.0;
    for _ in 0..200 {
        let pose = rig.pose * Isometry3::translation(0.0, 0.0, -0.5e-6);
        rig.go(pose, 0.01, 1);
        most = most.max(-push(&rig));
    }
    let last = -push(&rig);
    println!("inwards {sliding:.4} N; outwards {most:.4} N at most, then {last:.4} N");
    assert!((sliding - 0.5).abs() < 5e-3, "{sliding}");
    // A step is 2.5 % of the elastic slide; the steel's stretch of a micrometre another 5 %.
    assert!((most / sliding - 1.3).abs() < 0.06, "{most}");
    assert!((last / sliding - 1.0).abs() < 0.02, "{last}");
}
