//! Targets given to a run: judged by where the needle is, answered to who gave them.

use std::sync::mpsc::Receiver;

use hal::Position;
use hal::frame::LeftCamera;
use hal::telemetry::{Phase, Telemetry};
use nalgebra::{Point3, Vector3};
use needle_steer::aim::{Answer, TargetRefused};
use needle_steer::config::{self, Config, TargetKind};
use needle_steer::controls::Controls;
use needle_steer::outcome::{Ended, Summary};
use needle_steer::rig::Rig;
use needle_steer::run::{Observer, RunError, run};

/// The step at which a target comes: about 12 mm deep.
const MOMENT: u64 = 400;

fn config(overrides: &[&str]) -> Config {
    let shifted = [
        "run.sensor=shape",
        "target.depth_mm=50",
        "target.offset_mm=4",
    ];
    let all = shifted.iter().chain(overrides).map(ToString::to_string);
    config::load(None, &all.collect::<Vec<_>>()).unwrap()
}

/// A point so far [m] along the axes of the estimated tip.
fn from_tip(rig: &Rig, t: &Telemetry, by: Vector3<f64>) -> Position<LeftCamera> {
    let world = t.world_from_tip.isometry() * Point3::from(by);
    rig.left_from_world() * Position::new(world)
}

/// Gives a target at [`MOMENT`], as far from the tip as `by` says.
struct Giver<'a> {
    controls: &'a Controls,
    rig: Rig,
    by: Vector3<f64>,
    answer: Option<Receiver<Answer>>,
}

impl Observer for Giver<'_> {
    fn step(&mut self, t: &Telemetry) {
        if t.step == MOMENT {
            assert_eq!(t.phase, Phase::Steering);
            let target = from_tip(&self.rig, t, self.by);
            self.answer = Some(self.controls.aim(target));
        }
    }
}

/// An insertion during which a target comes; its end and the answer.
fn given(config: &Config, by_mm: [f64; 3]) -> (Summary, Answer) {
    let controls = Controls::default();
    let mut giver = Giver {
        controls: &controls,
        rig: Rig::new(config).unwrap(),
        by: Vector3::from(by_mm) * 1e-3,
        answer: None,
    };
    let mut rig = Rig::new(config).unwrap();
    let summary = run(config, &mut rig, &mut giver, &controls).unwrap();
    (summary, giver.answer.unwrap().try_recv().unwrap())
}

#[test]
fn a_target_given_during_a_run_is_taken_and_passed_or_refused_with_figures() {
    // Where it lies from the tip [mm], and words of the refusal.
    for (by_mm, words) in [
        ([17e3, 0.0, 17e3], "mm too short for the target"),
        ([60.0, 0.0, 40.0], "mm out of reach"),
        ([0.0, 0.0, -5.0], "the target is 5.0 mm behind the tip"),
        ([0.0, 0.0, 120.0], "mm too short for the target"),
        ([40.0, 0.0, 30.0], "mm out of reach"),
        ([f64::NAN, 0.0, 30.0], "not finite"),
        ([0.0, f64::INFINITY, 30.0], "not finite"),
    ] {
        let (summary, answer) = given(&config(&[]), by_mm);
        let refused = answer.unwrap_err().to_string();
        assert!(refused.contains(words), "{by_mm:?}: {refused}");
        // The run keeps the target that it has.
        assert_eq!(summary.ended, Ended::TargetPassed, "{by_mm:?}");
        assert!(summary.hit, "{by_mm:?}: {summary:?}");
    }
    let (summary, answer) = given(&config(&[]), [1.0, 1.0, 30.0]);
    let aimed = answer.unwrap();
    assert!((aimed.ahead - 0.03).abs() < 1e-3, "{aimed}");
    assert!(
        (aimed.aside - 2.0_f64.sqrt() * 1e-3).abs() < 2e-4,
        "{aimed}"
    );
    assert!(aimed.to_string().contains("30.0 mm ahead"), "{aimed}");
    assert_eq!(summary.ended, Ended::TargetPassed);
    assert!(summary.hit, "{summary:?}");
}

