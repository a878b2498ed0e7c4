//! Insertions in wide worlds, each verdict held against the truth. Prints a line a run, then what
//! must not happen and how often the truth confirms the cause that is named.
//!
//! `cargo run --release -p needle-steer --example wide [-- FIRST COUNT JOBS]`
#![expect(clippy::print_stdout, reason = "an example reports on stdout")]

use std::collections::BTreeMap;
use std::process::ExitCode;

use needle_steer::campaign::interval;
use needle_steer::experiments::in_parallel;
use needle_steer::robustness::wide::{Verdict, World, judge};

fn main() -> ExitCode {
    let mut numbers = std::env::args()
        .skip(1)
        .filter_map(|a| a.parse::<u64>().ok());
    let first = numbers.next().unwrap_or(10_000);
    let count = numbers.next().unwrap_or(2000);
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let jobs = numbers
        .next()
        .and_then(|n| usize::try_from(n).ok())
        .unwrap_or(cores);
    let worlds: Vec<World> = (first..first + count).map(World::new).collect();
    let verdicts = in_parallel(&worlds, jobs, |world| {
        let verdict = world
            .config()
            .map_err(|e| e.to_string())
            .and_then(|config| judge(&config).map_err(|e| e.to_string()));
        match &verdict {
            Ok(v) => println!("{}", line(world, v)),
            Err(error) => println!("{}|not carried out|{error}", world.index),
        }
        verdict
    });
    let done: Vec<&Verdict> = verdicts.iter().flatten().collect();
    let passed = done.iter().filter(|v| v.ended.is_success()).count();
    let named = done.len() - passed;
    let mut causes = BTreeMap::<String, (u64, u64)>::new();
    for verdict in &done {
        let Some(cause) = verdict.cause else {
            continue;
        };
        let tally = causes.entry(cause.to_string()).or_default();
        tally.0 += 1;
        tally.1 += u64::from(verdict.confirmed);
    }
    let confirmed: u64 = causes.values().map(|(_, confirmed)| confirmed).sum();
    let rate = |what: &str, hits: u64, of: u64| {
        let [low, high] = interval::proportion(hits, of);
        println!(
            "{what}: {hits} of {of} ({:.1}-{:.1} %)",
            low * 100.0,
            high * 100.0
        );
    };
    let tally = |of: fn(&Verdict) -> bool| done.iter().filter(|v| of(v)).count() as u64;
    let all = done.len() as u64;
    println!(
        "{} runs, {} not carried out",
        done.len(),
        verdicts.len() - done.len()
    );
    rate("passed", passed as u64, all);
    rate("damaged needle, tissue or world", tally(|v| v.spoilt), all);
    rate("given up, without a truth", tally(|v| v.given_up), all);
    rate(
        "passed with the tip elsewhere",
        tally(Verdict::is_false_pass),
        passed as u64,
    );
    rate("pushed blind", tally(Verdict::pushed_blind), all);
    rate(
        "the same, with the tissue or against it",
        tally(|v| v.blind_in_world_mm > 3.0),
        all,
    );
    rate("failed model read", tally(Verdict::read_failed_model), all);
    rate("cause confirmed by the truth", confirmed, named as u64);
    for (cause, (count, confirmed)) in causes {
        rate(&format!("  {cause}"), confirmed, count);
    }
    if tally(|v| v.is_false_pass() || v.pushed_blind() || v.read_failed_model()) == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

fn line(world: &World, v: &Verdict) -> String {
    let mut marks = String::new();
    for (is, mark) in [
        (v.is_false_pass(), "FALSE-PASS "),
        (v.pushed_blind(), "BLIND "),
        (v.read_failed_model(), "FROZEN "),
        (!v.confirmed, "UNCONFIRMED "),
        (v.given_up, "GIVEN-UP "),
        (v.spoilt, "spoilt "),
    ] {
        if is {
            marks.push_str(mark);
        }
    }
    format!(
        "{}|{}|{}|{marks}|said {:.2} ahead {:.2} blind {:.2} in World {:.2} frozen {:.2}|{:?}|{}",
        world.index,
        world.overrides[0],
        v.ended,
        v.said_off_mm,
        v.axial_mm,
        v.blind_mm,
        v.blind_in_world_mm,
        v.frozen_s,
        v.truths,
        world.overrides[1..].join(" ")
    )
}
