//! `reproduce`: the paper's four experiments.

use std::io::Write;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use indicatif::ProgressBar;
use serde::Serialize;

use super::run::interrupt_flag;
use super::{Usage, print_json};
use crate::config;
use crate::controls::Controls;
use crate::experiments::{Column, EXPERIMENTS, Experiment, ExperimentResult, Plan, reproduce};
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
    #[arg(long, default_value_t = 1)]
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

#[derive(Serialize)]
struct Document<'a> {
    experiments: &'a [ExperimentResult],
}

/// Why a plan could not be carried out.
#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error(transparent)]
    Run(#[from] RunError),
    #[error("phantom: {0}")]
    Phantom(#[from] phantom::SettingsError),
    #[error("interrupted")]
    Interrupted,
}

pub(super) fn execute(args: &ReproduceArgs) -> anyhow::Result<ExitCode> {
    let plan = args.plan()?;
    let interrupt = interrupt_flag()?;
    let jobs = args
        .jobs
        .or_else(|| std::thread::available_parallelism().ok())
        .map_or(1, NonZeroUsize::get);
    let cells: usize = plan
        .experiments
        .iter()
        .map(|e| {
            if plan.brackets {
                Column::of(e).len()
            } else {
                1
            }
        })
        .sum();
    let progress = ProgressBar::new(args.runs * cells as u64);
    let results = reproduce(
        &plan,
        jobs,
        |config| one(config, &interrupt),
        || progress.inc(1),
    )?;
    progress.finish_and_clear();
    let document = Document {
        experiments: &results,
    };
    if let Some(out) = &args.out {
        std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
        let mut json = serde_json::to_vec_pretty(&document)?;
        json.push(b'\n');
        let file = out.join("reproduce.json");
        std::fs::write(&file, json).with_context(|| file.display().to_string())?;
    }
    if args.json {
        print_json(&document)?;
    } else {
        print_table(&results)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn one(config: &config::Config, interrupt: &Controls) -> Result<crate::outcome::Summary, Failure> {
    if interrupt.is_interrupted() {
        return Err(Failure::Interrupted);
    }
    let mut rig = Rig::new(config).map_err(RunError::from)?;
    Ok(run(config, &mut rig, &mut Unobserved, interrupt)?)
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
        let mut overrides = self.set.clone();
        overrides.push(format!(
            "run.phantom={}",
            toml::Value::String(self.phantom.clone())
        ));
        overrides.push(format!("run.law={}", toml::Value::String(self.law.clone())));
        overrides.extend(
            self.sensor
                .as_ref()
                .map(|s| format!("run.sensor={}", toml::Value::String(s.clone()))),
        );
        Ok(Plan {
            experiments: experiments?,
            law: self.law.clone(),
            first_seed: self.seed,
            runs: self.runs,
            brackets: self.brackets,
            base: config::load(None, &overrides)?,
        })
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
