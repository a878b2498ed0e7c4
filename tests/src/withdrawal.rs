//! What a withdrawal keeps to, whatever stopped the insertion (that is in `ways_out`): full disks, faults
//! that are still there, arms that creep or jam.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use hal::telemetry::Telemetry;
use hal::{Error, Position, SensedShape, ShapeSensor};
use needle_steer::config::{Config, SensorKind, TargetKind};
use needle_steer::controls::{Controls, Wish};
use needle_steer::journal::Journal;
use needle_steer::outcome::Ended;
use needle_steer::rig::{Eyes, Rig};
use needle_steer::robustness::wide::World;
use needle_steer::run::{Insertion, Observer, Unobserved};
use needle_steer::withdrawal::{Recording, Refusal, Stop, Verdict, rebuild};
use robots::sim::Fault;

/// The step at which something happens: about 12 mm deep.
const MOMENT: u64 = 400;

fn config() -> Config {
    let mut config = Config::default();
    config.run.phantom = "paper".into();
    config.run.law = "hybrid".into();
    config.run.sensor = SensorKind::Shape;
    config.target.kind = TargetKind::Aligned;
    config.target.depth_mm = 40.0;
    config
}

/// Calls a function at every step.
struct Script<F>(F);

impl<F: FnMut(&Telemetry)> Observer for Script<F> {
    fn step(&mut self, telemetry: &Telemetry) {
        (self.0)(telemetry);
    }
}

/// What cannot be written keeps no needle in.
#[test]
fn with_a_full_disk_the_needle_comes_out() {
    let full = Path::new("/dev/full");
    if !full.exists() {
        eprintln!("skipped: there is no /dev/full here");
        return;
    }
    let config = config();
    let mut rig = Rig::new(&config).unwrap();
    let controls = Controls::default();
    let mut insertion = Insertion::begin(&config, &mut rig).unwrap();
    let mut script = Script(|t: &Telemetry| {
        if t.step == MOMENT {
            controls.stop();
        }
    });
    let summary = insertion.carry_out(&config, &mut script, &controls);
    assert_eq!(summary.unwrap().ended, Ended::Interrupted);
    // A folder that cannot be made.
    insertion.folder = Some(full.to_owned());
    let out = insertion.withdraw(&config, &mut Unobserved, &Controls::default());
    assert_eq!(out.ended, Verdict::Retracted);
    assert!(!out.log_complete && out.log.is_none(), "{out:?}");
}

#[test]
fn a_withdrawal_waits_for_the_cause_of_a_fault_to_go_and_moves_nothing_before() {
    let config = config();
    let mut rig = Rig::new(&config).unwrap();
    let arm = rig.simulated_arm.clone().unwrap();
    let controls = Controls::default();
    let mut insertion = Insertion::begin(&config, &mut rig).unwrap();
    let mut script = Script(|t: &Telemetry| {
        if t.step == MOMENT {
            arm.inject(Fault::EmergencyStop);
        }
    });
    insertion
        .carry_out(&config, &mut script, &controls)
        .unwrap();
    let later = insertion.rig.clock.now() + Duration::from_secs(1);
    insertion.rig.clock.wait_until(later);
    let before = arm.true_joints();
    let out = insertion.withdraw(&config, &mut Unobserved, &controls);
    let Verdict::Refused(Refusal::Arm(why)) = &out.ended else {
        panic!("{out:?}")
    };
    assert!(why.contains("EmergencyStop"), "{why}");
    assert!(arm.true_joints().zip(&before, |a, b| a - b).max_abs() < 1e-5);
    arm.clear(Fault::EmergencyStop);
    // Pressed again on the way out: stopped, and out at the third try.
    let mut steps = 0;
    let mut script = Script(|_: &Telemetry| {
        steps += 1;
        if steps == 100 {
            arm.inject(Fault::EmergencyStop);
        }
    });
    let out = insertion.withdraw(&config, &mut script, &controls);
    assert!(
        matches!(out.ended, Verdict::Stopped(Stop::ArmFault(..))),
        "{out:?}"
    );
    assert!(out.left_mm > 1.0 && out.withdrawn_mm > 0.5, "{out:?}");
    arm.clear(Fault::EmergencyStop);
    let out = insertion.withdraw(&config, &mut Unobserved, &controls);
    assert_eq!(out.ended, Verdict::Retracted);
}

