//! `export`: a recorded run for other programs.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, ValueEnum};

use super::{Usage, unusable};
use crate::export::{Format, export};

/// What a log becomes.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum To {
    /// A bag of ROS 1.
    Rosbag1,
    /// A bag of ROS 2: a folder with an MCAP file in CDR.
    Rosbag2,
    /// The time series, CSV.
    Csv,
    /// The time series, Parquet.
    Parquet,
}

/// A recorded run as a bag of ROS 1 or ROS 2, or as a table.
#[derive(Debug, Args)]
pub(super) struct ExportArgs {
    /// Log of a run (MCAP).
    file: PathBuf,
    /// What it becomes.
    #[arg(long, value_name = "FORMAT")]
    to: To,
    /// The new file, for rosbag2 the new folder; by default beside the log: run.bag, run_rosbag2,
    /// run.csv, run.parquet.
    #[arg(long)]
    out: Option<PathBuf>,
}

pub(super) fn execute(args: &ExportArgs) -> anyhow::Result<ExitCode> {
    let (format, ending) = match args.to {
        To::Rosbag1 => (Format::Rosbag1, ".bag"),
        To::Rosbag2 => (Format::Rosbag2, "_rosbag2"),
        To::Csv => (Format::Csv, ".csv"),
        To::Parquet => (Format::Parquet, ".parquet"),
    };
    let out = args.out.clone().unwrap_or_else(|| {
        let stem = args.file.file_stem().unwrap_or_default();
        let name = format!("{}{ending}", stem.to_string_lossy());
        args.file.with_file_name(name)
    });
    if out.exists() {
        let problem = "exists already; --out names another place";
        return Err(Usage(format!("{}: {problem}", out.display())).into());
    }
    let exported = export(&args.file, format, &out).map_err(|error| {
        // What was begun is no bag and no table.
        let _ = match format {
            Format::Rosbag2 => std::fs::remove_dir_all(&out),
            _ => std::fs::remove_file(&out),
        };
        unusable(&args.file, error)
    })?;
    let mut told = std::io::stderr().lock();
    if !exported.complete {
        writeln!(told, "the log breaks off; what it holds is exported")?;
    }
    if !exported.dated {
        writeln!(
            told,
            "the log does not say when it began: stamps count from its beginning"
        )?;
    }
    writeln!(
        told,
        "{}: {} {}",
        out.display(),
        exported.entries,
        exported.unit
    )?;
    Ok(ExitCode::SUCCESS)
}
