//! The robot's flaws at rest and in motion, and what the presets set.

use hal::{Stamp, Transform};
use nalgebra::{Isometry3, Vector3};
use phantom::experiment::default_setup;
use phantom::{Bench, Settings};

use crate::support::ideal;

/// Moves the nominal base by `way` and `turn` (its own frame) in `seconds` and `steps` calls.
fn go(bench: &mut Bench, pose: &mut Isometry3<f64>, way: Vector3<f64>, turn: f64, seconds: f64) {
    let begin = bench.now().as_secs();
    let from = *pose;
    let steps = (seconds * 60.0).ceil();
    let mut i = 0.0;
    while i < steps {
        i += 1.0;
        let share = i / steps;
        *pose = from * Isometry3::new(way * share, Vector3::z() * (turn * share));
        let now = Stamp::from_secs(begin + seconds * share);
        bench.advance_to(now, &Transform::assume(*pose));
    }
}

#[test]
fn servos_lag_by_their_time_constant() {
    let settings = ideal("robot.servo_lag_ms = 15");
    let setup = default_setup(&settings, 1);
    let mut bench = Bench::new(&settings, &setup).unwrap();
    let start = *setup.world_from_base.isometry();
    let mut pose = start;
    go(&mut bench, &mut pose, Vector3::z() * 0.01, 0.5, 10.0);
    let truth = bench.truth();
    let seconds = truth.stamp.as_secs();
    let there = start.inverse() * truth.world_from_base.isometry();
    // A first-order lag behind a steady motion: by speed times time constant.
    let expected = 1e-3 * (seconds - 0.015);
    assert!((there.translation.vector.z - expected).abs() < 1e-9);
    let turned = there.rotation.scaled_axis().z;
    assert!((turned - 0.05 * (seconds - 0.015)).abs() < 1e-8, "{turned}");
}

#[test]
fn the_holder_yields_to_the_needle() {
    let settings = ideal("robot = { compliance_mm_n = 0.5, compliance_deg_nm = 50 }");
    let setup = default_setup(&settings, 1);
    let mut bench = Bench::new(&settings, &setup).unwrap();
    let mut pose = *setup.world_from_base.isometry();
    go(&mut bench, &mut pose, Vector3::z() * 0.04, 0.0, 20.0);
    go(&mut bench, &mut pose, Vector3::x() * 3e-3, 0.0, 1.0);
    go(&mut bench, &mut pose, Vector3::zeros(), 0.0, 2.0);
    let truth = bench.truth();
    let yielded = pose.inverse() * truth.world_from_base.isometry();
    let into_base = pose.rotation.inverse();
    let force = into_base * truth.base_wrench.force;
    let moment = into_base * truth.base_wrench.moment;
    let (way, turn) = (yielded.translation.vector, yielded.rotation.scaled_axis());
    println!(
        "yields by {:.4} mm and {:.4} deg",
        way.norm() * 1e3,
        turn.norm().to_degrees()
    );
    assert!(
        force.xy().norm() > 0.02 && moment.xy().norm() > 1e-3,
        "{force} {moment}"
    );
    // The force is that of the last exposure: at rest the same.
    assert!((way.xy() + force.xy() * 0.5e-3).norm() < 1e-7, "{way}");
    let angular = 50f64.to_radians();
    assert!((turn.xy() + moment.xy() * angular).norm() < 1e-5, "{turn}");
    assert!(way.z.abs() < 1e-12 && turn.z.abs() < 1e-6);
}

#[test]
fn the_bevel_is_mounted_askew_as_set() {
    let settings = ideal("spread.azimuth_deg = 10");
    let mut squares = 0.0;
    for seed in 1..=100 {
        let setup = default_setup(&settings, seed);
        let bench = Bench::new(&settings, &setup).unwrap();
        let nominal = setup.world_from_base.isometry().rotation;
        let tip = bench.truth().needle.world_from_tip.isometry().rotation;
        let turn = (nominal.inverse() * tip).scaled_axis();
        assert!((turn - Vector3::z() * bench.draw().azimuth).norm() < 1e-9);
        squares += turn.z.powi(2) / 100.0;
    }
    let sigma = f64::sqrt(squares).to_degrees();
    // A hundred numbers: 7 % standard error.
    assert!((sigma / 10.0 - 1.0).abs() < 0.2, "{sigma}");
}

#[test]
fn presets_are_what_the_documents_say() {
    let preset = |name| Settings::preset(name).unwrap();
    assert_eq!(preset("ideal"), Settings::default());
    let sensor = |name| {
        let s = preset(name).sensor;
        let noise = [s.noise_mm, s.direction_noise_deg, s.bias_mm];
        (
            noise,
            [s.rate_hz, s.latency_ms, s.drop_fraction, s.spacing_mm],
        )
    };
    let fast = ([0.05, 0.1, 0.0], [30.0, 50.0, 0.02, 2.5]);
    assert_eq!(sensor("paper"), fast);
    assert_eq!(sensor("paper-compliant"), fast);
    assert_eq!(
        sensor("harsh"),
        ([0.25, 1.0, 0.15], [30.0, 100.0, 0.3, 2.5])
    );
    let (paper, mut compliant) = (preset("paper"), preset("paper-compliant"));
    assert_eq!(compliant.tip.compliance_deg_n.to_bits(), 10f64.to_bits());
    // The second family differs in the law of the tip alone.
    compliant.tip.compliance_deg_n = paper.tip.compliance_deg_n;
    compliant.tip.cut_angle_deg = paper.tip.cut_angle_deg;
    assert_eq!(compliant, paper);
    let harsh = preset("harsh");
    assert!(harsh.motion.breathing_mm >= 2.0 && harsh.friction.static_ratio > 1.0);
    assert!(harsh.tissue.layers.len() == 2 && harsh.entry.skin_n_m > 0.0);
    // Ideal has none of it.
    let ideal = preset("ideal");
    assert_eq!(ideal.tissue.layers, []);
}
