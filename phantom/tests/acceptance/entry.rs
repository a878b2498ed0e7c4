//! Entry sliding: the skin's hole pulls at the shaft and slides over the gel.

use nalgebra::{Isometry3, Vector3};

use crate::support::{GJ, Rig, ideal};

/// Hole in the phantom frame.
fn hole(rig: &Rig) -> Vector3<f64> {
    let hole = rig.plant.hole().unwrap();
    (rig.world_from_phantom.inverse() * nalgebra::Point3::from(hole)).coords
}

#[test]
fn without_skin_there_is_no_hole() {
    let mut rig = Rig::new(&ideal(""), 1);
    rig.insert(0.02);
    assert_eq!(rig.plant.hole(), None);
}

#[test]
fn the_skin_holds_until_its_hole_slides_for_good() {
    let skin = "tip.cut_angle_deg = 0\n[entry]\nskin_n_m = 1000\nslide_n = 0.4";
    let mut rig = Rig::new(&ideal(skin), 1);
    rig.insert(0.08);
    let start = hole(&rig);
    assert!(start.norm() < 1e-9, "{start}");
    // A small shift stretches the skin, whose hole stays.
    rig.shift(Vector3::x() * 0.3e-3, 0.0);
    assert!((hole(&rig) - start).norm() < 1e-12);
    let free = {
        let mut rig = Rig::new(&ideal("tip.cut_angle_deg = 0"), 1);
        rig.insert(0.08);
        rig.shift(Vector3::x() * 0.3e-3, 0.0);
        rig.truth().entry_stretch
    };
    let held = rig.truth().entry_stretch;
    assert!(held < 0.95 * free, "{held} {free}");
    // A large one drags it along, the stretch staying where the pull is 0.4 N.
    rig.shift(Vector3::x() * 8e-3, 0.0);
    let slid = hole(&rig);
    let needle = &rig.truth().needle;
    let crossing = rig.world_from_phantom.inverse()
        * nalgebra::Point3::from(needle.point_at(needle.entry_arc).unwrap());
    println!(
        "hole slid by {:.3} mm, stretch {:.4} mm",
        slid.x * 1e3,
        (crossing.x - slid.x) * 1e3
    );
    assert!(slid.x > 1e-3, "{slid}");
    assert!(
        (crossing.x - slid.x - 0.4e-3).abs() < 0.03e-3,
        "{crossing} {slid}"
    );
    assert!(slid.z.abs() < 1e-12);
    // Going back it stays, but for what the last step left to slide.
    rig.shift(Vector3::x() * -1e-3, 0.0);
    assert!((hole(&rig) - slid).norm() < 0.05e-3);
}

#[test]
fn the_skin_pulls_as_stiff_as_set() {
    // A needle so stiff that its shift at the entry is the base's.
    let stiff = "needle = { outer_diameter_mm = 3, inner_diameter_mm = 0, young_gpa = 500 }
                 tissue.stiffness_n_m2 = 100\ntip = { cut_angle_deg = 0, hold_n_m = 100 }";
    let pull = |skin: &str| {
        let mut rig = Rig::new(&ideal(&format!("{stiff}\n{skin}")), 1);
        rig.insert(0.1);
        rig.shift(Vector3::x() * 0.2e-3, 0.0);
        let x = rig.world_from_phantom.rotation * Vector3::x();
        rig.truth().base_wrench.force.dot(&x)
    };
    let found = (pull("entry.skin_n_m = 500") - pull("")) / 0.2e-3;
    println!("skin of 500 N/m pulls with {found:.1} N/m");
    // The shaft's deflection by 0.1 N on a lever of 26 mm: 0.3 um of 200.
    assert!((found / 500.0 - 1.0).abs() < 0.02, "{found}");
}

#[test]
fn the_skin_grips_along_and_around() {
    let grip = "tip.cut_angle_deg = 0\nfriction.shaft_n_m = 0.001\nentry.grip_n = 0.3";
    let mut rig = Rig::new(&ideal(grip), 1);
    rig.insert(0.04);
    let axis = rig.world_from_phantom.rotation * Vector3::z();
    let push = rig.truth().base_wrench.force.dot(&axis);
    assert!((push / 0.3 - 1.0).abs() < 0.01, "{push}");
    let pose = rig.pose * Isometry3::rotation(Vector3::z() * 0.6);
    rig.go(pose, 1.0, 30);
    let lag = -rig.truth().torsion;
    let free = 0.126 - rig.truth().needle.inserted_length();
    let expected = 0.3 * 0.35e-3 * free / GJ;
    println!(
        "lag {:.4} deg, closed form {:.4}",
        lag.to_degrees(),
        expected.to_degrees()
    );
    assert!((lag / expected - 1.0).abs() < 0.02, "{lag} {expected}");
}

#[test]
fn gel_slides_under_a_skin_that_does_not_follow() {
    let moving = |follow: f64| {
        let changes = format!(
            "tip.cut_angle_deg = 0\nmotion.drift_mm_min = [6.0, 0.0, 0.0]
             [entry]\nskin_n_m = 300\nfollow = {follow}"
        );
        let mut rig = Rig::new(&ideal(&changes), 1);
        rig.insert(0.02);
        hole(&rig).x
    };
    // 20 s of 0.1 mm/s.
    assert!((moving(1.0) - 2e-3).abs() < 1e-9);
    assert!((moving(0.25) - 0.5e-3).abs() < 1e-9);
}
