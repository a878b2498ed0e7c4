//! T4: connections.

use hal::{Arm, ArmMode, ErrorKind, FaultReason, Joints};
use robots::viper::emulator::{EmulatorConfig, Record};
use robots::viper::{Config, Dialect, LinkError, Port, Refused, Unfit};

use crate::bench::{Bench, HOME, slow};

const BOTH: [Dialect; 2] = [Dialect::Steer, Dialect::Adept2018];

#[test]
fn t04_a_cut_cable_stops_the_arm_and_the_link_comes_back_without_enabling() {
    for dialect in BOTH {
        let mut bench = Bench::moving(dialect);
        let at = bench.truth();
        bench.rig.cut(true);
        bench.try_to_go(slow(), 40);
        // The silence shows first in whichever watchdog is the shortest.
        let reason = bench.reason().unwrap();
        assert!(
            matches!(
                reason,
                FaultReason::StaleFeedback | FaultReason::StaleAcknowledgement
            ),
            "{reason:?}"
        );
        // Nothing arrives any more: what was under way, at most two segments.
        let period = bench.arm().description().period.as_secs_f64();
        assert!(
            bench.travel(&at) <= 2.0 * 0.05 * 2.0 * period,
            "{}",
            bench.travel(&at)
        );
        let state = bench.arm().state();
        assert!(matches!(
            state.unwrap_err().kind(),
            ErrorKind::Timeout | ErrorKind::Disconnected
        ));
        bench.rest(200);
        bench.rig.cut(false);
        let links = bench.arm().monitor().metrics().links;
        bench.rest(400);
        assert_eq!(
            bench.arm().monitor().metrics().links,
            links + 1,
            "connected again"
        );
        assert!(
            bench.arm().state().unwrap().rates.max_abs() < 1e-3,
            "no speed of old"
        );
        bench.assert_dead();
        bench.assert_revives();
    }
}

#[test]
fn t04_a_cut_cable_while_only_connected_is_no_fault() {
    for dialect in BOTH {
        let mut bench = Bench::new(dialect);
        bench.rest(20);
        assert_eq!(bench.mode(), ArmMode::Connected);
        bench.rig.cut(true);
        bench.rest(100);
        assert_eq!(bench.mode(), ArmMode::Disconnected);
        bench.rig.cut(false);
        bench.rest(700);
        assert_eq!(bench.mode(), ArmMode::Connected);
    }
}

#[test]
fn t04_a_closed_connection_faults_an_enabled_arm() {
    for dialect in BOTH {
        for port in Port::ALL {
            let mut bench = Bench::moving(dialect);
            let at = bench.truth();
            bench.emulator().throw_out(port);
            bench.try_to_go(slow(), 2);
            assert_eq!(
                bench.reason(),
                Some(FaultReason::ConnectionLost),
                "{dialect:?} {port:?}"
            );
            bench.rest(2);
            assert!(bench.travel(&at) < 4.0 * crate::bench::SEGMENT);
            bench.rest(40);
            bench.assert_dead();
            bench.assert_revives();
        }
    }
}

#[test]
fn t04_half_open_the_controller_hears_but_is_not_heard() {
    for dialect in BOTH {
        let mut bench = Bench::moving(dialect);
        bench.emulator().turn(|knobs| {
            knobs.freeze_feedback = true;
            knobs.freeze_answers = true;
        });
        bench.try_to_go(slow(), 60);
        assert!(bench.reason().is_some(), "{dialect:?}");
        let received = bench.entries().into_iter().rev();
        let mut stops = received.filter_map(|entry| match entry.record {
            Record::Received(Port::Motion, bytes) => Some(bytes),
            _ => None,
        });
        let last = stops.next().unwrap();
        let is_stop =
            last[16..20] == (-4_i32).to_be_bytes() || last[4..8] == 1202_i32.to_be_bytes();
        assert!(is_stop, "{dialect:?}: the last word is a stop");
        bench.assert_dead();
    }
}

#[test]
fn t04_accept_then_hang_and_refusal_are_named() {
    let mut bench = Bench::new(Dialect::Steer);
    bench.emulator().turn(|knobs| {
        knobs.freeze_feedback = true;
        knobs.freeze_answers = true;
    });
    bench.rest(100);
    assert_eq!(bench.mode(), ArmMode::Disconnected);
    assert_eq!(bench.arm().monitor().link_error(), LinkError::Mute);
    bench.rig.refuse(true);
    bench.rest(600);
    let error = bench.arm().monitor().link_error();
    assert!(matches!(error, LinkError::Connect { .. }), "{error}");
    assert_eq!(
        bench.arm().enable().unwrap_err().kind(),
        ErrorKind::Disconnected
    );
    bench
        .emulator()
        .turn(|knobs| *knobs = robots::viper::emulator::Knobs::default());
    bench.rig.refuse(false);
    bench.rest(400);
    assert_eq!(bench.mode(), ArmMode::Connected);
}

#[test]
fn a_controller_of_another_arm_is_named_and_nothing_moves() {
    let start = Joints::from(HOME);
    let mut seven = EmulatorConfig::viper(Dialect::Steer, start);
    seven.joints = 7;
    let mut shorter = EmulatorConfig::viper(Dialect::Steer, start);
    shorter.limits[3].upper = 1.0;
    let mut slower = EmulatorConfig::viper(Dialect::Steer, start);
    slower.limits[0].velocity = 1.0;
    let mut elsewhere = HOME;
    elsewhere[1] = 1.5;
    let outside = EmulatorConfig::viper(Dialect::Adept2018, Joints::from(elsewhere));
    for (emulator, expected) in [
        (seven, "7 joints"),
        (shorter, "joint 3 (from 0)"),
        (slower, "joint 0 (from 0)"),
        (outside, "joint 1 (from 0) stands at 1.5"),
    ] {
        let mut bench = Bench::with(Config::viper("emulated", emulator.dialect), emulator);
        bench.rest(20);
        let error = bench.arm().enable().unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Configuration);
        let cause = error.source.unwrap();
        assert!(cause.to_string().contains(expected), "{cause}");
        assert!(matches!(cause.downcast_ref(), Some(Refused::Unfit(_))));
        let at = bench.truth();
        bench.try_to_go(slow(), 20);
        assert_eq!(bench.travel(&at), 0.0);
    }
    let unfit = Unfit::Joints {
        expected: 6,
        found: 7,
    };
    assert!(unfit.to_string().contains('6'));
}

#[test]
fn the_wrong_program_behind_the_port_is_named_and_nothing_moves() {
    // A `steer` driver at a 2018 program.
    let emulator = EmulatorConfig::viper(Dialect::Adept2018, Joints::from(HOME));
    let mut bench = Bench::with(Config::viper("emulated", Dialect::Steer), emulator);
    bench.rest(20);
    assert_eq!(bench.reason(), Some(FaultReason::Protocol));
    let fault = bench.arm().monitor().fault().unwrap().to_string();
    assert!(
        fault.contains("2018 program") || fault.contains("does not belong"),
        "{fault}"
    );
    assert_eq!(bench.truth(), Joints::from(HOME));
    // And the other way round.
    let emulator = EmulatorConfig::viper(Dialect::Steer, Joints::from(HOME));
    let mut bench = Bench::with(Config::viper("emulated", Dialect::Adept2018), emulator);
    bench.rest(20);
    assert!(bench.arm().enable().is_err());
    assert_eq!(bench.truth(), Joints::from(HOME));
}
