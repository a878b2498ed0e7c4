//! T5, T6, T14: delays, lies, stalls.

use std::time::Duration;

use hal::{ArmMode, FaultReason};
use robots::viper::Dialect;
use robots::viper::emulator::Answers;

use crate::bench::{Bench, SEGMENT, slow};

const BOTH: [Dialect; 2] = [Dialect::Steer, Dialect::Adept2018];

#[test]
fn t05_delays_within_the_bounds_are_ridden_out_and_longer_ones_fault() {
    for dialect in BOTH {
        for delay_ms in [0, 5, 20, 60, 400, 700, 2000] {
            let mut bench = Bench::enabled(dialect);
            let delay = Duration::from_millis(delay_ms);
            bench.emulator().turn(|knobs| {
                knobs.feedback_delay = delay;
                knobs.jitter = Duration::from_millis(3);
            });
            bench.try_to_go(slow(), 200);
            if delay_ms <= 60 {
                assert_eq!(bench.mode(), ArmMode::Moving, "{dialect:?} {delay_ms} ms");
            } else {
                assert_eq!(
                    bench.reason(),
                    Some(FaultReason::StaleFeedback),
                    "{dialect:?} {delay_ms} ms"
                );
                bench.rest(10);
                bench.assert_dead();
            }
        }
    }
}

#[test]
fn t05_late_answers_slow_the_arm_and_then_stop_it() {
    for dialect in BOTH {
        for delay_ms in [0, 5, 40, 400, 700, 2000] {
            let mut bench = Bench::enabled(dialect);
            bench.go(slow(), 10);
            let at = bench.truth();
            bench
                .emulator()
                .turn(|knobs| knobs.answer_delay = Duration::from_millis(delay_ms));
            bench.try_to_go(slow(), 120);
            let travel = bench.travel(&at);
            assert!(
                travel <= 121.0 * SEGMENT * 1.01,
                "{dialect:?} {delay_ms} ms: {travel}"
            );
            if delay_ms <= 40 {
                assert_eq!(bench.mode(), ArmMode::Moving, "{dialect:?} {delay_ms} ms");
            } else if delay_ms >= 700 {
                // The `steer` controller's own watchdog may be first.
                let reason = bench.reason();
                assert!(
                    matches!(
                        reason,
                        Some(FaultReason::StaleAcknowledgement | FaultReason::ControllerError)
                    ),
                    "{dialect:?} {delay_ms} ms: {reason:?}"
                );
                bench.rest(10);
                bench.assert_dead();
            }
        }
    }
}

#[test]
fn t05_frozen_feedback_alone_and_frozen_answers_alone_fault() {
    for dialect in BOTH {
        let mut bench = Bench::moving(dialect);
        bench.emulator().turn(|knobs| knobs.freeze_feedback = true);
        bench.try_to_go(slow(), 30);
        assert_eq!(
            bench.reason(),
            Some(FaultReason::StaleFeedback),
            "{dialect:?}"
        );
        bench.rest(2);
        bench.assert_dead();

        let mut bench = Bench::moving(dialect);
        bench.emulator().turn(|knobs| knobs.freeze_answers = true);
        bench.try_to_go(slow(), 40);
        let expected = match dialect {
            Dialect::Steer => FaultReason::ControllerError,
            Dialect::Adept2018 => FaultReason::StaleAcknowledgement,
        };
        assert_eq!(bench.reason(), Some(expected), "{dialect:?}");
        bench.rest(2);
        bench.assert_dead();
    }
}

#[test]
fn t05_lost_feedback_is_counted_and_bridged() {
    let mut bench = Bench::enabled(Dialect::Steer);
    bench.emulator().turn(|knobs| knobs.feedback_loss = 0.3);
    bench.go(slow(), 500);
    assert_eq!(bench.mode(), ArmMode::Moving);
    let missed = bench.arm().monitor().metrics().missed_feedback;
    // 500 draws at 0.3: five standard deviations are 51.
    assert!((99..=201).contains(&missed), "{missed}");
}

#[test]
fn t06_answers_are_believed_in_neither_code_nor_number() {
    for dialect in BOTH {
        for (lie, expected) in [
            (Answers::Failure, FaultReason::ControllerError),
            (Answers::WrongSequence, FaultReason::Protocol),
            (Answers::Twice, FaultReason::Protocol),
        ] {
            let mut bench = Bench::moving(dialect);
            let at = bench.truth();
            bench.emulator().turn(|knobs| knobs.answers = lie);
            bench.try_to_go(slow(), 4);
            assert_eq!(bench.reason(), Some(expected), "{dialect:?} {lie:?}");
            bench.rest(4);
            assert!(bench.travel(&at) < 4.0 * SEGMENT, "{dialect:?} {lie:?}");
            bench.emulator().turn(|knobs| knobs.answers = Answers::True);
            bench.rest(20);
            bench.assert_dead();
            bench.assert_revives();
        }
    }
}

#[test]
fn t14_a_stall_of_100_ms_makes_up_for_nothing() {
    let mut bench = Bench::moving(Dialect::Steer);
    let at = bench.truth();
    let until = bench.now + Duration::from_millis(96);
    bench.rig.stall(until);
    bench.rest(6);
    // Two segments were under way; the missed ones are not made up for.
    assert!(bench.travel(&at) <= 2.0 * SEGMENT + 1e-6);
    let before = bench.truth();
    bench.try_to_go(slow(), 1);
    // A late segment covers at most two periods.
    assert!(bench.travel(&before) <= 2.0 * SEGMENT + 1e-6);
    bench.try_to_go(slow(), 10);
    assert!(matches!(
        bench.mode(),
        ArmMode::Moving | ArmMode::Faulted(_)
    ));
}

#[test]
fn t14_a_clock_jump_stops_the_arm() {
    for dialect in BOTH {
        let mut bench = Bench::moving(dialect);
        let at = bench.truth();
        bench.rig.jump(Duration::from_secs(10));
        bench.rest(1);
        let reason = bench.reason().unwrap();
        assert!(
            matches!(
                reason,
                FaultReason::StaleFeedback | FaultReason::StaleAcknowledgement
            ),
            "{reason:?}"
        );
        bench.rest(4);
        assert!(bench.travel(&at) < 3.0 * SEGMENT, "{dialect:?}");
        bench.rest(20);
        bench.assert_dead();
    }
}
