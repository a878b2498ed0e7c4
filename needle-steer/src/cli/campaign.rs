//! `campaign`: many runs, resumable, in shards.

use std::fmt::Write as _;
use std::io::Write;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;

use anyhow::Context;
use clap::{Args, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};

use super::run::interrupt_flag;
use super::{Usage, print_json};
use crate::campaign::compare::conclude;
use crate::campaign::execute::{self, Shard};
use crate::campaign::ledger::{collect, collect_counted, ledger_of};
use crate::campaign::table::table;
use crate::campaign::{Conclusions, Failure, Ledger, Plan, Row};
use crate::clock::WallTime;
use crate::results::replace;

/// Monte-Carlo over laws, phantoms, targets and seeds; goes on where it was stopped.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(super) struct CampaignArgs {
    #[command(subcommand)]
    command: Option<CampaignCommand>,
    /// Campaign file (TOML).
    #[arg(required = true)]
    file: Option<PathBuf>,
    /// Only the K-th of N parts, for job arrays.
    #[arg(long, value_name = "K/N")]
    shard: Option<Shard>,
    /// Threads; all cores by default.
    #[arg(long)]
    jobs: Option<NonZeroUsize>,
    /// Folder for the results; made if missing.
    #[arg(long, required = true)]
    out: Option<PathBuf>,
    /// Print the conclusions as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum CampaignCommand {
    /// One table from the folders of several shards.
    Merge {
        /// Folders of the shards.
        #[arg(required = true)]
        folders: Vec<PathBuf>,
        /// Folder for the table; the first of the shards' by default.
        #[arg(long)]
        out: Option<PathBuf>,
        /// Print the conclusions as JSON.
        #[arg(long)]
        json: bool,
    },
}

/// Copy of the campaign's file beside its results.
const COPY: &str = "campaign.toml";

pub(super) fn execute(args: &CampaignArgs) -> anyhow::Result<ExitCode> {
    if let Some(CampaignCommand::Merge { folders, out, json }) = &args.command {
        return merge(folders, out.as_deref(), *json);
    }
    let (Some(file), Some(out)) = (&args.file, &args.out) else {
        return Err(Usage("campaign: FILE and --out are needed".into()).into());
    };
    let plan = Plan::load(file).map_err(|e| Usage(e.to_string()))?;
    let shard = args.shard.unwrap_or(Shard::WHOLE);
    let (ledger, done) = Ledger::open(out, &plan, shard)?;
    let text = std::fs::read(file).with_context(|| file.display().to_string())?;
    replace(&out.join(COPY), &text)?;
    let controls = interrupt_flag()?;
    let jobs = args
        .jobs
        .or_else(|| std::thread::available_parallelism().ok())
        .map_or(1, NonZeroUsize::get);
    let pending = execute::pending(&plan, shard, &done);
    let progress = Progress::new(done.len() as u64, pending.len() as u64);
    let result = execute::execute(&plan, &pending, ledger, jobs, &controls, || progress.step());
    progress.bar.finish_and_clear();
    // Also after a failure: what is finished is worth a table.
    let concluded = conclude_folder(std::slice::from_ref(out), &plan, out, args.json);
    result.map_err(|error| match error {
        Failure::Interrupted => anyhow::Error::from(error),
        Failure::Ledger(error) => anyhow::Error::from(error).context("campaign stopped"),
    })?;
    let found = concluded?;
    Ok(if found.failed == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(1)
    })
}

fn merge(folders: &[PathBuf], out: Option<&Path>, json: bool) -> anyhow::Result<ExitCode> {
    let Some(first) = folders.first() else {
        return Err(Usage("campaign merge: expected a folder".into()).into());
    };
    let plan = Plan::load(&first.join(COPY)).map_err(|e| Usage(e.to_string()))?;
    let out = out.unwrap_or(first);
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let twice = collect_counted(folders, &plan)?.1;
    if twice > 0 {
        writeln!(
            std::io::stderr(),
            "note: {twice} runs were given twice (a folder named twice, or shards that overlap); each counts once"
        )?;
    }
    let found = conclude_folder(folders, &plan, out, json)?;
    if !folders.iter().any(|folder| folder == out) {
        // A folder like that of a whole campaign: it can be reported and gone on with.
        let text = std::fs::read(first.join(COPY)).with_context(|| first.display().to_string())?;
        replace(&out.join(COPY), &text)?;
        replace(
            &out.join(Shard::WHOLE.ledger()),
            ledger_of(&plan, &collect(folders, &plan)?).as_bytes(),
        )?;
    }
    if found.finished < found.runs {
        anyhow::bail!(
            "{} of {} runs are missing",
            found.runs - found.finished,
            found.runs
        );
    }
    Ok(if found.failed == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(1)
    })
}

