//! After every kind of stop the needle comes out again, in the process that was stopped.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use hal::guarded::{Guard, Guarded, Limiter};
use hal::telemetry::{Phase, Telemetry};
use hal::{
    Arm, ArmDescription, ArmState, Error, ErrorKind, RateCommand, Recorded, SensedShape,
    ShapeSensor,
};
use needle_steer::config::{Config, SensorKind, TargetKind};
use needle_steer::controls::{Controls, Wish};
use needle_steer::cycle::base_pose;
use needle_steer::outcome::Ended;
use needle_steer::rig::{Eyes, Rig};
use needle_steer::run::{Insertion, Observer, Unobserved};
use needle_steer::withdrawal::{Refusal, Stop, Verdict};
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

/// Depth of the true tip below the surface [mm].
fn tip_depth_mm(config: &Config, rig: &Rig) -> f64 {
    let tip = rig.world.as_ref().unwrap().true_tip() - config.entry().coords;
    tip.dot(&config.inward()) * 1e3
}

/// An insertion on `rig` to which `act` happens, whose verdict says `told`; after `mend` the
/// needle is withdrawn, and there is nothing left to withdraw.
fn stop_and_withdraw(
    config: &Config,
    mut rig: Rig,
    told: &str,
    mut act: impl FnMut(&Controls, &Telemetry),
    mend: impl FnOnce(),
) {
    let start = base_pose(&rig.bearings, &rig.arm.state().unwrap());
    let controls = Controls::default();
    let mut insertion = Insertion::begin(config, &mut rig).unwrap();
    let mut script = Script(|t: &Telemetry| act(&controls, t));
    let summary = insertion.carry_out(config, &mut script, &controls).unwrap();
    let ended = summary.ended.to_string();
    assert!(ended.contains(told), "{ended}");
    assert!(!summary.ended.is_success());
    let deep = tip_depth_mm(config, insertion.rig);
    assert!(deep > 5.0, "only {deep} mm deep");
    mend();
    // A new wish, as of a new command.
    let controls = Controls::default();
    let mut phases = Vec::new();
    let mut script = Script(|t: &Telemetry| phases.push(t.phase));
    let out = insertion.withdraw(config, &mut script, &controls);
    assert_eq!(out.ended, Verdict::Retracted, "{out:?}");
    assert!(phases.iter().all(|phase| *phase == Phase::Retracting));
    assert!(out.withdrawn_mm > 5.0 && out.left_mm < 0.2, "{out:?}");
    let depth = out.tip_depth_mm.unwrap();
    assert!(depth < 1.0, "{told}: the tip is {depth} mm deep");
    assert!((depth - tip_depth_mm(config, insertion.rig)).abs() < 1e-9);
    let state = insertion.rig.arm.state().unwrap();
    let apart = base_pose(&insertion.rig.bearings, &state)
        .translation
        .vector
        - start.translation.vector;
    assert!(
        apart.norm() < 0.3e-3,
        "{told}: {} m from the start",
        apart.norm()
    );
    let again = insertion.withdraw(config, &mut Unobserved, &controls);
    assert_eq!(again.ended, Verdict::AtStart);
    assert_eq!(again.steps, 0);
}

/// A sensor that changes what another one says.
struct Tampered<F>(Box<dyn ShapeSensor>, F);

impl<F> ShapeSensor for Tampered<F>
where
    F: FnMut(Option<SensedShape>) -> Result<Option<SensedShape>, Error> + Send,
{
    fn poll(&mut self) -> Result<Option<SensedShape>, Error> {
        let seen = self.0.poll()?;
        (self.1)(seen)
    }
}

fn tamper<F>(rig: &mut Rig, with: F)
where
    F: FnMut(Option<SensedShape>) -> Result<Option<SensedShape>, Error> + Send + 'static,
{
    let Eyes::Shape(sensor) = core::mem::replace(&mut rig.eyes, Eyes::none()) else {
        panic!("this rig looks through cameras");
    };
    rig.eyes = Eyes::Shape(Box::new(Tampered(sensor, with)));
}

/// Images end at 15 s, and are never there again.
#[test]
fn without_images_the_needle_comes_out() {
    let config = config();
    let mut rig = Rig::new(&config).unwrap();
    tamper(&mut rig, |seen| {
        Ok(seen.filter(|shape| shape.stamp.as_secs() < 15.0))
    });
    stop_and_withdraw(&config, rig, "no image", |_, _| {}, || {});
}