#[test]
fn a_target_for_which_the_base_would_leave_its_box_is_refused() {
    let start = {
        let rig = Rig::new(&config(&[])).unwrap();
        let base =
            rig.bearings.world_from_arm_base.isometry() * rig.bearings.chain.forward(&rig.home);
        base.translation.vector.z * 1e3
    };
    // Deep enough for the configuration's target, not for one 25 mm deeper.
    let floor = format!(
        "supervisor.workspace_min_mm=[-1000, -1000, {}]",
        start - 66.0
    );
    let config_with_box = config(&[&floor]);
    let (summary, answer) = given(&config_with_box, [0.0, 0.0, 60.0]);
    let refused = answer.unwrap_err().to_string();
    assert!(refused.contains("leave its box by"), "{refused}");
    assert_eq!(summary.ended, Ended::TargetPassed);
    // At the start as well.
    let deep = config(&[&floor, "target.depth_mm=75"]);
    let refused = run_to(&deep, None).unwrap_err();
    assert!(
        matches!(refused, RunError::Target(TargetRefused::Workspace { .. })),
        "{refused}"
    );
}

fn run_to(
    config: &Config,
    target: Option<[f64; 3]>,
) -> Result<(Summary, Option<Answer>), RunError> {
    let controls = Controls::default();
    let mut rig = Rig::new(config).unwrap();
    let answer = target.map(|mm| {
        let world = Position::new(Point3::from(Vector3::from(mm) * 1e-3));
        controls.aim(rig.left_from_world() * world)
    });
    let summary = run(
        config,
        &mut rig,
        &mut needle_steer::run::Unobserved,
        &controls,
    )?;
    Ok((summary, answer.map(|answer| answer.try_recv().unwrap())))
}

#[test]
fn a_target_given_before_a_run_is_taken_or_leaves_the_configurations() {
    let config = config(&[]);
    let entry = config.entry().coords * 1e3;
    let down = config.inward().into_inner();
    for (depth, taken) in [(45.0, true), (-5.0, false), (17e3, false)] {
        let (summary, answer) = run_to(&config, Some((entry + down * depth).into())).unwrap();
        assert_eq!(answer.unwrap().is_ok(), taken, "{depth}");
        assert_eq!(summary.ended, Ended::TargetPassed, "{depth}");
        assert!(summary.hit, "{depth}: {summary:?}");
    }
}

#[test]
fn reach_is_not_asked_for_where_the_configuration_waives_it_but_what_is_behind_stays_behind() {
    let waived = config(&["run.check_reach=false", "run.max_duration_s=30"]);
    let (_, answer) = given(&waived, [40.0, 0.0, 30.0]);
    assert!(answer.is_ok(), "{answer:?}");
    let (_, answer) = given(&waived, [0.0, 0.0, -5.0]);
    assert!(answer.is_err());
}

#[test]
fn a_marker_is_not_aimed_away_from() {
    let mut config = config(&[]);
    config.target.kind = TargetKind::Marker;
    let (_, answer) = given(&config, [0.0, 0.0, 30.0]);
    assert_eq!(answer, Err(TargetRefused::Marker));
}

#[test]
fn a_target_that_comes_too_late_is_refused() {
    struct AtTheEnd<'a>(&'a Controls, Vec<Receiver<Answer>>);
    impl Observer for AtTheEnd<'_> {
        fn step(&mut self, t: &Telemetry) {
            if t.step == MOMENT {
                self.0.stop();
                self.1.push(self.0.aim(Position::new(Point3::origin())));
            }
        }
    }
    let config = config(&[]);
    let controls = Controls::default();
    let mut observer = AtTheEnd(&controls, Vec::new());
    run(
        &config,
        &mut Rig::new(&config).unwrap(),
        &mut observer,
        &controls,
    )
    .unwrap();
    let answer = observer.1.pop().unwrap().try_recv().unwrap();
    assert_eq!(answer, Err(TargetRefused::Ended));
}
