//! T7, T8, T20: stops.

use hal::{Arm, ArmMode, ErrorKind, FaultReason, Stamp};
use robots::viper::emulator::{Knobs, Record};
use robots::viper::{Dialect, Port};

use crate::bench::{Bench, PERIOD, SEGMENT, slow};

const BOTH: [Dialect; 2] = [Dialect::Steer, Dialect::Adept2018];

/// Whether a frame for the motion port is a stop.
fn is_stop(bytes: &[u8]) -> bool {
    let field = |at: usize| i32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
    field(4) == 1202 || field(4) == 11 && field(16) == -4
}

/// Motion frames received after `since`: stamp, and whether it is a stop.
fn orders(bench: &Bench, since: Stamp) -> Vec<(Stamp, bool)> {
    let entries = bench
        .entries()
        .into_iter()
        .filter(|entry| entry.stamp >= since);
    entries
        .filter_map(|entry| match entry.record {
            Record::Received(Port::Motion, bytes) => Some((entry.stamp, is_stop(&bytes))),
            _ => None,
        })
        .collect()
}

/// A knob that forbids motion, the fault that follows, and its release.
type Trouble = (fn(&mut Knobs), FaultReason);

const TROUBLES: [Trouble; 5] = [
    (|knobs| knobs.e_stop = true, FaultReason::EmergencyStop),
    (|knobs| knobs.powered = false, FaultReason::DrivesOff),
    (|knobs| knobs.mode = 1, FaultReason::NotAutomatic),
    (|knobs| knobs.mode = 0, FaultReason::NotAutomatic),
    (
        |knobs| knobs.error_code = -1007,
        FaultReason::ControllerError,
    ),
];

fn stops_and_stays_stopped(dialect: Dialect, (trouble, expected): Trouble) {
    let mut bench = Bench::moving(dialect);
    let (at, since) = (bench.truth(), bench.now);
    bench.emulator().turn(trouble);
    bench.try_to_go(slow(), 12);
    assert_eq!(bench.reason(), Some(expected), "{dialect:?}");
    // The controller brakes by itself: v^2 / 2a, and what it moved before its next cycle.
    assert!(
        bench.travel(&at) < 2.0 * SEGMENT,
        "{dialect:?} {}",
        bench.travel(&at)
    );
    // Feedback tells of it at the next cycle (the 2018 program: every 112 ms); from then on
    // nothing but stops.
    let report = match dialect {
        Dialect::Steer => PERIOD,
        Dialect::Adept2018 => PERIOD * 7,
    };
    let late = orders(&bench, since + report + PERIOD);
    assert!(
        late.iter().all(|(_, stop)| *stop),
        "{dialect:?} {expected:?}: {late:?}"
    );
    assert!(
        orders(&bench, since).iter().any(|(_, stop)| *stop),
        "{dialect:?}: no stop sent"
    );

    let refused = bench.arm().reset().unwrap_err();
    assert_eq!(
        refused.kind(),
        ErrorKind::Faulted,
        "the cause is still there"
    );
    bench.emulator().turn(|knobs| *knobs = Knobs::default());
    bench.rest(20);
    assert_eq!(bench.reason(), Some(expected));
    bench.assert_dead();
    bench.assert_revives();
}

#[test]
fn t07_an_emergency_stop_while_moving_stops_and_its_release_moves_nothing() {
    for dialect in BOTH {
        stops_and_stays_stopped(dialect, TROUBLES[0]);
    }
}

#[test]
fn t08_power_mode_and_errors_stop_and_their_end_moves_nothing() {
    for trouble in &TROUBLES[1..] {
        stops_and_stays_stopped(Dialect::Steer, *trouble);
    }
    // The 2018 program never tells of errors.
    for trouble in &TROUBLES[1..4] {
        stops_and_stays_stopped(Dialect::Adept2018, *trouble);
    }
}

#[test]
fn t08_enabling_is_refused_while_the_controller_is_not_ready() {
    for (trouble, _) in TROUBLES {
        let mut bench = Bench::new(Dialect::Steer);
        bench.emulator().turn(trouble);
        bench.rest(20);
        assert_eq!(bench.mode(), ArmMode::Connected);
        assert_eq!(
            bench.arm().enable().unwrap_err().kind(),
            ErrorKind::WrongMode
        );
        bench.emulator().turn(|knobs| *knobs = Knobs::default());
        bench.rest(2);
        assert_eq!(bench.mode(), ArmMode::Connected);
        bench.arm().enable().unwrap();
    }
}

