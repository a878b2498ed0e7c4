//! `shape`: the equilibrium of the needle model for a given state.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use super::{Usage, print_json};
use crate::shape::solve;

/// Equilibrium of the needle model for a given state, as JSON.
#[derive(Debug, Args)]
pub(super) struct ShapeArgs {
    /// The state (JSON): needle, base pose, tip load, springs.
    case: PathBuf,
}

pub(super) fn shape(args: &ShapeArgs) -> anyhow::Result<ExitCode> {
    let file = args.case.display();
    let text = std::fs::read_to_string(&args.case)
        .map_err(|e| Usage(format!("{file}: cannot be read: {e}")))?;
    let solved = solve(&text).map_err(|e| Usage(format!("{file}: {e}")))?;
    print_json(&solved)?;
    Ok(ExitCode::SUCCESS)
}
