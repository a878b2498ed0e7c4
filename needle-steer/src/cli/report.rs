//! `report`: one HTML page.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use super::unusable;
use crate::report::report;
use crate::results::{check_is_page, save_page};

/// One HTML page of a run, a campaign or the paper's experiments; needs no network.
#[derive(Debug, Args)]
pub(super) struct ReportArgs {
    /// Log of a run (MCAP) or its folder, folder of a campaign, or JSON of `reproduce`.
    file: PathBuf,
    /// The page; beside the log by default.
    #[arg(short, long, value_name = "HTML")]
    output: Option<PathBuf>,
}

pub(super) fn execute(args: &ReportArgs) -> anyhow::Result<ExitCode> {
    let output = args.output.clone().unwrap_or_else(|| {
        if args.file.is_dir() {
            args.file.join("report.html")
        } else {
            args.file.with_extension("html")
        }
    });
    check_is_page(&output)?;
    let page = report(&args.file).map_err(|e| unusable(&args.file, e))?;
    save_page(&output, &page.render())?;
    writeln!(std::io::stdout(), "{}", output.display())?;
    Ok(ExitCode::SUCCESS)
}