#[test]
fn a_sensor_that_is_gone_is_a_verdict_and_the_needle_comes_out() {
    let config = config();
    let mut rig = Rig::new(&config).unwrap();
    let mut polls = 0;
    tamper(&mut rig, move |seen| {
        polls += 1;
        if polls < 800 {
            return Ok(seen);
        }
        Err(Error::new("tracker", ErrorKind::Disconnected))
    });
    stop_and_withdraw(&config, rig, "tracker: not connected", |_, _| {}, || {});
}

/// The bound is exceeded still while the needle comes out.
#[test]
fn beyond_a_bound_the_needle_comes_out() {
    let mut config = config();
    config.supervisor.tissue_stretch_mm = 0.4;
    config.target.kind = TargetKind::Shifted;
    config.target.depth_mm = 80.0;
    let rig = Rig::new(&config).unwrap();
    stop_and_withdraw(&config, rig, "stretched", |_, _| {}, || {});
}

#[test]
fn after_faults_of_the_arm_whose_cause_is_gone_the_needle_comes_out() {
    for (fault, told) in [
        (Fault::EmergencyStop, "EmergencyStop"),
        (Fault::DrivesOff, "DrivesOff"),
        (Fault::Manual, "NotAutomatic"),
        (Fault::ControllerError, "ControllerError"),
        (Fault::FeedbackFrozen, "StaleFeedback"),
        (Fault::ConnectionLost, "no connection"),
        (Fault::Jammed(1), "TrackingError"),
    ] {
        let config = config();
        let rig = Rig::new(&config).unwrap();
        let arm = rig.simulated_arm.clone().unwrap();
        let mended = arm.clone();
        stop_and_withdraw(
            &config,
            rig,
            told,
            |_, t| {
                if t.step == MOMENT {
                    arm.inject(fault);
                }
            },
            || mended.clear(fault),
        );
    }
}

#[test]
fn after_the_operators_own_stops_the_needle_comes_out() {
    type Act = fn(&Controls, &Telemetry);
    let acts: [(&str, Act); 3] = [
        ("interrupted", |controls, t| {
            if t.step == MOMENT {
                controls.interrupt();
            }
        }),
        ("interrupted", |controls, t| {
            if t.step == MOMENT {
                controls.stop();
            }
        }),
        ("dead-man", |controls, t| {
            if t.step <= MOMENT {
                controls.refresh_dead_man();
            }
        }),
    ];
    for (told, act) in acts {
        let mut config = config();
        config.supervisor.dead_man_ms = if told == "dead-man" { 300.0 } else { 0.0 };
        let rig = Rig::new(&config).unwrap();
        stop_and_withdraw(&config, rig, told, act, || {});
    }
}

#[test]
fn after_a_run_that_went_on_for_too_long_the_needle_comes_out() {
    let mut config = config();
    config.run.max_duration_s = 15.0;
    let rig = Rig::new(&config).unwrap();
    stop_and_withdraw(&config, rig, "timed out", |_, _| {}, || {});
}

/// An arm that finds one command too late.
struct Sluggish {
    arm: Box<dyn Arm>,
    commands: u64,
}

impl Arm for Sluggish {
    fn description(&self) -> &ArmDescription {
        self.arm.description()
    }

    fn state(&mut self) -> Result<ArmState, Error> {
        self.arm.state()
    }

    fn enable(&mut self) -> Result<(), Error> {
        self.arm.enable()
    }

    fn command(&mut self, command: &RateCommand) -> Result<(), Error> {
        self.commands += 1;
        if self.commands == 2 * MOMENT {
            return Err(Error::new("sluggish", ErrorKind::Rejected));
        }
        self.arm.command(command)
    }

    fn stop(&mut self) -> Result<(), Error> {
        self.arm.stop()
    }

    fn reset(&mut self) -> Result<(), Error> {
        self.arm.reset()
    }
}

#[test]
fn a_late_command_is_a_verdict_and_the_needle_comes_out() {
    let config = config();
    let mut rig = Rig::new(&config).unwrap();
    let arm = Box::new(rig.simulated_arm.clone().unwrap().driver());
    let arm: Box<dyn Arm> = Box::new(Sluggish { arm, commands: 0 });
    let period = arm.description().period;
    let limiter = Limiter::new(rig.bearings.chain.limits(), 8.7e-3, period * 3).unwrap();
    rig.arm = Recorded::new(Guarded::new(arm, Guard::new(limiter)).unwrap(), 1);
    stop_and_withdraw(&config, rig, "sluggish: command rejected", |_, _| {}, || {});
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
