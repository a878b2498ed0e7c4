//! What docs/HAZARDS.md promises of a run, on whole simulated insertions.

use hal::telemetry::{Limit, Phase, Telemetry};
use needle_steer::config::{self, Config, TargetKind};
use needle_steer::controls::Controls;
use needle_steer::outcome::{Ended, Summary};
use needle_steer::rig::{Rig, RigBuildError};
use needle_steer::run::{Observer, run};
use needle_steer::supervisor::StopReason;

fn config(overrides: &[&str]) -> Config {
    let overrides: Vec<String> = overrides.iter().map(|o| (*o).to_owned()).collect();
    config::load(None, &overrides).unwrap()
}

/// An uncontrolled insertion of 20 mm into the flawless phantom.
fn short_insertion() -> Config {
    let mut config = config(&["run.phantom=ideal", "run.law=none", "run.sensor=shape"]);
    config.target.kind = TargetKind::Aligned;
    config.target.depth_mm = 20.0;
    config
}

/// Keeps every step, and refreshes the dead-man's token where that is `held`.
struct Script<'a, F> {
    controls: &'a Controls,
    held: F,
    steps: Vec<Telemetry>,
}

impl<F: FnMut(&Telemetry) -> bool> Observer for Script<'_, F> {
    fn step(&mut self, telemetry: &Telemetry) {
        if (self.held)(telemetry) {
            self.controls.refresh_dead_man();
        }
        self.steps.push(telemetry.clone());
    }
}

fn insert(config: &Config, held: impl FnMut(&Telemetry) -> bool) -> (Summary, Vec<Telemetry>) {
    let controls = Controls::default();
    // What was given before a run is no sign of life.
    controls.refresh_dead_man();
    let mut steps = Script {
        controls: &controls,
        held,
        steps: Vec::new(),
    };
    let mut rig = Rig::new(config).unwrap();
    let summary = run(config, &mut rig, &mut steps, &controls).unwrap();
    (summary, steps.steps)
}

/// Height of the needle's base in World [mm].
fn height(telemetry: &Telemetry) -> f64 {
    telemetry.world_from_base.origin().coords().z * 1e3
}

#[test]
fn an_insertion_stops_at_its_workspace_box() {
    let mut config = short_insertion();
    let start = height(&insert(&config, |_| false).1[0]);
    // A floor 12 mm below the start, on the way to the target.
    let floor = start - 12.0;
    config.supervisor.workspace_min_mm[2] = floor;
    // Else it is refused before anything moves.
    config.run.check_reach = false;
    config.validate().unwrap();
    let (summary, steps) = insert(&config, |_| false);
    assert!(
        matches!(
            summary.ended,
            Ended::Stopped(StopReason::WorkspaceBox { .. })
        ),
        "{summary:?}"
    );
    let lowest = steps.iter().map(height).fold(f64::INFINITY, f64::min);
    // The guard works on feedback that is a few milliseconds old.
    assert!(
        (floor - 0.05..floor + 0.3).contains(&lowest),
        "{lowest} mm, box from {floor} mm"
    );
    let last = &steps[steps.len() - 1];
    assert!(last.law.limits.contains(&Limit::Workspace));
}

#[test]
fn a_start_outside_the_workspace_box_is_refused() {
    let mut config = short_insertion();
    config.supervisor.workspace_max_mm[2] = 300.0;
    config.validate().unwrap();
    let refused = Rig::new(&config).unwrap_err();
    assert!(matches!(refused, RigBuildError::OutsideWorkspace { .. }));
    let text = refused.to_string();
    assert!(text.contains("workspace_min_mm"), "{text}");
    config.supervisor.workspace_min_mm[2] = 301.0;
    assert!(config.validate().is_err());
    config.supervisor.workspace_min_mm[2] = f64::NAN;
    assert!(config.validate().is_err());
}

