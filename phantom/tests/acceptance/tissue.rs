//! Laws of the tissue seen from outside.

use nalgebra::Vector3;
use phantom::Plant;

use crate::support::{Rig, ideal};

/// Lateral force of the bed on the needle along x, from the holder's and the tip's.
fn bed_force(rig: &Rig) -> f64 {
    let into_phantom = rig.world_from_phantom.rotation.inverse();
    let truth = rig.truth();
    -(into_phantom * (truth.base_wrench.force + truth.tip_force)).x
}

#[test]
fn relaxation_has_its_time_constant_and_fraction() {
    // A needle so stiff in a bed so soft that the bed's displacement is the base's.
    let settings = ideal(
        "needle = { outer_diameter_mm = 3, inner_diameter_mm = 0, young_gpa = 500, shear_gpa = 200 }
         tissue = { stiffness_n_m2 = 100, relaxed_fraction = 0.2, relaxation_s = 20 }
         tip = { cut_angle_deg = 0, hold_n_m = 100 }",
    );
    let mut rig = Rig::new(&settings, 1);
    rig.insert(0.06);
    let pose = rig.pose * nalgebra::Isometry3::translation(0.5e-3, 0.0, 0.0);
    rig.go(pose, 0.0, 10);
    let initial = bed_force(&rig);
    rig.go(pose, 20.0, 200);
    let after_tau = bed_force(&rig);
    rig.go(pose, 400.0, 400);
    let lasting = bed_force(&rig);
    let share = (after_tau - lasting) / (initial - lasting);
    let time_constant = -20.0 / share.ln();
    let fraction = 1.0 - lasting / initial;
    println!("time constant {time_constant:.3} s of 20, fraction {fraction:.4} of 0.2");
    assert!((time_constant / 20.0 - 1.0).abs() < 5e-3, "{time_constant}");
    assert!((fraction / 0.2 - 1.0).abs() < 5e-3, "{fraction}");
}

/// Bed force over the integral of `law` on the true displacement from a straight path.
fn force_over_law(changes: &str, law: impl Fn(f64) -> f64) -> f64 {
    let mut rig = Rig::new(&ideal(&format!("{changes}\ntip.cut_angle_deg = 0")), 1);
    rig.insert(0.05);
    rig.shift(Vector3::x() * 6e-3, 0.0);
    let needle = &rig.truth().needle;
    let into_phantom = rig.world_from_phantom.inverse();
    let pieces = 400;
    let ds = needle.inserted_length() / f64::from(pieces);
    let sum: f64 = (0..pieces)
        .map(|i| {
            let arc = needle.entry_arc + ds * (f64::from(i) + 0.5);
            let point = needle.point_at(arc).unwrap();
            law((into_phantom * nalgebra::Point3::from(point)).x) * ds
        })
        .sum();
    -bed_force(&rig) / sum
}

#[test]
fn reaction_follows_the_law_of_displacement() {
    let (k, d, g) = (1e4, 0.7e-3, 0.1e-3);
    let linear = force_over_law("", |u| k * u);
    let stiffening = force_over_law("tissue.stiffening = 0.5", |u| {
        k * u * (1.0 + 0.5 * (u / d).powi(2))
    });
    let slit = force_over_law("tissue.slit_gap_um = 100", |u| {
        k * (u.hypot(g) - g) * u.signum()
    });
    println!("force over law: linear {linear:.4}, stiffening {stiffening:.4}, slit {slit:.4}");
    for ratio in [linear, stiffening, slit] {
        // The bed's sums and the integral here split the shaft differently.
        assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    }
}

#[test]
fn layers_scale_stiffness_and_cut_angle() {
    let changes = "tip.cut_angle_deg = 1.5\n[[tissue.layers]]\nfrom_mm = 0\nstiffness_ratio = 2\n\
                   cut_ratio = 0.8\npuncture_n = 0";
    let mut layered = Rig::new(&ideal(changes), 1);
    let plain = "tissue.stiffness_n_m2 = 2e4\ntip.cut_angle_deg = 1.2";
    let mut plain = Rig::new(&ideal(plain), 1);
    layered.insert(0.05);
    plain.insert(0.05);
    // The layer blends in over half a millimetre at the surface.
    assert!((layered.tip() - plain.tip()).norm() < 10e-6);
    assert!(layered.tip().xy().norm() > 2e-3);
}

#[test]
fn tearing_shifts_the_path_for_good() {
    let mut rig = Rig::new(&ideal("tissue.tear_mm = 1.0\ntip.cut_angle_deg = 0"), 1);
    rig.insert(0.04);
    let mut torn = None;
    for _ in 0..60 {
        rig.shift(Vector3::x() * 0.25e-3, 0.0);
        for event in &rig.truth().events {
            if let phantom::Event::Tearing { depth_m, .. } = event {
                torn.get_or_insert(*depth_m);
            }
        }
    }
    // Near the surface, where the shaft pushes hardest.
    assert!(torn.unwrap() < 2e-3, "{torn:?}");
    assert!(
        rig.truth().max_stretch < 1.05e-3,
        "{}",
        rig.truth().max_stretch
    );
    rig.shift(Vector3::x() * -15e-3, 0.0);
    let entry =
        rig.world_from_phantom.inverse() * nalgebra::Point3::from(rig.plant.truth().cut_path[0]);
    assert!(entry.x > 0.5e-3, "the torn path came back: {}", entry.x);
}
