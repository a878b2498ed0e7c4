//! T9, T13, T19: callers that misbehave, die, or begin elsewhere.

use hal::{Arm, ArmMode, ErrorKind, FaultReason, Joints, RateCommand};
use robots::viper::emulator::{EmulatorConfig, Record};
use robots::viper::{Config, Dialect};
use std::time::Duration;

use crate::bench::{Bench, HOME, SEGMENT, slow};

const BOTH: [Dialect; 2] = [Dialect::Steer, Dialect::Adept2018];

#[test]
fn t09_a_silent_caller_ramps_to_zero_and_then_faults() {
    for dialect in BOTH {
        let mut bench = Bench::moving(dialect);
        let at = bench.truth();
        // The newest command is 16 ms old at the first of these ticks.
        bench.rest(9);
        assert_eq!(bench.mode(), ArmMode::Moving, "{dialect:?}");
        bench.rest(6);
        assert_eq!(
            bench.reason(),
            Some(FaultReason::StaleCommand),
            "{dialect:?}"
        );
        bench.rest(10);
        // 48 ms at full rate and a ramp under acceleration and jerk limits, not more.
        assert!(
            bench.travel(&at) < 10.0 * SEGMENT,
            "{dialect:?} {}",
            bench.travel(&at)
        );
        bench.assert_dead();
        bench.assert_revives();
    }
}

#[test]
fn t09_a_silent_caller_is_never_extrapolated() {
    let mut bench = Bench::moving(Dialect::Steer);
    let mut before = bench.truth();
    let mut speeds = Vec::new();
    for _ in 0..14 {
        bench.tick();
        speeds.push(bench.travel(&before));
        before = bench.truth();
    }
    assert!(
        speeds
            .windows(2)
            .skip(3)
            .all(|pair| pair[1] <= pair[0] + 1e-6),
        "{speeds:?}"
    );
    assert!(speeds[9] < 1e-6, "at rest before the fault: {speeds:?}");
}

#[test]
fn t09_a_late_renewal_resumes_within_the_window() {
    let mut bench = Bench::moving(Dialect::Steer);
    bench.rest(7);
    assert_eq!(bench.mode(), ArmMode::Moving);
    bench.go(slow(), 30);
    assert_eq!(bench.mode(), ArmMode::Moving);
}

#[test]
fn t09_late_old_repeated_and_foreign_commands_change_nothing() {
    let mut bench = Bench::moving(Dialect::Steer);
    let wild = Joints::from([-1.0; 6]);
    let (sequence, now) = (bench.sequence, bench.now);
    let five = Joints::from_slice(&[0.0; 5]).unwrap();
    for (sequence, stamp, rates) in [
        (sequence, now, wild),
        (1, now, wild),
        (sequence + 1, now - Duration::from_millis(49), wild),
        (sequence + 1, now + Duration::from_millis(500), wild),
        (sequence + 1, now, five),
    ] {
        let error = bench
            .arm()
            .command(&RateCommand {
                sequence,
                stamp,
                rates,
            })
            .unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Rejected, "{sequence} {stamp:?}");
        assert_eq!(bench.mode(), ArmMode::Moving);
    }
    let before = bench.truth();
    bench.go(slow(), 10);
    assert!((bench.travel(&before) - 10.0 * SEGMENT).abs() < 1e-5);
    assert_eq!(bench.arm().monitor().metrics().refused_commands, 5);
}

#[test]
fn t09_not_a_number_and_infinity_fault() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for dialect in BOTH {
            let mut bench = Bench::moving(dialect);
            let at = bench.truth();
            let error = bench.command([0.0, bad, 0.0, 0.0, 0.0, 0.0]).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Rejected);
            assert_eq!(bench.reason(), Some(FaultReason::NonFiniteCommand));
            bench.rest(10);
            assert!(bench.travel(&at) <= 4.0 * SEGMENT);
            bench.assert_dead();
        }
    }
}

