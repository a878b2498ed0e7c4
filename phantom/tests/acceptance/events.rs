//! What cannot be simulated is reported: no NaN, no hang, no panic.

use hal::{Stamp, Transform};
use nalgebra::{Isometry3, Vector3};
use phantom::{Event, Plant, Settings, SettingsError};

use crate::support::{Rig, finite, ideal, standing};

/// Moves to `pose` and collects the events.
fn go(rig: &mut Rig, pose: Isometry3<f64>, steps: u32) -> Vec<Event> {
    let mut events = Vec::new();
    rig.go_with(pose, f64::from(steps) * 0.033, steps, |plant, _| {
        events.extend_from_slice(&plant.truth().events);
        assert!(finite(plant.truth()));
    });
    events
}

#[test]
fn pushing_too_hard_buckles() {
    // 2 N of cutting force and 100 N/m of friction against 2.33 N of buckling load.
    let settings = ideal("tip.cutting_n = 2\nfriction.shaft_n_m = 100");
    let mut rig = Rig::new(&settings, 1);
    let pose = rig.pose * Isometry3::translation(0.0, 0.0, 0.05);
    let events = go(&mut rig, pose, 500);
    let buckled = events
        .iter()
        .any(|e| matches!(e, Event::Buckling | Event::Yielding { .. }));
    assert!(buckled, "{events:?}");
}

#[test]
fn withdrawing_leaves_the_tissue_and_the_old_hole_is_found_again() {
    let mut rig = Rig::new(&ideal("tip.cut_angle_deg = 1.75"), 1);
    rig.insert(0.02);
    let path = rig.truth().cut_path.clone();
    let out = rig.pose * Isometry3::translation(0.0, 0.0, -0.03);
    let events = go(&mut rig, out, 300);
    assert!(events.contains(&Event::PulledOut), "{events:?}");
    assert_eq!(rig.truth().max_stretch.to_bits(), 0);
    assert!(rig.truth().base_wrench.force.norm() < 1e-9);
    let back = rig.pose * Isometry3::translation(0.0, 0.0, 0.025);
    let events = go(&mut rig, back, 250);
    assert!(
        events.contains(&Event::Entered { reused: true }),
        "{events:?}"
    );
    assert_eq!(rig.truth().cut_path, path);
    // Elsewhere a new path begins.
    go(&mut rig, out, 250);
    let beside = out * Isometry3::translation(5e-3, 0.0, 0.0);
    go(&mut rig, beside, 50);
    let events = go(
        &mut rig,
        beside * Isometry3::translation(0.0, 0.0, 0.03),
        300,
    );
    assert!(
        events.contains(&Event::Entered { reused: false }),
        "{events:?}"
    );
}

#[test]
fn wild_motion_is_survived() {
    let mut rig = Rig::new(&Settings::preset("paper").unwrap(), 3);
    rig.insert(0.03);
    // Sideways by 40 mm and over by 60 degrees at once, then back.
    let wild = rig.pose * Isometry3::new(Vector3::new(0.04, 0.0, 0.0), Vector3::new(0.0, 1.0, 0.0));
    let events = go(&mut rig, wild, 3);
    assert!(!events.is_empty());
    let home = Isometry3::translation(0.0, 0.0, -0.2);
    go(&mut rig, home, 20);
}

#[test]
fn nonsense_is_refused_and_changes_nothing() {
    let mut rig = Rig::new(&ideal(""), 1);
    rig.insert(0.01);
    let before = rig.truth().clone();
    let good = standing() * rig.pose;
    let nan = Isometry3::translation(f64::NAN, 0.0, 0.0);
    let far = good * Isometry3::translation(1.0, 0.0, 0.0);
    let late = Stamp::from_secs(rig.seconds + 1.0);
    for (pose, stamp) in [(nan, late), (far, late), (good, Stamp::from_secs(1.0))] {
        rig.plant.advance(&Transform::assume(pose), stamp);
        assert_eq!(rig.plant.truth().events, [Event::Refused]);
        assert_eq!(rig.plant.truth().needle, before.needle);
    }
    rig.plant.advance(&Transform::assume(good), late);
    assert!(rig.plant.truth().events.is_empty());
}

#[test]
fn settings_outside_their_range_are_refused_with_the_range() {
    let error = |changes: &str| {
        Settings::default()
            .overridden(changes.parse().unwrap())
            .unwrap_err()
    };
    assert_eq!(
        error("tissue.stiffness_n_m2 = -1").to_string(),
        "tissue.stiffness_n_m2 = -1: must be from 100 to 1000000"
    );
    for bad in [
        "tip.cut_angle_deg = nan",
        "sensor.rate_hz = inf",
        "needle.elements = 2",
        "friction.static_ratio = 0.5",
        "motion.drift_mm_min = [nan, 0.0, 0.0]",
    ] {
        assert!(
            matches!(error(bad), SettingsError::OutOfRange { .. }),
            "{bad}"
        );
    }
    assert!(matches!(
        error("needle.inner_diameter_mm = 0.7"),
        SettingsError::Inconsistent { .. }
    ));
    assert!(
        error("tissue.stifness = 1")
            .to_string()
            .contains("stifness")
    );
    assert!(matches!(
        Settings::preset("papr"),
        Err(SettingsError::UnknownPreset { .. })
    ));
}
