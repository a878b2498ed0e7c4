//! A sample of the no-divergence campaign, and the moving target: every step audited.

use needle_steer::config;
use needle_steer::experiments::in_parallel;
use needle_steer::outcome::Ended;
use needle_steer::robustness::{Case, breathing, carry_out};
use needle_steer::run::simulate;

/// Cases of the sample: 28 meet every law with every preset.
const SAMPLE: u64 = 28;

#[test]
fn no_sampled_run_diverges_or_breaks_a_limit() {
    // Far apart in the campaign, so that sensors and start values differ too.
    let cases: Vec<Case> = (0..SAMPLE).map(|i| Case::new(36 * i % 1000)).collect();
    let outcomes = in_parallel(&cases, 2, |case| {
        carry_out(&case.config().unwrap()).unwrap()
    });
    for (case, outcome) in cases.iter().zip(&outcomes) {
        assert!(
            outcome.violations.is_empty(),
            "case {} ({}): {}",
            case.index,
            case.overrides.join(" "),
            outcome
                .violations
                .iter()
                .map(ToString::to_string)
                .collect::<Vec<_>>()
                .join("; ")
        );
    }
    // An audit that sees nothing would pass everything: most runs get to their targets.
    let passed = outcomes
        .iter()
        .filter(|o| o.ended == Ended::TargetPassed)
        .count();
    assert!(passed >= usize::try_from(SAMPLE).unwrap() / 2, "{passed}");
}

#[test]
fn an_audit_sees_a_broken_limit() {
    let mut config = Case::new(6).config().unwrap();
    let mut outcome = carry_out(&config).unwrap();
    assert!(outcome.violations.is_empty(), "{:?}", outcome.violations);
    // The same run in less time than it needs.
    config.run.max_duration_s = 20.0;
    outcome = carry_out(&config).unwrap();
    assert_eq!(outcome.violations[0].kind, "no verdict in time");
}

/// On the springs model nothing holds the tip, as the predictor first takes it to be.
#[test]
fn a_tip_that_nothing_holds_is_steered_too() {
    for seed in [1011, 1012, 1013] {
        let seed = format!("run.seed={seed}");
        let aside = ["target.offset_mm=10.0", "target.angle_deg=135.0"];
        let plant = ["run.plant=springs", "run.sensor=shape", seed.as_str()];
        let sets: Vec<String> = [&plant[..], &aside]
            .concat()
            .into_iter()
            .map(ToOwned::to_owned)
            .collect();
        let config = config::load(None, &sets).unwrap();
        let summary = simulate(&config).unwrap();
        // As the bevel's and the filter's noise leave it on this plant, with room for other seeds.
        assert!(
            summary.true_error_mm.is_some_and(|off| off < 0.25),
            "{summary:?}"
        );
    }
}

/// In a half-space the tip is half held and the slit follows the bevel late: aligned targets are hit by
/// base, by both and by the bevel alone, one aside by law `paper`.
#[test]
fn a_needle_in_a_half_space_is_steered() {
    for (law, angle, most) in [
        ("hybrid", 0.0, 0.15),
        ("paper", 0.0, 0.25),
        ("tip-only", 0.0, 0.25),
        ("paper", 135.0, 0.25),
    ] {
        for seed in [1011, 1012] {
            let sets = [
                "run.plant=continuum".to_owned(),
                "run.sensor=shape".to_owned(),
                format!("run.law={law}"),
                format!("run.seed={seed}"),
                format!("target.offset_mm={}", if angle > 0.0 { 10.0 } else { 0.0 }),
                format!("target.angle_deg={angle:?}"),
            ];
            let summary = simulate(&config::load(None, &sets).unwrap()).unwrap();
            assert_eq!(summary.ended, Ended::TargetPassed, "{law}: {summary:?}");
            // What no simulation may hide: lost balance, a shaft that gave way.
            assert!(summary.events.is_empty(), "{law}: {:?}", summary.events);
            assert!(
                summary.true_error_mm.is_some_and(|off| off < most),
                "{law}: {summary:?}"
            );
        }
    }
}

/// A marker that breathing carries by 5 mm: the asked 0.5 mm median is kept by every single run.
#[test]
fn a_breathing_target_is_met() {
    for (seed, ratio) in [(1000, 0.2), (1001, 0.5)] {
        let mut overrides: Vec<String> = breathing().map(str::to_owned).to_vec();
        overrides.push(format!("run.seed={seed}"));
        overrides.push("run.sensor=shape".to_owned());
        // What the controller believes of the surface at first may be wrong.
        overrides.push(format!("motion.surface_ratio={ratio}"));
        let summary = simulate(&config::load(None, &overrides).unwrap()).unwrap();
        assert_eq!(summary.ended, Ended::TargetPassed);
        let error = summary.true_error_mm.unwrap();
        assert!(error < 0.5, "seed {seed}: {error} mm");
    }
}

/// Breathing that is known from the needle alone is known to a third of a millimetre, whatever the sensor
/// resolves: one that is five times as good as that of `harsh` must not lead astray.
#[test]
fn a_good_sensor_is_not_believed_beyond_the_breathing() {
    for seed in 1..=4 {
        let sets = [
            "run.phantom=harsh".to_owned(),
            "run.sensor=shape".to_owned(),
            "target.kind=shifted".to_owned(),
            "phantom.sensor.noise_mm=0.05".to_owned(),
            format!("run.seed={seed}"),
        ];
        let summary = simulate(&config::load(None, &sets).unwrap()).unwrap();
        assert_eq!(summary.ended, Ended::TargetPassed, "seed {seed}");
        // As far off as with the preset's own sensor (95 %); believed, it ends 4 to 32 mm off.
        let error = summary.true_error_mm.unwrap();
        assert!(error < 1.0, "seed {seed}: {error} mm");
    }
}
