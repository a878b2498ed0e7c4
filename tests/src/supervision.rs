//! The supervisor and the user's controls on a whole simulated insertion.

use hal::telemetry::{Phase, Telemetry};
use hal::{Arm, ArmMode, FaultReason, SensedShape, ShapeSensor};
use nalgebra::{Point3, Vector3};
use needle_steer::config::{Backend, Config, SensorKind, TargetKind};
use needle_steer::controls::{Controls, Wish};
use needle_steer::outcome::{Ended, Summary};
use needle_steer::rig::{Eyes, Rig};
use needle_steer::run::{Observer, run};
use needle_steer::supervisor::StopReason;
use robots::sim::Fault;

/// An uncontrolled insertion of 20 mm into the flawless phantom.
fn short_insertion() -> Config {
    let mut config = Config::default();
    config.run.phantom = "ideal".into();
    config.run.law = "none".into();
    config.run.sensor = SensorKind::Shape;
    config.target.kind = TargetKind::Aligned;
    config.target.depth_mm = 20.0;
    config
}

/// Calls a function at every step and keeps the telemetry.
struct Script<'a, F> {
    controls: &'a Controls,
    act: F,
    steps: Vec<Telemetry>,
}

impl<F: FnMut(&Controls, &Telemetry)> Observer for Script<'_, F> {
    fn step(&mut self, telemetry: &Telemetry) {
        (self.act)(self.controls, telemetry);
        self.steps.push(telemetry.clone());
    }
}

fn insert(
    config: &Config,
    rig: &mut Rig,
    act: impl FnMut(&Controls, &Telemetry),
) -> (Summary, Vec<Telemetry>) {
    let controls = Controls::default();
    let mut script = Script {
        controls: &controls,
        act,
        steps: Vec::new(),
    };
    let summary = run(config, rig, &mut script, &controls).unwrap();
    (summary, script.steps)
}

fn base(telemetry: &Telemetry) -> Vector3<f64> {
    telemetry.world_from_base.origin().coords()
}

/// Asserts that the arm rests, and stays where it is.
fn assert_rest(rig: &mut Rig) {
    let before = rig.arm.state().unwrap();
    assert!(
        !matches!(before.mode, ArmMode::Moving | ArmMode::Stopping),
        "{before:?}"
    );
    let later = rig.clock.now() + std::time::Duration::from_secs(1);
    rig.clock.wait_until(later);
    let after = rig.arm.state().unwrap();
    let moved = after
        .positions
        .zip(&before.positions, |a, b| a - b)
        .max_abs();
    // Feedback is a few milliseconds old: the last of the braking at 1 mm/s may still show.
    assert!(moved < 1e-4, "moved by {moved} rad after the run");
    assert!(after.rates.max_abs() < 1e-9, "{after:?}");
}

#[test]
fn an_interrupted_run_stops_the_arm() {
    let config = short_insertion();
    let mut rig = Rig::new(&config).unwrap();
    let (summary, steps) = insert(&config, &mut rig, |controls, t| {
        if t.step == 200 {
            controls.interrupt();
        }
    });
    assert_eq!(summary.ended, Ended::Interrupted);
    assert_eq!(steps.len(), 200);
    assert_rest(&mut rig);
}

#[test]
fn a_pause_holds_still_and_a_resumed_run_ends_at_its_target() {
    let config = short_insertion();
    let mut rig = Rig::new(&config).unwrap();
    let (summary, steps) = insert(&config, &mut rig, |controls, t| match t.step {
        300 => controls.ask(Wish::Pause),
        400 => controls.ask(Wish::Proceed),
        _ => {}
    });
    assert_eq!(summary.ended, Ended::TargetPassed);
    let paused: Vec<_> = steps.iter().filter(|t| t.phase == Phase::Paused).collect();
    assert!(paused.len() > 90, "{}", paused.len());
    // Braking from 1 mm/s takes less than 0.1 s; the encoders resolve about 1e-6 m.
    let moved = (base(paused[paused.len() - 1]) - base(paused[10])).norm();
    assert!(moved < 5e-6, "moved {moved} m while paused");
}

#[test]
fn a_retraction_leads_back_to_the_start() {
    let mut config = short_insertion();
    config.run.law = "hybrid".into();
    config.target.depth_mm = 40.0;
    let mut rig = Rig::new(&config).unwrap();
    let (summary, steps) = insert(&config, &mut rig, |controls, t| {
        if t.step == 500 {
            controls.ask(Wish::Retract);
        }
    });
    assert_eq!(summary.ended, Ended::Retracted);
    let (first, last) = (&steps[0], &steps[steps.len() - 1]);
    assert!(steps.iter().any(|t| t.depth > 10e-3));
    assert!((base(last) - base(first)).norm() < 0.3e-3);
    assert_rest(&mut rig);
}

