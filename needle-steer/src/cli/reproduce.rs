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
use serde::Serialize;

use super::run::{interrupt_flag, quoted};
use super::{Usage, print_json};
use crate::config::{self, Config, LARGEST_SEED};
use crate::controls::Controls;
use crate::experiments::{EXPERIMENTS, Experiment, ExperimentResult, Finished, Plan, reproduce};
use crate::outcome::{Ended, Summary};
use crate::results::{check_free, claim, save};
use crate::rig::Rig;
use crate::run::{RunError, Unobserved, run};

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
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(..=LARGEST_SEED))]
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

#[derive(Serialize)]
struct Document<'a> {
    experiments: &'a [ExperimentResult],
    /// Changes to the configuration of every run.
    set: &'a [String],
    finished: u64,
    planned: u64,
}

/// Why a run could not be carried out.
#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error(transparent)]
    Run(#[from] RunError),
    #[error("phantom: {0}")]
    Phantom(#[from] phantom::SettingsError),
}

pub(super) fn execute(args: &ReproduceArgs) -> anyhow::Result<ExitCode> {
    let plan = args.plan()?;
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

/// One run; nothing where the user stopped it.
fn one(config: &Config, interrupt: &Controls) -> Result<Option<Summary>, Failure> {
    if interrupt.is_interrupted() {
        return Ok(None);
    }
    let mut rig = Rig::new(config).map_err(RunError::from)?;
    let summary = run(config, &mut rig, &mut Unobserved, interrupt)?;
    Ok((summary.ended != Ended::Interrupted).then_some(summary))
}

impl ReproduceArgs {
    fn plan(&self) -> anyhow::Result<Plan> {
        let experiments: Result<Vec<Experiment>, Usage> = self
            .experiments
            .iter()
            .map(|name| {
                EXPERIMENTS
                    .into_iter()
                    .find(|e| e.name == name)
                    .ok_or_else(|| {
                        Usage(format!(
                            "--experiments: `{name}` is unknown; expected some of e1,e2,e3,e4"
                        ))
                    })
            })
            .collect();
        if self.runs == 0 {
            return Err(Usage("--runs: expected at least 1".into()).into());
        }
        if self.seed.checked_add(self.runs - 1).is_none() {
            return Err(Usage(format!(
                "--seed {} --runs {}: the last seed is above {}, the largest there is",
                self.seed,
                self.runs,
                u64::MAX
            ))
            .into());
        }
        let mut overrides = self.set.clone();
        overrides.push(format!("run.phantom={}", quoted(&self.phantom)));
        overrides.push(format!("run.law={}", quoted(&self.law)));
        overrides.extend(
            self.sensor
                .as_ref()
                .map(|s| format!("run.sensor={}", quoted(s))),
        );
        let plan = Plan {
            experiments: experiments?,
            law: self.law.clone(),
            first_seed: self.seed,
            runs: self.runs,
            brackets: self.brackets,
            base: config::load(None, &overrides)?,
        };
        let unattended = plan.base.check_unattended();
        unattended.map_err(|e| Usage(format!("key `{}`: {}", e.key, e.problem)))?;
        self.check_heeded(&plan)?;
        Ok(plan)
    }

    /// Refuses a `--set` that an experiment would not heed.
    fn check_heeded(&self, plan: &Plan) -> anyhow::Result<()> {
        let given = toml::Value::try_from(config::load(None, &self.set)?)?;
        for argument in &self.set {
            let key = argument.split('=').next().unwrap_or_default().trim();
            for experiment in &plan.experiments {
                // A seed of its own: every run has another.
                let run = toml::Value::try_from(plan.config(experiment, 0))?;
                let (wanted, taken) = (value_at(&given, key), value_at(&run, key));
                if key == "run.seed" || wanted != taken {
                    return Err(Usage(format!(
                        "--set {argument}: {} sets {key} itself{}",
                        experiment.name,
                        instead_of(key)
                    ))
                    .into());
                }
            }
        }
        Ok(())
    }
}

fn value_at<'a>(config: &'a toml::Value, key: &str) -> Option<&'a toml::Value> {
    key.split('.')
        .try_fold(config, |table, part| table.get(part.trim()))
}

/// Why a key is not heeded, and what is.
fn instead_of(key: &str) -> &'static str {
    match key {
        "run.seed" => "; --seed gives the first one",
        "run.law" => "; --law names the law of e2 and e4",
        "run.phantom" => "; use --phantom",
        "run.sensor" => "; use --sensor",
        "run.check_reach" => ": a target out of reach is measured all the same",
        _ if key.starts_with("target") => {
            ": where the paper has its targets; `run` and `campaign` take others"
        }
        _ => "",
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