#[test]
fn an_arm_that_creeps_or_jams_on_the_way_out_is_stopped() {
    for fault in [
        Fault::Jammed(1),
        Fault::Creeping {
            joint: 1,
            rate: 0.05,
        },
    ] {
        let config = config();
        let mut rig = Rig::new(&config).unwrap();
        let arm = rig.simulated_arm.clone().unwrap();
        let controls = Controls::default();
        let mut insertion = Insertion::begin(&config, &mut rig).unwrap();
        let seen = Arc::new(AtomicBool::new(false));
        let mut script = Script(|t: &Telemetry| {
            if t.step == MOMENT {
                controls.ask(Wish::Retract);
            }
            if t.step == MOMENT + 100 && !seen.swap(true, Ordering::Relaxed) {
                arm.inject(fault);
            }
        });
        let summary = insertion
            .carry_out(&config, &mut script, &controls)
            .unwrap();
        let Ended::NotRetracted(Verdict::Stopped(stop)) = &summary.ended else {
            panic!("{fault:?}: {summary:?}")
        };
        let text = summary.ended.to_string();
        assert!(text.contains("withdrawal stopped"), "{stop:?}: {text}");
    }
}

/// A world that is replayed for a withdrawal is the recorded one to the last bit, where its tissue tore
/// and its shaft gave way too: what follows a shape that gave way hangs on the last bit.
#[test]
fn a_replayed_world_is_the_recorded_one() {
    let whole = config();
    for (name, config) in [
        ("whole", whole),
        ("torn", World::new(1112).config().unwrap()),
    ] {
        let folder = std::env::temp_dir().join(format!("replayed-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let log = folder.join("run.mcap");
        let mut rig = Rig::new(&config).unwrap();
        let mut journal = Journal::create(&log, &config, &rig.bearings).unwrap();
        let mut insertion = Insertion::begin(&config, &mut rig).unwrap();
        let summary = insertion.carry_out(&config, &mut journal, &Controls::default());
        assert_eq!(summary.unwrap().spoilt, name == "torn");
        journal.finish().unwrap();
        let recording = Recording::read(&log, &[]).unwrap();
        let mut replayed = rebuild(&recording.config, &recording).unwrap();
        let until = rig.clock.now().max(replayed.clock.now()) + Duration::from_secs(1);
        let [was, is] = [&mut rig, &mut replayed].map(|rig| {
            rig.clock.wait_until(until);
            rig.world.as_ref().unwrap().true_tip()
        });
        assert_eq!(was, is, "{name}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

/// A sensor that sees the needle farther in the tissue than it is [m].
struct Deeper(Box<dyn ShapeSensor>, nalgebra::Vector3<f64>);

impl ShapeSensor for Deeper {
    fn poll(&mut self) -> Result<Option<SensedShape>, Error> {
        let mut seen = self.0.poll()?;
        if let Some(shape) = &mut seen {
            shape.tip.position = Position::new(shape.tip.position.point() + self.1);
        }
        Ok(seen)
    }
}

/// A base that is back is no needle that is out.
#[test]
fn a_tip_that_is_measured_inside_is_not_withdrawn() {
    let config = config();
    for depth in [0.0, 7e-3] {
        let mut rig = Rig::new(&config).unwrap();
        let controls = Controls::default();
        let mut insertion = Insertion::begin(&config, &mut rig).unwrap();
        let mut script = Script(|t: &Telemetry| {
            if t.step == MOMENT {
                controls.stop();
            }
        });
        insertion
            .carry_out(&config, &mut script, &controls)
            .unwrap();
        // As on a real arm: nobody knows the truth.
        insertion.rig.world = None;
        let left_from_world = insertion.rig.bearings.world_from_left_camera.inverse();
        let deeper = left_from_world.rotate(&(config.inward().into_inner() * depth));
        match core::mem::replace(&mut insertion.rig.eyes, Eyes::none()) {
            Eyes::Shape(sensor) => {
                insertion.rig.eyes = Eyes::Shape(Box::new(Deeper(sensor, deeper)));
            }
            Eyes::Cameras(_) => panic!("a sensor of shapes was asked for"),
        }
        let out = insertion.withdraw(&config, &mut Unobserved, &Controls::default());
        match out.ended {
            Verdict::Retracted => assert!(depth < 1e-6),
            Verdict::TipInside { depth_mm } => assert!((depth_mm - depth * 1e3).abs() < 1.0),
            ended => panic!("{ended}"),
        }
        assert_eq!(out.ended.is_success(), depth < 1e-6, "{}", out.ended);
    }
}