#[test]
fn nothing_moves_before_the_first_token_of_the_dead_mans_switch() {
    let mut config = short_insertion();
    config.supervisor.dead_man_ms = 300.0;
    let (summary, steps) = insert(&config, |t| t.stamp.as_secs() > 5.0);
    assert_eq!(summary.ended, Ended::TargetPassed);
    let (before, after): (Vec<_>, Vec<_>) = steps.iter().partition(|t| t.stamp.as_secs() < 5.0);
    assert!(before.len() > 50 && after.len() > 50);
    let moved = height(before[0]) - height(before[before.len() - 1]);
    assert!(moved.abs() < 5e-3, "moved {moved} mm without a token");
    // Nor does it wait for ever.
    let (summary, steps) = insert(&config, |_| false);
    assert!(
        matches!(summary.ended, Ended::Stopped(StopReason::DeadMan { .. })),
        "{summary:?}"
    );
    let moved = height(&steps[0]) - height(&steps[steps.len() - 1]);
    assert!(moved.abs() < 5e-3, "moved {moved} mm without a token");
}

#[test]
fn a_stretched_tissue_ends_the_run() {
    let config = config(&[
        "run.sensor=shape",
        "run.law=base-only",
        "run.check_reach=false",
        "limits.entry_stretch_mm=0.5",
        "supervisor.tissue_stretch_mm=0.5",
    ]);
    let (summary, steps) = insert(&config, |_| false);
    let Ended::Stopped(StopReason::TissueStretch { value_m, .. }) = summary.ended else {
        panic!("{summary:?}");
    };
    assert!(value_m > 0.5e-3);
    // It says so of the truth, too, within what the model is good for.
    let truth = steps[steps.len() - 1].truth.as_ref().unwrap();
    assert!(truth.max_stretch > 0.25e-3, "{}", truth.max_stretch);
}

/// The needle cuts less than the controller was told: what seemed within reach is not.
#[test]
fn a_target_that_turns_out_of_reach_during_the_run_ends_it() {
    let with_cut_angle = |degrees: &str| {
        config(&[
            "run.sensor=shape",
            "target.offset_mm=12",
            "target.angle_deg=0",
            "limits.tilt_deg=1",
            "limits.base_offset_mm=3",
            "estimator.cut_angle_deg=15",
            &format!("phantom.tip.cut_angle_deg={degrees}"),
        ])
    };
    let (summary, steps) = insert(&with_cut_angle("2"), |_| false);
    let Ended::Unreachable(shortfall) = summary.ended else {
        panic!("{summary:?}");
    };
    assert!(shortfall > 1e-3, "{shortfall}");
    let last = &steps[steps.len() - 1];
    assert_eq!(last.phase, Phase::Steering);
    // It was accepted, was on its way, and is truly aside by more than was said to be missing.
    let first = steps.iter().find(|t| t.phase == Phase::Steering).unwrap();
    assert!(first.axial_distance - last.axial_distance > 20e-3);
    let truth = last.truth.as_ref().unwrap();
    assert!(truth.axial_distance > 0.0 && truth.lateral_error > shortfall);
    // A needle that cuts well enough gets there.
    let (summary, _) = insert(&with_cut_angle("4"), |_| false);
    assert_eq!(summary.ended, Ended::TargetPassed);
}

/// A controller's inputs have no way to the truth: neither the cycle nor the laws name it.
#[test]
fn the_controller_cannot_name_the_truth() {
    let root = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let mut files = vec![root.join("needle-steer/src/cycle.rs")];
    crate::equations::rust_files(&root.join("hybrid-control/src"), &mut files);
    assert!(files.len() > 10);
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        for name in ["GroundTruth", "Scoring", "TruthReport", "truth.as_ref"] {
            let named = text
                .split("#[cfg(test)]")
                .next()
                .is_some_and(|code| code.contains(name));
            assert!(!named, "{} names {name}", file.display());
        }
    }
}
