//! `validate`: predictions of recorded steps against what was measured.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use super::{Usage, print_json};
use crate::config;
use crate::identify::{Recording, Validation, validate};
use crate::report;
use crate::results::{check_is_page, save_page};

/// Predictions of recorded steps against what was measured.
#[derive(Debug, Args)]
pub(super) struct ValidateArgs {
    /// Tables of recordings, or logs of runs.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Needle, tissue and entry, as `estimate --out` writes them.
    #[arg(long)]
    config: Option<PathBuf>,
    /// A page with the curves.
    #[arg(long, value_name = "HTML")]
    html: Option<PathBuf>,
    /// Print the findings as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &ValidateArgs) -> anyhow::Result<ExitCode> {
    if let Some(page) = &args.html {
        check_is_page(page)?;
    }
    let given = config::load(args.config.as_deref(), &[])?;
    let recordings: Vec<Recording> = args
        .files
        .iter()
        .map(|file| {
            Recording::read(file, &given)
                .map_err(|e| Usage(format!("{:#}", anyhow::Error::from(e))))
        })
        .collect::<Result<_, _>>()?;
    let found = validate(&recordings, &given).map_err(|e| Usage(e.to_string()))?;
    if let Some(page) = &args.html {
        save_page(page, &report::validation(&found).render())?;
    }
    if args.json {
        print_json(&found)?;
    } else {
        print_text(&found, args.html.as_ref())?;
    }
    Ok(ExitCode::SUCCESS)
}

fn print_text(found: &Validation, page: Option<&PathBuf>) -> std::io::Result<()> {
    let mut to = std::io::stdout().lock();
    let (axis, tip) = (&found.axis, &found.tip);
    writeln!(to, "{} changes (steps times two axes)", found.changes)?;
    writeln!(
        to,
        "axis   measured {:.1} mrad, unexplained {:.1} mrad, R2 {:.3}, slope {:.3}",
        axis.rms_mrad, axis.unexplained_mrad, axis.r2, axis.slope
    )?;
    writeln!(
        to,
        "tip    model {:.3} mm, stays {:.3} mm, straight {:.3} mm, Broyden {:.3} mm",
        tip.rms_mm, tip.persistence_mm, tip.straight_mm, tip.broyden_mm
    )?;
    for part in &found.left_out {
        writeln!(
            to,
            "left out: {}, {} rows from row {}: {}",
            part.file, part.rows, part.from_row, part.reason
        )?;
    }
    if let Some(page) = page {
        writeln!(to, "page   {}", page.display())?;
    }
    Ok(())
}
