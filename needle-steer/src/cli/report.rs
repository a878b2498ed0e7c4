//! `report`: one HTML page.

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;

use super::results::replace;
use super::{Usage, unusable};
use crate::report::report;

/// Bytes of a file that tell whether it is a page.
const START: u64 = 64;

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
    replace(&output, page.render().as_bytes())?;
    writeln!(std::io::stdout(), "{}", output.display())?;
    Ok(ExitCode::SUCCESS)
}

/// A page takes the place of an older one only, never of a log or anything else.
fn check_is_page(output: &Path) -> anyhow::Result<()> {
    if !output.is_file() {
        return Ok(());
    }
    let mut start = Vec::new();
    File::open(output)?.take(START).read_to_end(&mut start)?;
    let start = String::from_utf8_lossy(&start).to_lowercase();
    if start.is_empty() || start.trim_start().starts_with("<!doctype html") {
        return Ok(());
    }
    let name = output.display();
    Err(Usage(format!("{name}: is no HTML page, and is not written over")).into())
}
