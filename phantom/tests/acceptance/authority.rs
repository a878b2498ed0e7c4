//! Authority of the base over the tip, and torsion.

use nalgebra::{Isometry3, Vector3};

use crate::support::{GJ, Rig, ideal};

/// Change of the tip's angle \[deg\] per millimetre of base shift at `depth` \[m\] of the path,
/// straight insertion.
fn tilt_per_mm(depth: f64) -> f64 {
    let mut rig = Rig::new(&ideal("tip.cut_angle_deg = 0"), 1);
    rig.insert(depth - rig.truth().depth);
    let shift = 0.2e-3;
    rig.shift(Vector3::x() * shift, 0.0);
    rig.direction().x.asin().to_degrees() / (shift * 1e3)
}

#[test]
fn base_authority_changes_sign_mid_insertion() {
    // Planar estimates with the tip held on its path, K = 1e4 N/m2, given as "about".
    for (depth_mm, expected) in [(10.0, -0.66), (30.0, -0.32), (50.0, -0.06), (70.0, 0.06)] {
        let found = tilt_per_mm(depth_mm * 1e-3);
        println!("{depth_mm} mm: {found:.3} deg/mm, estimate {expected}");
        assert!((found - expected).abs() < 0.04, "{depth_mm} mm: {found}");
    }
    let (mut low, mut high) = (0.03, 0.07);
    for _ in 0..12 {
        let depth = 0.5 * (low + high);
        if tilt_per_mm(depth) < 0.0 {
            low = depth;
        } else {
            high = depth;
        }
    }
    let lambda = (4.0 * 1.836e-3 / 1e4f64).powf(0.25);
    println!("zero at {:.2} mm = {:.3} lambda", low * 1e3, low / lambda);
    assert!((1.8..2.2).contains(&(low / lambda)));
}

#[test]
fn torsion_winds_up_as_friction_says() {
    for friction in [10.0, 30.0] {
        let changes = format!("friction.shaft_n_m = {friction}\ntip.cut_angle_deg = 0");
        let mut rig = Rig::new(&ideal(&changes), 1);
        rig.insert(0.08);
        let pose = rig.pose * Isometry3::rotation(Vector3::z() * 0.6);
        rig.go(pose, 1.0, 30);
        let length = rig.truth().needle.inserted_length();
        let free = 0.126 - length;
        let torque = friction * 0.35e-3;
        let expected = torque * length / GJ * (0.5 * length + free);
        let lag = -rig.truth().torsion;
        println!(
            "friction {friction} N/m: lag {:.4} deg, closed form {:.4}",
            lag.to_degrees(),
            expected.to_degrees()
        );
        // The last edge's middle lies a quarter of a millimetre before O.
        assert!((lag / expected - 1.0).abs() < 0.01, "{lag} {expected}");
        let moment = rig.plant_moment();
        assert!((moment / (torque * length) - 1.0).abs() < 0.01, "{moment}");
    }
}

impl Rig {
    /// Moment of the holder about the needle's axis \[N m\].
    fn plant_moment(&self) -> f64 {
        use phantom::Plant;
        let axis = self.world_from_phantom.rotation * Vector3::z();
        self.plant.truth().base_wrench.moment.dot(&axis)
    }
}

/// A needle in a guide answers as a shorter one that is clamped where the exit is.
#[test]
fn a_guide_holds_the_needle_at_its_exit() {
    // 40 mm deep, 30 mm from base or exit to the surface.
    let answer = |changes: &str| {
        let mut rig = Rig::new(&ideal(&format!("tip.cut_angle_deg = 0\n{changes}")), 1);
        rig.insert(0.04 - rig.truth().depth);
        let tip = rig.tip();
        rig.shift(Vector3::x() * 0.5e-3, 0.0);
        Vector3::new(rig.direction().x, rig.tip().x - tip.x, 0.0)
    };
    let clamped = answer("needle.length_mm = 70.0\nneedle.elements = 140");
    let guided = answer("guide.gap_mm = 30.0");
    let held_far = answer("");
    assert!(
        (guided - clamped).norm() < 0.01 * clamped.norm(),
        "{guided} {clamped}"
    );
    assert!((held_far - clamped).norm() > 0.2 * clamped.norm());
}

#[test]
fn a_shaft_lies_straight_in_its_guide_wherever_that_moves() {
    let mut rig = Rig::new(&ideal("guide.gap_mm = 30.0"), 1);
    rig.insert(0.03);
    rig.shift(Vector3::new(3e-3, -2e-3, 0.0), 1.0);
    rig.insert(0.03);
    let truth = rig.truth();
    let world_from_base = rig.world_from_phantom * rig.pose;
    let off = |arc: f64| {
        let point = truth.needle.point_at(arc).unwrap();
        world_from_base
            .inverse_transform_point(&point.into())
            .coords
            .xy()
            .norm()
    };
    // The base has come within 66 mm of the surface.
    assert!(off(0.020) < 1e-6 && off(0.034) < 5e-6, "{}", off(0.034));
    assert!(off(0.066) > 1e-4, "{}", off(0.066));
}
