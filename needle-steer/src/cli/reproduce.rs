//! `reproduce`: the paper's four experiments.

use std::fs::File;
use std::io::Write;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};

use anyhow::Context;
use clap::Args;
use indicatif::ProgressBar;

use super::run::interrupt_flag;
use super::{Usage, print_json};
use crate::experiments::{ExperimentResult, Finished, reproduce};
use crate::reproduction::{Document, Request, one};
use crate::results::{check_free, claim, save};

/// The paper's four experiments over seeds: Table I beside the paper's values.
#[derive(Debug, Args)]
pub(super) struct ReproduceArgs {
    /// Experiments, comma-separated, of e1, e2, e3, e4.
    #[arg(long, value_delimiter = ',', default_value = "e1,e2,e3,e4")]
    experiments: Vec<String>,
    /// Law of the controlled experiments e2 and e4.
    #[arg(long, default_value = "paper")]
    law: String,
    /// Runs of each experiment.
    #[arg(long, default_value_t = 20)]
    runs: u64,
    /// First seed.
    #[arg(long, default_value_t = 1, value_parser = super::seed)]
    seed: u64,
    /// Preset of the phantom.
    #[arg(long, default_value = "paper")]
    phantom: String,
    /// What closes the loop.
    #[arg(long)]
    sensor: Option<String>,
    /// Threads; all cores by default.
    #[arg(long)]
    jobs: Option<NonZeroUsize>,
    /// Add what brackets every result: no control, an oracle, the controller's model as plant.
    #[arg(long)]
    brackets: bool,
    /// Change one key of the configuration of every run: key=value.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Folder for the results; made if missing.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print the results as JSON.
    #[arg(long)]
    json: bool,
}

/// The results of all runs.
const RESULTS: &str = "reproduce.json";
/// Finished runs, a line each, until the results of all of them are written.
const LINES: &str = "runs.jsonl";

pub(super) fn execute(args: &ReproduceArgs) -> anyhow::Result<ExitCode> {
    let plan = args.request().plan().map_err(|e| Usage(e.to_string()))?;
    let lines = args.out.as_deref().map(claim_folder).transpose()?;
    let lines = lines.map(Mutex::new);
    let interrupt = interrupt_flag()?;
    let jobs = args
        .jobs
        .or_else(|| std::thread::available_parallelism().ok())
        .map_or(1, NonZeroUsize::get);
    let progress = ProgressBar::new(plan.len());
    let finished = |run: &Finished| {
        progress.inc(1);
        if let Some(lines) = &lines {
            // A full disk ends nothing: all of it is written again at the end, or printed.
            let _ = keep(
                &mut lines.lock().unwrap_or_else(PoisonError::into_inner),
                run,
            );
        }
    };
    let found = reproduce(&plan, jobs, |config| one(config, &interrupt), finished);
    progress.finish_and_clear();
    let document = Document {
        experiments: &found.experiments,
        set: &args.set,
        finished: found.finished,
        planned: found.planned,
    };
    let printed = if args.json {
        print_json(&document)
    } else {
        print_table(&found.experiments).map_err(anyhow::Error::from)
    };
    if let Some(out) = &args.out {
        write_results(out, &document, args.json)?;
    }
    printed?;
    if let Some(error) = found.error {
        return Err(error.into());
    }
    if found.finished < found.planned {
        anyhow::bail!(
            "interrupted; {} of {} runs are finished and kept",
            found.finished,
            found.planned
        );
    }
    Ok(ExitCode::SUCCESS)
}

/// A folder for this process alone; its file of finished runs.
fn claim_folder(out: &Path) -> anyhow::Result<File> {
    std::fs::create_dir_all(out).map_err(|e| Usage(format!("{}: {e}", out.display())))?;
    check_free(&out.join(RESULTS))?;
    Ok(claim(&out.join(LINES))?)
}

fn keep(lines: &mut File, run: &Finished) -> std::io::Result<()> {
    let mut line = serde_json::to_vec(run)?;
    line.push(b'\n');
    lines.write_all(&line)?;
    lines.sync_data()
}

/// Writes the results; on a disk that takes them no more, they are printed.
fn write_results(out: &Path, document: &Document<'_>, printed: bool) -> anyhow::Result<()> {
    if document.finished == 0 {
        return Ok(std::fs::remove_file(out.join(LINES))?);
    }
    let written = save(&out.join(RESULTS), |file| {
        serde_json::to_writer_pretty(&mut *file, document)?;
        Ok(writeln!(file)?)
    });
    if written.is_ok() {
        // It holds nothing more.
        let _ = std::fs::remove_file(out.join(LINES));
    } else if !printed {
        print_json(document)?;
    }
    written.context("the results of all finished runs are printed as JSON, not written")
}

impl ReproduceArgs {
    fn request(&self) -> Request {
        Request {
            experiments: self.experiments.clone(),
            law: self.law.clone(),
            runs: self.runs,
            seed: self.seed,
            phantom: self.phantom.clone(),
            sensor: self.sensor.clone(),
            brackets: self.brackets,
            set: self.set.clone(),
        }
    }
}

fn print_table(results: &[ExperimentResult]) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{:<4} {:<15} {:<10} {:<36} {:>9} {:>8} {:>8} {:>8} {:>8}",
        "", "law", "column", "target", "paper mm", "5 %", "median", "95 %", "passed"
    )?;
    for r in results {
        let passed = r
            .runs
            .iter()
            .filter(|run| run.ended == "target passed")
            .count();
        writeln!(
            out,
            "{:<4} {:<15} {:<10} {:<36} {:>9.1} {:>8.3} {:>8.3} {:>8.3} {:>5}/{}",
            r.experiment.name,
            r.law,
            r.column.name(),
            r.experiment.target,
            r.experiment.paper_error_mm,
            r.p5_mm,
            r.median_mm,
            r.p95_mm,
            passed,
            r.runs.len(),
        )?;
    }
    Ok(())
}
