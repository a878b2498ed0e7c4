//! The no-divergence campaign: 1 000 insertions over laws, presets, start values of the stiffness
//! and bad sensors, every step audited. Prints a table and every violation.
//!
//! `cargo run --release -p needle-steer --example robustness [-- FIRST COUNT]`
#![expect(clippy::print_stdout, reason = "an example reports on stdout")]

use std::collections::BTreeMap;
use std::process::ExitCode;

use hybrid_control::LAW_NAMES;
use needle_steer::experiments::in_parallel;
use needle_steer::outcome::Ended;
use needle_steer::robustness::{Case, Outcome, PRESETS, carry_out};
use needle_steer::statistics::percentile;

/// Figures of one law on one preset.
#[derive(Default)]
struct Cell {
    runs: usize,
    passed: usize,
    unreachable: usize,
    stopped: usize,
    violations: usize,
    errors: Vec<f64>,
}

impl Cell {
    fn take(&mut self, result: &Result<Outcome, String>) {
        self.runs += 1;
        match result {
            Ok(outcome) => {
                match outcome.ended {
                    Ended::TargetPassed => {
                        self.passed += 1;
                        self.errors.push(outcome.error_mm);
                    }
                    Ended::Unreachable(_) => self.unreachable += 1,
                    _ => self.stopped += 1,
                }
                self.violations += outcome.violations.len();
            }
            Err(_) => self.violations += 1,
        }
    }

    fn row(&self, law: &str, preset: &str) -> String {
        format!(
            "| `{law}` | {preset} | {} | {} | {} | {} | {} | {:.3} / {:.3} |",
            self.runs,
            self.passed,
            self.unreachable,
            self.stopped,
            self.violations,
            percentile(&self.errors, 0.5),
            percentile(&self.errors, 0.95),
        )
    }
}

fn main() -> ExitCode {
    let mut numbers = std::env::args().skip(1).filter_map(|a| a.parse().ok());
    let first: u64 = numbers.next().unwrap_or(0);
    let count: u64 = numbers.next().unwrap_or(1000);
    let cases: Vec<Case> = (first..first + count).map(Case::new).collect();
    let jobs = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    println!("case,law,preset,error_mm,estimate_off_mm,violations,ended");
    let results = in_parallel(&cases, jobs, |case| {
        let config = case.config().map_err(|e| e.to_string())?;
        let outcome = carry_out(&config).map_err(|e| e.to_string())?;
        // As it goes: a campaign takes long.
        println!(
            "{},{},{},{:.4},{:.3},{},{}",
            case.index,
            config.run.law,
            config.run.phantom,
            outcome.error_mm,
            outcome.estimate_off_mm,
            outcome.violations.len(),
            outcome.ended,
        );
        Ok((config.run.law, config.run.phantom, outcome))
    });
    let mut cells: BTreeMap<(String, String), Cell> = BTreeMap::new();
    let mut broken = 0;
    for (case, result) in cases.iter().zip(&results) {
        let (key, result) = match result {
            Ok((law, preset, outcome)) => ((law.clone(), preset.clone()), Ok(outcome.clone())),
            Err(error) => (("?".into(), "?".into()), Err(String::clone(error))),
        };
        cells.entry(key).or_default().take(&result);
        let found: Vec<String> = match &result {
            Ok(outcome) => outcome.violations.iter().map(ToString::to_string).collect(),
            Err(error) => vec![error.clone()],
        };
        if !found.is_empty() {
            broken += 1;
            println!(
                "case {}: {} [{}]",
                case.index,
                found.join("; "),
                case.overrides.join(" ")
            );
        }
        if let Ok(Outcome {
            ended: Ended::Stopped(reason),
            ..
        }) = &result
        {
            println!("case {}: stopped: {reason}", case.index);
        }
    }
    println!(
        "| law | preset | runs | passed | out of reach | stopped | violations | error of those that passed, median / 95 % (mm) |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for law in LAW_NAMES {
        let mut presets = PRESETS.to_vec();
        presets.sort_unstable();
        presets.dedup();
        for preset in presets {
            if let Some(cell) = cells.get(&(law.to_owned(), preset.to_owned())) {
                println!("{}", cell.row(law, preset));
            }
        }
    }
    println!("{broken} of {count} runs broke a limit, diverged or had no verdict");
    if broken == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