#[test]
fn a_withdrawal_is_paused_and_goes_on_but_never_into_steering() {
    let config = short_insertion();
    let mut rig = Rig::new(&config).unwrap();
    let (summary, steps) = insert(&config, &mut rig, |controls, t| match t.step {
        500 | 700 => controls.ask(Wish::Retract),
        // Steps of a withdrawal come with every period of the arm.
        600 => controls.ask(Wish::Pause),
        620 | 800 => controls.ask(Wish::Proceed),
        _ => {}
    });
    assert_eq!(summary.ended, Ended::Retracted);
    let mut after = steps.iter().skip(500);
    let paused: Vec<_> = steps.iter().filter(|t| t.phase == Phase::Paused).collect();
    assert_eq!(paused.len(), 100, "a start does not end the pause");
    let moved = (base(paused[paused.len() - 1]) - base(paused[10])).norm();
    assert!(moved < 5e-6, "moved {moved} m while paused");
    assert!(after.all(|t| matches!(t.phase, Phase::Retracting | Phase::Paused)));
    let (first, last) = (&steps[0], &steps[steps.len() - 1]);
    assert!((base(last) - base(first)).norm() < 0.3e-3);
}

#[test]
fn an_emergency_stop_of_the_arm_ends_the_run() {
    let config = short_insertion();
    let mut rig = Rig::new(&config).unwrap();
    let arm = rig.simulated_arm.clone().unwrap();
    let (summary, _) = insert(&config, &mut rig, |_, t| {
        if t.step == 200 {
            arm.inject(Fault::EmergencyStop);
        }
    });
    let expected = StopReason::ArmFault {
        fault: FaultReason::EmergencyStop,
        words: None,
    };
    assert_eq!(summary.ended, Ended::Stopped(expected));
}

/// The Viper's driver knows more of a fault than its name.
#[test]
fn a_fault_is_told_in_the_arms_words() {
    let mut config = short_insertion();
    config.run.backend = Backend::Viper;
    let mut rig = Rig::new(&config).unwrap();
    let emulator = rig.emulator.clone().unwrap();
    let (summary, _) = insert(&config, &mut rig, |_, t| {
        if t.step == 200 {
            emulator.turn(|knobs| knobs.error_code = -1042);
        }
    });
    let ended = summary.ended.to_string();
    let (_, words) = ended.split_once("ControllerError: ").unwrap();
    assert!(words.contains("-1042"), "{ended}");
}

#[test]
fn the_dead_mans_switch_ends_the_run_when_released() {
    let mut config = short_insertion();
    config.supervisor.dead_man_ms = 300.0;
    let mut rig = Rig::new(&config).unwrap();
    let (summary, steps) = insert(&config, &mut rig, |controls, t| {
        if t.step <= 200 {
            controls.refresh_dead_man();
        }
    });
    assert!(
        matches!(summary.ended, Ended::Stopped(StopReason::DeadMan { .. })),
        "{summary:?}"
    );
    let last = steps[steps.len() - 1].stamp.secs_since(steps[199].stamp);
    assert!(last < 0.3 + 0.05, "went on for {last} s");
    assert_rest(&mut rig);
}

/// A sensor that changes what another one says.
struct Tampered<F>(Box<dyn ShapeSensor>, F);

impl<F: FnMut(SensedShape) -> Option<SensedShape> + Send> ShapeSensor for Tampered<F> {
    fn poll(&mut self) -> Result<Option<SensedShape>, hal::Error> {
        Ok(self.0.poll()?.and_then(&mut self.1))
    }
}

struct Blind;

impl ShapeSensor for Blind {
    fn poll(&mut self) -> Result<Option<SensedShape>, hal::Error> {
        Ok(None)
    }
}

fn tamper(rig: &mut Rig, with: impl FnMut(SensedShape) -> Option<SensedShape> + Send + 'static) {
    let Eyes::Shape(sensor) = core::mem::replace(&mut rig.eyes, Eyes::Shape(Box::new(Blind)))
    else {
        panic!("this rig looks through cameras");
    };
    rig.eyes = Eyes::Shape(Box::new(Tampered(sensor, with)));
}

#[test]
fn without_images_the_arm_holds_still_and_then_the_run_stops() {
    let config = short_insertion();
    let mut rig = Rig::new(&config).unwrap();
    tamper(&mut rig, |shape| {
        (shape.stamp.as_secs() < 8.0).then_some(shape)
    });
    let (summary, steps) = insert(&config, &mut rig, |_, _| {});
    let Ended::Stopped(StopReason::ImageTimeout { age_s, .. }) = summary.ended else {
        panic!("{summary:?}");
    };
    assert!((2.0..2.1).contains(&age_s), "{age_s}");
    let still: Vec<_> = steps.iter().filter(|t| t.stamp.as_secs() > 8.4).collect();
    assert!(still.len() > 10);
    let moved = (base(still[still.len() - 1]) - base(still[0])).norm();
    assert!(moved < 5e-6, "moved {moved} m without images");
}

#[test]
fn measurements_that_are_not_numbers_are_passed_over() {
    let config = short_insertion();
    let mut rig = Rig::new(&config).unwrap();
    tamper(&mut rig, |mut shape| {
        if shape.sequence % 5 == 0 {
            shape.tip.position = hal::Position::new(Point3::new(f64::NAN, 0.0, 0.0));
        }
        Some(shape)
    });
    let (summary, steps) = insert(&config, &mut rig, |_, _| {});
    assert_eq!(summary.ended, Ended::TargetPassed);
    assert!(steps.iter().all(|t| t.joint_rates.is_finite()));
}