/// Writes the table and the conclusions of all ledgers in `folders` to `out`.
fn conclude_folder(
    folders: &[PathBuf],
    plan: &Plan,
    out: &Path,
    json: bool,
) -> anyhow::Result<Conclusions> {
    let lines = collect(folders, plan)?;
    let table = table(lines.values().map(String::as_str));
    let rows: Result<Vec<Row>, _> = lines.values().map(|line| Row::parse(line)).collect();
    let rows = rows?;
    let found = conclude(plan, &rows);
    // Printed first: a full disk takes nothing away.
    let printed = if json {
        print_json(&found)
    } else {
        print_text(&found, out)
    };
    let mut text = serde_json::to_vec_pretty(&found)?;
    text.push(b'\n');
    replace(&out.join("results.csv"), table.as_bytes())?;
    replace(&out.join("conclusions.json"), &text)?;
    printed?;
    Ok(found)
}

/// A bar on a terminal, a line now and then elsewhere; both with the time left.
struct Progress {
    bar: ProgressBar,
    runs: u64,
    finished: Mutex<u64>,
    clock: WallTime,
}

impl Progress {
    fn new(done: u64, runs: u64) -> Self {
        let bar = ProgressBar::new(runs);
        bar.set_style(
            ProgressStyle::with_template("{bar:30} {pos}/{len} runs, {eta} left {msg}")
                .unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        if done > 0 {
            let text = format!("({done} were finished before)");
            if bar.is_hidden() {
                let _ = writeln!(std::io::stderr(), "{runs} runs to go {text}");
            }
            bar.set_message(text);
        }
        Self {
            bar,
            runs,
            finished: Mutex::new(0),
            clock: WallTime::start(),
        }
    }

    fn step(&self) {
        self.bar.inc(1);
        let mut finished = self
            .finished
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        *finished += 1;
        let every = (self.runs / 20).max(1);
        if self.bar.is_hidden() && (*finished).is_multiple_of(every) {
            let left =
                self.clock.now().as_secs() / *finished as f64 * (self.runs - *finished) as f64;
            let _ = writeln!(
                std::io::stderr(),
                "{finished}/{} runs, {:.0} min {:02.0} s left",
                self.runs,
                (left / 60.0).floor(),
                left % 60.0
            );
        }
    }
}

fn print_text(found: &Conclusions, out: &Path) -> anyhow::Result<()> {
    let mut text = String::new();
    writeln!(
        text,
        "{} of {} runs, {} could not be carried out",
        found.finished, found.runs, found.failed
    )?;
    writeln!(
        text,
        "{:<15} {:<16} {:<32} {:>9} {:>8} {:>17} {:>8} {:>13}",
        "law", "phantom", "target", "median mm", "95 %", "median's interval", "hits", "hit rate"
    )?;
    let range = |r: Option<[f64; 2]>| {
        r.map_or_else(
            || "-".into(),
            |[low, high]| format!("{low:.3} to {high:.3}"),
        )
    };
    for c in &found.cells {
        writeln!(
            text,
            "{:<15} {:<16} {:<32} {:>9.3} {:>8.3} {:>17} {:>8} {:>13}",
            c.law,
            c.phantom,
            c.target,
            c.median_mm,
            c.p95_mm,
            range(c.median_interval_mm),
            format!("{}/{}", c.hits, c.runs),
            format!(
                "{:.2} to {:.2}",
                c.hit_rate_interval[0], c.hit_rate_interval[1]
            ),
        )?;
    }
    for p in &found.pairs {
        writeln!(
            text,
            "{} - {} ({}, {}): median {:+.3} mm [{}], better {} worse {}, p = {:.2e}",
            p.law,
            p.reference,
            p.phantom,
            p.target,
            p.median_difference_mm,
            range(p.interval_mm),
            p.better,
            p.worse,
            p.p_value
        )?;
    }
    writeln!(text, "table: {}", out.join("results.csv").display())?;
    std::io::stdout().write_all(text.as_bytes())?;
    Ok(())
}
