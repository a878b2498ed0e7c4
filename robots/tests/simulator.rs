//! The simulated arm: determinism, imperfections and every fault that can be injected.
#![expect(clippy::unwrap_used, reason = "a helper that fails fails its test")]

use core::time::Duration;

use hal::{Arm, ArmMode, ErrorKind, FaultReason, Joints, RateCommand, Stamp};
use robots::arms::{NEEDLE_BASE, VIPER_S650};
use robots::kinematics::Chain;
use robots::sim::{Fault, SimError, SimSettings, SimulatedArm, SimulatedDriver};

const MS: Duration = Duration::from_millis(1);

fn start() -> Joints {
    Joints::from([0.1, -1.2, 2.4, 0.2, 0.9, -0.3])
}

fn gentle() -> Joints {
    Joints::from([0.02, -0.01, 0.015, -0.02, 0.01, 0.03])
}

fn new(settings: SimSettings) -> (SimulatedArm, SimulatedDriver) {
    let chain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
    let arm = SimulatedArm::new(&chain, &start(), settings).unwrap();
    let driver = arm.driver();
    (arm, driver)
}

/// Sends `gentle` every period for `periods`, and stops sending at the first refusal.
fn drive(arm: &SimulatedArm, driver: &mut SimulatedDriver, sequence: &mut u64, periods: u32) {
    for _ in 0..periods {
        *sequence += 1;
        let command = RateCommand {
            sequence: *sequence,
            stamp: arm.now(),
            rates: gentle(),
        };
        if driver.command(&command).is_err() {
            return;
        }
        arm.advance_to(arm.now() + 16 * MS);
    }
}

fn mode_after(fault: Fault, moving: bool) -> ArmMode {
    let (arm, mut driver) = new(SimSettings::default());
    driver.enable().unwrap();
    let mut sequence = 0;
    if moving {
        drive(&arm, &mut driver, &mut sequence, 40);
    }
    arm.inject(fault);
    if moving {
        drive(&arm, &mut driver, &mut sequence, 400);
    } else {
        arm.advance_to(arm.now() + 2000 * MS);
    }
    arm.mode()
}

#[test]
fn every_fault_is_found_and_latched() {
    use FaultReason as Reason;
    for (fault, moving, reason) in [
        (Fault::EmergencyStop, true, Reason::EmergencyStop),
        (Fault::DrivesOff, true, Reason::DrivesOff),
        (Fault::Manual, false, Reason::NotAutomatic),
        (Fault::ControllerError, true, Reason::ControllerError),
        (Fault::ConnectionLost, true, Reason::ConnectionLost),
        (Fault::Injected, false, Reason::Injected),
        (Fault::FeedbackFrozen, true, Reason::StaleFeedback),
        (Fault::CommandsLost, true, Reason::StaleCommand),
        (Fault::Jammed(5), true, Reason::TrackingError),
        (
            Fault::Creeping {
                joint: 2,
                rate: 0.02,
            },
            false,
            Reason::UncommandedMotion,
        ),
    ] {
        let mode = mode_after(fault, moving);
        assert_eq!(mode, ArmMode::Faulted(reason), "{fault:?}");
    }
}

#[test]
fn a_lost_connection_says_so_and_does_not_come_back_enabled() {
    let (arm, mut driver) = new(SimSettings::default());
    driver.enable().unwrap();
    arm.inject(Fault::ConnectionLost);
    assert_eq!(driver.state().unwrap_err().kind(), ErrorKind::Disconnected);
    arm.advance_to(Stamp::from_secs(0.1));
    arm.clear(Fault::ConnectionLost);
    let state = driver.state().unwrap();
    assert_eq!(state.mode, ArmMode::Faulted(FaultReason::ConnectionLost));
    assert_eq!(driver.enable().unwrap_err().kind(), ErrorKind::Faulted);
    driver.reset().unwrap();
    assert_eq!(driver.state().unwrap().mode, ArmMode::Connected);
}

#[test]
fn errors_name_device_and_cause() {
    let (arm, mut driver) = new(SimSettings::default());
    arm.inject(Fault::EmergencyStop);
    let error = driver.reset().unwrap_err();
    assert_eq!(error.device, "simulated arm");
    assert!(error.source.unwrap().to_string().contains("EmergencyStop"));
}

#[test]
fn the_motion_does_not_depend_on_how_time_is_cut() {
    let run = |pieces: &[u64]| {
        let (arm, mut driver) = new(SimSettings::default());
        driver.enable().unwrap();
        let mut trace = Vec::new();
        for k in 0..40 {
            let command = RateCommand {
                sequence: k + 1,
                stamp: arm.now(),
                rates: gentle(),
            };
            driver.command(&command).unwrap();
            for piece in pieces {
                arm.advance_to(arm.now() + Duration::from_micros(*piece));
            }
            trace.push((arm.true_joints(), driver.state().unwrap()));
        }
        trace
    };
    let whole = run(&[16_000]);
    assert_eq!(whole, run(&[5_333, 1, 10_666]));
    assert_eq!(whole, run(&[100; 160]));
}

#[test]
fn imperfections_show_and_can_be_switched_off() {
    let settings = SimSettings {
        encoder_step: 1e-3,
        feedback_latency: 20 * MS,
        servo_lag: 0.05,
        ..SimSettings::default()
    };
    let measure = |settings: SimSettings| {
        let (arm, mut driver) = new(settings);
        driver.enable().unwrap();
        drive(&arm, &mut driver, &mut 0, 60);
        let state = driver.state().unwrap();
        (
            arm.now().secs_since(state.stamp),
            state.positions,
            arm.true_joints(),
        )
    };
    let (age, read, flawed) = measure(settings);
    assert!((age - 0.032).abs() < 1e-9, "{age}");
    assert!(
        read.iter()
            .all(|q| ((q / 1e-3) - (q / 1e-3).round()).abs() < 1e-9)
    );
    let (age, read, ideal) = measure(SimSettings::ideal());
    assert!(age.abs() < 1e-9);
    assert!(read.zip(&ideal, |a, b| a - b).max_abs() < 1e-15);
    // A lag of 50 ms and a latency of 4 ms at 0.03 rad/s; the lag has settled to e^-18.
    let behind = ideal.zip(&flawed, |a, b| a - b);
    assert!((behind[5] - 0.03 * 0.054).abs() < 1e-5, "{behind:?}");
}

#[test]
fn nonsense_is_refused_at_construction() {
    let chain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
    let outside = Joints::from([0.1, -1.2, 9.0, 0.2, 0.9, -0.3]);
    let error = SimulatedArm::new(&chain, &outside, SimSettings::default()).unwrap_err();
    assert!(error.to_string().contains("joint_3"), "{error}");
    let five = Joints::from_slice(&[0.0; 5]).unwrap();
    let error = SimulatedArm::new(&chain, &five, SimSettings::default()).unwrap_err();
    assert_eq!(
        error,
        SimError::Joints {
            given: 5,
            expected: 6
        }
    );
    for settings in [
        SimSettings {
            servo_lag: f64::NAN,
            ..SimSettings::default()
        },
        SimSettings {
            encoder_step: -1.0,
            ..SimSettings::default()
        },
        SimSettings {
            period: Duration::ZERO,
            ..SimSettings::default()
        },
        SimSettings {
            tracking_fault: 0.0,
            ..SimSettings::default()
        },
    ] {
        let error = SimulatedArm::new(&chain, &start(), settings).unwrap_err();
        assert!(matches!(error, SimError::Setting { .. }));
    }
}