#[test]
fn t08_a_program_that_aborts_without_power_stays_stopped_too() {
    let mut bench = Bench::moving(Dialect::Adept2018);
    bench.emulator().turn(|knobs| {
        knobs.abort_without_power = true;
        knobs.e_stop = true;
    });
    bench.try_to_go(slow(), 12);
    assert_eq!(bench.reason(), Some(FaultReason::ConnectionLost));
    bench.emulator().turn(|knobs| *knobs = Knobs::default());
    bench.rest(40);
    bench.assert_dead();
    bench.assert_revives();
}

#[test]
fn t08_a_short_press_between_two_reports_still_ends_the_motion() {
    // Pressed and released within one report of the 2018 program: the controller lost power.
    let mut bench = Bench::moving(Dialect::Adept2018);
    bench.emulator().turn(|knobs| knobs.e_stop = true);
    bench.emulator().turn(|knobs| knobs.e_stop = false);
    bench.try_to_go(slow(), 12);
    assert!(bench.reason().is_some());
    bench.assert_dead();
}

#[test]
fn t20_stop_works_in_every_state_and_is_idempotent() {
    for dialect in BOTH {
        let mut bench = Bench::new(dialect);
        assert_eq!(bench.mode(), ArmMode::Disconnected);
        bench.arm().stop().unwrap();
        bench.rest(20);
        for expected in [ArmMode::Connected, ArmMode::Enabled] {
            assert_eq!(bench.mode(), expected);
            let since = bench.now;
            bench.arm().stop().unwrap();
            bench.arm().stop().unwrap();
            assert_eq!(bench.mode(), expected);
            bench.rest(1);
            let sent = orders(&bench, since);
            assert_eq!(sent.len(), 1, "one stop, also when idle: {sent:?}");
            assert!(sent[0].1 && sent[0].0 == since, "at once");
            if expected == ArmMode::Connected {
                bench.arm().enable().unwrap();
            }
        }
        bench.go(slow(), 30);
        let at = bench.truth();
        bench.arm().stop().unwrap();
        assert_eq!(bench.mode(), ArmMode::Stopping);
        bench.arm().stop().unwrap();
        assert_eq!(
            bench.command(slow()).unwrap_err().kind(),
            ErrorKind::WrongMode
        );
        bench.rest(30);
        assert_eq!(bench.mode(), ArmMode::Enabled);
        assert!(
            bench.travel(&at) <= 2.0 * 2.0 * SEGMENT,
            "{dialect:?} {}",
            bench.travel(&at)
        );
        bench.go(slow(), 10);
        let _ = bench.command([f64::INFINITY; 6]);
        assert_eq!(bench.reason(), Some(FaultReason::NonFiniteCommand));
        bench.arm().stop().unwrap();
        bench.arm().stop().unwrap();
        assert_eq!(bench.reason(), Some(FaultReason::NonFiniteCommand));
        bench.rest(10);
        bench.assert_dead();
        bench.assert_revives();
    }
}

#[test]
fn t20_dropping_the_driver_stops_also_when_a_panic_unwinds() {
    for dialect in BOTH {
        let mut bench = Bench::moving(dialect);
        let (at, since) = (bench.truth(), bench.now);
        drop(bench.arm.take());
        bench.rest(20);
        assert!(
            orders(&bench, since).iter().any(|(_, stop)| *stop),
            "{dialect:?}"
        );
        assert!(bench.travel(&at) <= 2.0 * 2.0 * SEGMENT);

        let mut bench = Bench::moving(dialect);
        let (at, since) = (bench.truth(), bench.now);
        let arm = bench.arm.take();
        let unwound = std::panic::catch_unwind(std::panic::AssertUnwindSafe(move || {
            let _arm = arm;
            std::panic::resume_unwind(Box::new("the controller's law fails"));
        }));
        assert!(unwound.is_err());
        bench.rest(20);
        assert!(
            orders(&bench, since).iter().any(|(_, stop)| *stop),
            "{dialect:?}"
        );
        assert!(bench.travel(&at) <= 2.0 * 2.0 * SEGMENT);
        let stands = bench.truth();
        bench.rest(60);
        assert_eq!(bench.travel(&stands), 0.0);
    }
}
