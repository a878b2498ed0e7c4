//! Insertions with devices of fewer joints than an arm: what they can do is used, the rest is left
//! out of the plan.

use std::path::Path;

use hybrid_control::Unreachable;
use needle_steer::aim::TargetRefused;
use needle_steer::config::{self, Config};
use needle_steer::outcome::Ended;
use needle_steer::rig::{self, Misfit, Rig, RigBuildError};
use needle_steer::run::{RunError, simulate};

/// The device of that name in `robots/urdf`, where the configuration puts its base.
fn unplaced(device: &str, more: &[&str]) -> Config {
    let urdf = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../robots/urdf/{device}.urdf"));
    let mut overrides = vec![
        format!("arm.urdf={:?}", urdf.to_str().unwrap()),
        "arm.tip_link=needle_base".to_owned(),
        "arm.mechanism=true".to_owned(),
        "run.sensor=shape".to_owned(),
    ];
    overrides.extend(more.iter().map(ToString::to_string));
    config::load(None, &overrides).unwrap()
}

/// The same where it can insert.
pub(crate) fn placed(device: &str, more: &[&str]) -> Config {
    rig::placed(&unplaced(device, more)).unwrap()
}

fn error(config: &Config) -> f64 {
    let summary = simulate(config).unwrap();
    assert_eq!(summary.ended, Ended::TargetPassed, "{}", config.arm.urdf);
    summary.true_error_mm.unwrap()
}

#[test]
fn a_stage_passes_targets_by_bevel_and_shift() {
    for kind in ["target.kind=aligned", "target.kind=shifted"] {
        for seed in ["run.seed=1", "run.seed=2"] {
            let off = error(&placed("stage", &[kind, seed]));
            assert!(off < 0.1, "{kind}, {seed}: {off} mm");
        }
    }
}

#[test]
fn insertion_and_spin_pass_an_aligned_target() {
    for law in ["run.law=hybrid", "run.law=tip-only"] {
        let off = error(&placed("insertion_spin", &["target.kind=aligned", law]));
        assert!(off < 0.1, "{law}: {off} mm");
    }
}

#[test]
fn what_a_device_cannot_do_is_refused_before_it_moves() {
    let aside = placed("insertion_spin", &["target.kind=shifted"]);
    let refused = simulate(&aside).unwrap_err();
    let RunError::Target(TargetRefused::Unreachable(Unreachable::Aside { reach_mm, .. })) = refused
    else {
        panic!("{refused}");
    };
    assert!((4.0..9.0).contains(&reach_mm), "{reach_mm}");
    let pivots = placed(
        "insertion_spin",
        &["target.kind=aligned", "run.law=base-only"],
    );
    let refused = simulate(&pivots).unwrap_err().to_string();
    assert!(refused.contains("law base-only"), "{refused}");
}

#[test]
fn a_device_that_is_mounted_elsewhere_is_refused_with_figures() {
    let beside = placed("stage", &[]);
    let mut config = beside.clone();
    // Beyond the travel of its axis across the needle.
    config.arm.base_mm[0] += 80.0;
    let refused = Rig::new(&config).unwrap_err();
    let RigBuildError::Misfit(Misfit::Mounted { across_mm, .. }) = refused else {
        panic!("{refused}");
    };
    assert!((15.0..40.0).contains(&across_mm), "{across_mm}");
    // One that stands a little aside makes up for it.
    config.arm.base_mm[0] -= 79.0;
    let rig = Rig::new(&config).unwrap();
    let moved = rig.home[0] - Rig::new(&beside).unwrap().home[0];
    assert!((moved.abs() - 1e-3).abs() < 1e-5, "{moved} m");
}

#[test]
fn a_stage_that_is_too_short_is_refused_in_millimetres() {
    let mut config = placed("stage", &[]);
    // The slide then starts 80 mm further on.
    config.arm.base_mm[2] += 80.0;
    let refused = Rig::new(&config).unwrap_err().to_string();
    assert!(
        refused.contains("joint_z comes to its end (150.0 mm)"),
        "{refused}"
    );
}

/// A thick needle through a guide in a stiff gel, as docs/REAL_NEEDLES.md has it.
pub(crate) fn through_a_guide(more: &[&str]) -> Config {
    let mut settings = vec![
        "run.phantom=gel-guide",
        "needle.support=\"guide\"",
        "needle.guide_gap_mm=25.0",
        "needle.length_mm=200.0",
        "needle.outer_diameter_mm=1.27",
        "needle.inner_diameter_mm=0.84",
        "estimator.stiffness_n_m2=2.1e5",
        "estimator.stiffness_sigma=0.1",
        "estimator.cut_angle_deg=0.36",
        "estimator.cut_angle_sigma=0.1",
        "estimator.tip_compliance_deg_n=0.1",
        "supervisor.tissue_stretch_mm=5.5",
    ];
    settings.extend(more);
    placed("guide", &settings)
}

#[test]
fn a_guide_near_the_tissue_passes_targets_by_shift() {
    for offset in ["target.offset_mm=0", "target.offset_mm=5"] {
        for seed in ["run.seed=1", "run.seed=2"] {
            let off = error(&through_a_guide(&[offset, seed]));
            assert!(off < 0.5, "{offset}, {seed}: {off} mm");
        }
    }
}

#[test]
fn an_electromagnetic_tip_in_an_even_field_closes_the_loop() {
    // What a distorted field costs is in docs/REAL_NEEDLES.md.
    let even = [
        "run.sensor=em",
        "target.kind=aligned",
        "phantom.em.distortion_mm=0.0",
        "phantom.em.axis_distortion_mrad=0.0",
    ];
    let stage = placed("stage", &even);
    let off = error(&stage);
    assert!(off < 0.2, "{off} mm");
    let summary = simulate(&stage).unwrap();
    assert_eq!(summary.true_error_less_bias_mm, summary.true_error_mm);
}

#[test]
fn a_guide_too_near_is_refused_with_its_key() {
    let config = through_a_guide(&["needle.guide_gap_mm=0.5"]);
    let refused = Rig::new(&config).unwrap_err().to_string();
    assert!(refused.contains("needle.guide_gap_mm"), "{refused}");
}
