//! `replay` and `diff`: recorded runs against this build and against each other.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use super::{Usage, print_json, unusable};
use crate::diff::{RunDiff, diff};
use crate::replay::{ReplayReport, replay};

/// Recorded measurements through this build: the same commands, bit for bit?
#[derive(Debug, Args)]
pub(super) struct ReplayArgs {
    /// Log of a run (MCAP).
    file: PathBuf,
    /// Another law on the same measurements.
    #[arg(long)]
    law: Option<String>,
    /// Change one key of the recorded configuration: key=value, the value in TOML.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Print the findings as JSON.
    #[arg(long)]
    json: bool,
}

/// Where two recorded runs part.
#[derive(Debug, Args)]
pub(super) struct DiffArgs {
    /// Log of a run (MCAP).
    first: PathBuf,
    /// Log of another run.
    second: PathBuf,
    /// Print the findings as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &ReplayArgs) -> anyhow::Result<ExitCode> {
    let mut overrides = args.set.clone();
    overrides.extend(
        args.law
            .as_ref()
            .map(|law| format!("run.law={}", toml::Value::String(law.clone()))),
    );
    let report = replay(&args.file, &overrides).map_err(|e| unusable(&args.file, e))?;
    if report.steps == 0 {
        return Err(Usage(format!("{}: the log has no step", args.file.display())).into());
    }
    if args.json {
        print_json(&report)?;
    } else {
        print_replay(&report)?;
    }
    Ok(if report.differing == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(1)
    })
}

fn print_replay(report: &ReplayReport) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{} steps of law {}, recorded by {}: {} with other commands",
        report.steps, report.law, report.recorded_by, report.differing
    )?;
    if !report.complete {
        writeln!(out, "  the log breaks off: its run was killed")?;
    }
    if report.differing == 0 && report.differing_reports > 0 {
        writeln!(
            out,
            "  {} steps report something else beside the commands",
            report.differing_reports
        )?;
    }
    if let Some(first) = &report.first {
        writeln!(
            out,
            "  first at step {}, {:.3} s, {:.2} mm deep",
            first.step, first.time_s, first.depth_mm
        )?;
        writeln!(out, "    recorded {:?} rad/s", &first.recorded[..])?;
        writeln!(out, "    replayed {:?} rad/s", &first.replayed[..])?;
        writeln!(
            out,
            "  largest difference of a joint's rate {:.6} rad/s",
            report.largest_rate
        )?;
    }
    Ok(())
}

pub(super) fn execute_diff(args: &DiffArgs) -> anyhow::Result<ExitCode> {
    let found = diff(&args.first, &args.second).map_err(|e| {
        let file = e.file.clone();
        unusable(&file, e.source)
    })?;
    if args.json {
        print_json(&found)?;
    } else {
        print_diff(&found)?;
    }
    Ok(if found.is_same() {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(1)
    })
}

fn print_diff(found: &RunDiff) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    for key in &found.config {
        let value = |v: &Option<String>| v.clone().unwrap_or_else(|| "(missing)".into());
        writeln!(
            out,
            "{}: {} | {}",
            key.key,
            value(&key.first),
            value(&key.second)
        )?;
    }
    if found.versions[0] != found.versions[1] {
        writeln!(
            out,
            "version: {} | {}",
            found.versions[0], found.versions[1]
        )?;
    }
    writeln!(out, "steps: {} | {}", found.steps[0], found.steps[1])?;
    for (name, moment) in [
        ("measurements", found.measurements),
        ("commands", found.commands),
    ] {
        match moment {
            None => writeln!(out, "{name}: the same at every common step")?,
            Some(m) => writeln!(
                out,
                "{name}: part at step {}, {:.3} s, {:.2} mm deep",
                m.step, m.time_s, m.depth_mm
            )?,
        }
    }
    writeln!(
        out,
        "farthest apart at equal steps: base {:.3} mm, tip {:.3} mm",
        found.largest_base_distance_mm, found.largest_tip_distance_mm
    )?;
    let show = |name: &str| {
        let [a, b] = &found.results;
        let value = |r: &Option<serde_json::Value>| {
            r.as_ref()
                .and_then(|r| r.get(name))
                .map_or_else(|| "-".into(), ToString::to_string)
        };
        (value(a), value(b))
    };
    for name in ["ended", "true_error_mm", "measured_error_mm", "duration_s"] {
        let (a, b) = show(name);
        writeln!(out, "{name}: {a} | {b}")?;
    }
    Ok(())
}
