//! T15: half an hour of virtual time with a mishap every few seconds. In a process of its own, so
//! that its memory can be watched.
//!
//! `cargo test --release -p robots --test viper_soak -- --nocapture` prints the figures.
#![expect(dead_code, reason = "the bench serves the other fault tests too")]
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a helper that fails fails its test, and tells its figures"
)]

#[path = "viper/bench.rs"]
mod bench;

use std::time::Duration;

use hal::{Arm, Joints};
use robots::viper::emulator::{Answers, EmulatorConfig, Knobs};
use robots::viper::{Config, Dialect, Port};

use bench::{Bench, HOME, slow};

/// Faults that a soak throws at the link, one at a time.
#[derive(Clone, Copy, Debug)]
enum Mishap {
    Cut,
    Closed,
    EStop,
    Manual,
    PowerOff,
    Error,
    FrozenFeedback,
    FrozenAnswers,
    Garbage,
    SilentCaller,
    BadCaller,
    Stall,
    Lie,
    Offset,
}

const MISHAPS: [Mishap; 14] = [
    Mishap::Cut,
    Mishap::Closed,
    Mishap::EStop,
    Mishap::Manual,
    Mishap::PowerOff,
    Mishap::Error,
    Mishap::FrozenFeedback,
    Mishap::FrozenAnswers,
    Mishap::Garbage,
    Mishap::SilentCaller,
    Mishap::BadCaller,
    Mishap::Stall,
    Mishap::Lie,
    Mishap::Offset,
];

fn happen(bench: &mut Bench, mishap: Mishap) {
    match mishap {
        Mishap::Cut => bench.rig.cut(true),
        Mishap::Closed => bench.emulator().throw_out(Port::State),
        Mishap::EStop => bench.emulator().turn(|knobs| knobs.e_stop = true),
        Mishap::Manual => bench.emulator().turn(|knobs| knobs.mode = 1),
        Mishap::PowerOff => bench.emulator().turn(|knobs| knobs.powered = false),
        Mishap::Error => bench.emulator().turn(|knobs| knobs.error_code = -1007),
        Mishap::FrozenFeedback => bench.emulator().turn(|knobs| knobs.freeze_feedback = true),
        Mishap::FrozenAnswers => bench.emulator().turn(|knobs| knobs.freeze_answers = true),
        Mishap::Garbage => bench.emulator().inject(Port::State, &[0x55; 40]),
        Mishap::SilentCaller => bench.rest(20),
        Mishap::BadCaller => {
            let _ = bench.command([f64::NAN; 6]);
        }
        Mishap::Stall => {
            let until = bench.now + Duration::from_millis(600);
            bench.rig.stall(until);
        }
        Mishap::Lie => bench
            .emulator()
            .turn(|knobs| knobs.answers = Answers::WrongSequence),
        Mishap::Offset => bench
            .emulator()
            .turn(|knobs| knobs.encoder_offset[2] = 0.08),
    }
}

fn resident_kib() -> usize {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages = statm
        .split_whitespace()
        .nth(1)
        .and_then(|pages| pages.parse().ok());
    pages.unwrap_or(0_usize) * 4
}

/// Half an hour with a mishap every few seconds: the number of mishaps and of missed ones.
fn soak(dialect: Dialect, minutes: u32) -> (u32, u32) {
    let mut emulator = EmulatorConfig::viper(dialect, Joints::from(HOME));
    emulator.journal = 0;
    let mut bench = Bench::with(Config::viper("emulated", dialect), emulator);
    let (mut mishaps, mut missed, mut noise) = (0, 0, 12_345_u64);
    let end = bench.now + Duration::from_secs(60 * u64::from(minutes));
    let mut memory = 0;
    while bench.now < end {
        noise = noise
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        bench.rest(20);
        bench.arm().reset().unwrap();
        bench.arm().enable().unwrap();
        // Out and back, so that the arm stays where it is over the half hour.
        let ticks = 40 + (noise >> 33) as u32 % 60;
        let sense = if mishaps % 2 == 0 { 1.0 } else { -1.0 };
        bench.go(slow().map(|rate| sense * rate), ticks);
        let mishap = MISHAPS[(noise >> 40) as usize % MISHAPS.len()];
        happen(&mut bench, mishap);
        mishaps += 1;
        // The 2018 program never tells of errors: the arm that stands still while it is ordered
        // to move shows as a tracking error, 0.05 rad later.
        let untold = dialect == Dialect::Adept2018 && matches!(mishap, Mishap::Error);
        bench.try_to_go(slow(), if untold { 160 } else { 60 });
        if bench.reason().is_none() {
            missed += 1;
            println!("missed {mishap:?}: {:?}", bench.mode());
        }
        // The cause goes; nothing may move, nothing may be enabled.
        bench.rig.cut(false);
        bench.emulator().turn(|knobs| *knobs = Knobs::default());
        bench.rest(10);
        bench.assert_dead();
        // Back-off may have grown.
        for _ in 0..500 {
            if bench.arm().state().is_ok() {
                break;
            }
            bench.tick();
        }
        if mishaps == 20 {
            memory = resident_kib();
        }
    }
    let grown = resident_kib().saturating_sub(memory);
    let metrics = bench.arm().monitor().metrics();
    println!(
        "{dialect:?}: {minutes} min, {mishaps} mishaps, {missed} missed, {} faults, {} links, {grown} KiB grown",
        metrics.faults, metrics.links
    );
    // The test harness allocates a little; a leak of one frame a cycle would be 5 MiB and more.
    assert!(grown < 2048, "{grown} KiB");
    (mishaps, missed)
}

#[test]
fn t15_half_an_hour_of_mishaps_with_steer() {
    let (mishaps, missed) = soak(Dialect::Steer, 30);
    assert!(mishaps > 200);
    assert_eq!(missed, 0);
}

#[test]
fn t15_half_an_hour_of_mishaps_with_the_2018_program() {
    let (mishaps, missed) = soak(Dialect::Adept2018, 30);
    assert!(mishaps > 200);
    assert_eq!(missed, 0);
}
