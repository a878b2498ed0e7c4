//! Reports: one HTML page that shows a run, a campaign or the paper's experiments, and needs no
//! network. The charts are plotly's; its script stands once in each page.

mod course;
mod scene;
mod story;
mod charts;
mod cameras;
mod page;
mod distributions;
mod validation;

use std::path::{Path, PathBuf};

use rosbridge::log::ReadError;

use crate::campaign::{LedgerError, PlanError};
use crate::config::ConfigError;
use crate::replay;

pub use page::Page;
pub use validation::validation;

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The log.
    #[error(transparent)]
    Log(#[from] ReadError),
    /// The log's configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The log without a step.
    #[error("{}: the log has no step", file.display())]
    Empty {
        /// The log.
        file: PathBuf,
    },
    /// The file or folder cannot be read.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The folder is of no run, campaign or experiments.
    #[error(
        "{}: no results in it: neither run.mcap (of run), campaign.toml (of campaign) nor \
         reproduce.json (of reproduce)",
        folder.display()
    )]
    NoResults {
        /// The folder.
        folder: PathBuf,
    },
    /// The file holds no results of `reproduce`.
    #[error("{}: no results of `reproduce`: {source}", file.display())]
    Results {
        /// The file.
        file: PathBuf,
        /// Why.
        source: serde_json::Error,
    },
    /// The campaign's file.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The campaign's ledgers.
    #[error(transparent)]
    Ledger(#[from] LedgerError),
    /// A line of the campaign's table.
    #[error(transparent)]
    Row(#[from] csv::Error),
}

/// The report of a campaign's folder, of the JSON of `reproduce`, or of a run's log.
///
/// # Errors
/// See [`ReportError`].
pub fn report(of: &Path) -> Result<Page, ReportError> {
    if of.is_dir() {
        let holds = |name: &str| Some(of.join(name)).filter(|file| file.exists());
        return if let Some(log) = holds("run.mcap") {
            run(&log)
        } else if let Some(results) = holds("reproduce.json") {
            distributions::experiments(&results)
        } else if holds("campaign.toml").is_some() {
            distributions::campaign(of)
        } else {
            Err(ReportError::NoResults {
                folder: of.to_owned(),
            })
        };
    }
    if of.extension().is_some_and(|e| e == "json") {
        distributions::experiments(of)
    } else {
        run(of)
    }
}

/// The report of one run.
///
/// # Errors
/// See [`ReportError`].
pub fn run(file: &Path) -> Result<Page, ReportError> {
    let course = course::Course::read(file)?;
    let mut page = Page::new(&course.title());
    page.table(&course.facts());
    page.heading("The needle in the tissue");
    page.text(
        "Relative to the entry point; across the needle the scale is enlarged. Drag to turn, \
         press play or move the slider.",
    );
    page.plot("scene", 700, &scene::plot(&course));
    page.heading("What was decided, and why");
    page.table(&story::story(&course));
    page.heading("The course of the run");
    for (k, (chart, words)) in charts::all(&course).iter().enumerate() {
        page.explained(&format!("chart{k}"), 330, chart, words);
    }
    // A log that cannot be replayed has no times of its steps; the rest is shown all the same.
    let times = replay::step_times(file).unwrap_or_default();
    page.plot("ages", 330, &charts::ages(&course));
    if !times.is_empty() {
        page.plot("times", 330, &charts::times(&times));
    }
    if !course.pairs.is_empty() {
        page.heading("What the cameras saw");
        page.html(&cameras::views(&course));
    }
    page.heading("Configuration");
    page.folded("the complete configuration of the run", &course.info.config);
    Ok(page)
}