#[test]
fn t09_a_billion_and_a_step_are_slowed_and_a_tiny_step_is_taken() {
    for dialect in BOTH {
        let mut bench = Bench::enabled(dialect);
        let tiny = 1e-5 / 0.016;
        bench.go([tiny, 0.0, 0.0, 0.0, 0.0, 0.0], 1);
        bench.go([0.0; 6], 20);
        assert_eq!(
            bench.mode(),
            ArmMode::Enabled,
            "{dialect:?}: a step of 1e-5 rad is no fault"
        );
        assert!(bench.travel(&Joints::from(HOME)) > 1e-6);

        let mut before = bench.arm().monitor().set_point().unwrap();
        for _ in 0..20 {
            bench.go([1e9, 0.0, 0.0, 0.0, 0.0, 0.0], 1);
            let ordered = bench.arm().monitor().set_point().unwrap();
            assert!(ordered[0] - before[0] <= 328_f64.to_radians() * 0.032);
            before = ordered;
        }
        assert!(!bench.arm().monitor().limits_acted().is_empty());
        let _ = bench.arm().stop();
        bench.rest(200);
        assert_eq!(
            bench.mode(),
            ArmMode::Enabled,
            "{dialect:?} {:?}",
            bench.arm().monitor().fault()
        );
    }
}

#[test]
fn t13_a_killed_driver_leaves_at_most_two_segments() {
    for dialect in BOTH {
        let mut bench = Bench::moving(dialect);
        let at = bench.truth();
        // In the middle of a segment.
        bench.command(slow()).unwrap();
        bench.rig.advance_to(bench.now + Duration::from_millis(8));
        bench.rig.kill();
        bench.rest(60);
        let travel = bench.travel(&at);
        println!(
            "{dialect:?}: {:.2} segments after the kill",
            travel / SEGMENT
        );
        // A late segment of the 2018 dialect may cover two periods.
        let most = if dialect == Dialect::Steer { 2.0 } else { 4.0 };
        assert!(travel <= most * SEGMENT + 1e-6, "{dialect:?} {travel}");
        let stands = bench.truth();
        bench.rest(60);
        assert_eq!(bench.travel(&stands), 0.0);
    }
}

#[test]
fn t13_a_cut_cable_runs_into_the_controllers_watchdog() {
    let mut bench = Bench::moving(Dialect::Steer);
    let at = bench.truth();
    bench.rig.cut(true);
    bench.rest(10);
    assert!(bench.travel(&at) <= 2.0 * SEGMENT + 1e-6);
    let disarmed = bench
        .entries()
        .into_iter()
        .rev()
        .find_map(|entry| match entry.record {
            Record::Disarmed(reason) => reason,
            _ => None,
        });
    assert_eq!(
        disarmed,
        Some(robots::viper::wire::steer::Refusal::Watchdog)
    );
}

#[test]
fn t19_a_start_0_02_rad_away_is_refused_and_nothing_moves() {
    // The encoders read wrongly from the start: only the controller can know.
    let mut bench = Bench::new(Dialect::Steer);
    bench
        .emulator()
        .turn(|knobs| knobs.encoder_offset[1] = 0.02);
    bench.rest(20);
    bench.arm().enable().unwrap();
    let at = bench.truth();
    bench.try_to_go(slow(), 10);
    assert_eq!(bench.reason(), Some(FaultReason::StartMismatch));
    assert_eq!(bench.travel(&at), 0.0);
    bench.assert_dead();

    // The arm is pushed between enabling and the first command.
    for dialect in BOTH {
        let mut bench = Bench::enabled(dialect);
        bench
            .emulator()
            .turn(|knobs| knobs.encoder_offset[1] = 0.02);
        bench.rest(8);
        assert_eq!(
            bench.reason(),
            Some(FaultReason::UncommandedMotion),
            "{dialect:?}"
        );
        bench.assert_dead();
    }
}

#[test]
fn t19_an_arm_that_does_not_follow_faults() {
    for dialect in BOTH {
        let mut bench = Bench::moving(dialect);
        bench
            .emulator()
            .turn(|knobs| knobs.encoder_offset[4] = -0.2);
        bench.try_to_go(slow(), 30);
        assert_eq!(
            bench.reason(),
            Some(FaultReason::TrackingError),
            "{dialect:?}"
        );
        bench.assert_dead();
    }
}

#[test]
fn a_straight_wrist_is_not_enabled_for_cartesian_motion() {
    // V+'s READY pose.
    let ready = Joints::from([0.0, -90.0, 180.0, 0.0, 0.0, 0.0].map(f64::to_radians));
    let emulator = EmulatorConfig::viper(Dialect::Steer, ready);
    let mut bench = Bench::with(Config::viper("emulated", Dialect::Steer), emulator.clone());
    bench.rest(20);
    assert_eq!(
        bench.arm().enable().unwrap_err().kind(),
        ErrorKind::WrongMode
    );
    let mut config = Config::viper("emulated", Dialect::Steer);
    config.tolerances.wrist_bend = 0.0;
    let mut bench = Bench::with(config, emulator);
    bench.rest(20);
    bench.arm().enable().unwrap();
}
