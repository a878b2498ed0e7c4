//! `report`: one HTML page.

use std::io::Write;
use std::path::{Path, PathBuf};
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
    /// Show the page in the browser.
    #[arg(long)]
    open: bool,
}

pub(super) fn execute(args: &ReportArgs) -> anyhow::Result<ExitCode> {
    let output = args.output.clone().unwrap_or_else(|| {
        if args.file.is_dir() {
            args.file.join("report.html")
        } else {
            args.file.with_extension("html")
        }
    });
    write(&args.file, &output)?;
    writeln!(std::io::stdout(), "{}", output.display())?;
    if args.open {
        show(&output)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn write(of: &Path, page: &Path) -> anyhow::Result<()> {
    check_is_page(page)?;
    let written = report(of).map_err(|e| unusable(of, e))?;
    save_page(page, &written.render())
}

/// Writes the page of a run into its folder and shows it.
pub(super) fn write_and_show(folder: &Path) -> anyhow::Result<()> {
    let page = folder.join("report.html");
    write(folder, &page)?;
    Ok(show(&page)?)
}

/// Shows a page in the browser; where there is none that is said, and the page is there all the same.
fn show(page: &Path) -> std::io::Result<()> {
    let place = page.canonicalize()?;
    if let Err(error) = open::that_detached(&place) {
        let place = place.display();
        writeln!(
            std::io::stderr(),
            "{place}: no browser was found to show it ({error}); open it by hand"
        )?;
    }
    Ok(())
}
