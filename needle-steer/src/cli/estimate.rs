//! `estimate`: one's own needle from recorded insertions.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;

use super::{Usage, print_json};
use crate::config::{self, Config};
use crate::identify::{Findings, Identified, Interval, Parameter, Recording, TipIdentified};
use crate::results::{check_free, save};

/// Stiffness, tip load and natural curvature of one's own needle from recorded insertions.
#[derive(Debug, Args)]
pub(super) struct EstimateArgs {
    /// Logs of runs (MCAP), or CSV files of base poses and what was seen of the needle.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Needle and entry for CSV files; the written configuration starts from it.
    #[arg(long)]
    config: Option<PathBuf>,
    /// Configuration to write; `run` takes it.
    #[arg(long, value_name = "CONFIG")]
    out: Option<PathBuf>,
    /// Print the findings as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &EstimateArgs) -> anyhow::Result<ExitCode> {
    if let Some(out) = &args.out {
        check_free(out)?;
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
    let found = Findings::of(&recordings).map_err(|e| Usage(e.to_string()))?;
    let printed = match &found {
        _ if args.json => print_json(&found),
        Findings::Needle(found) => print_text(found).map_err(anyhow::Error::from),
        Findings::Tip(found) => print_tip(found).map_err(anyhow::Error::from),
    };
    if let Some(out) = &args.out {
        let applied = found.apply(&given, args.config.is_some(), &recordings);
        write_config(out, &applied, found.counts())?;
        if !args.json {
            writeln!(std::io::stdout(), "configuration: {}", out.display())?;
        }
    }
    printed?;
    Ok(ExitCode::SUCCESS)
}

fn write_config(out: &Path, config: &Config, of: (usize, usize)) -> anyhow::Result<()> {
    let text = format!(
        "# Identified from {} insertions, {} measurements.\n{}",
        of.0,
        of.1,
        toml::to_string(config)?
    );
    save(out, |file| Ok(file.write_all(text.as_bytes())?))
}

fn print_tip(found: &TipIdentified) -> std::io::Result<()> {
    let mut to = std::io::stdout().lock();
    let stiffness = found.stiffness_n_m2.as_ref().map(|k| Interval {
        value: k.value,
        low: k.low,
        high: k.high,
    });
    let rows: [(&str, Option<Interval>, usize); 4] = [
        ("wave length [mm]", found.wave_length_mm, 1),
        ("stiffness K_T [N/m2]", stiffness, 0),
        ("guide to tissue [mm]", found.guide_gap_mm, 1),
        ("sensor behind tip [mm]", Some(found.sensor_setback_mm), 1),
    ];
    for (name, value, digits) in rows {
        match value {
            Some(v) => writeln!(
                to,
                "{name:<24} {:>9.digits$}   95 %: {:.digits$} to {:.digits$}",
                v.value, v.low, v.high
            )?,
            None => writeln!(to, "{name:<24}         -")?,
        }
    }
    for reason in &found.not_identified {
        writeln!(to, "NOT IDENTIFIED: {reason}")?;
    }
    for part in &found.left_out {
        writeln!(
            to,
            "left out: {}, {} rows from row {}: {}",
            part.file, part.rows, part.from_row, part.reason
        )?;
    }
    let (recordings, measurements) = (found.recordings, found.measurements);
    writeln!(
        to,
        "from {recordings} insertions, {measurements} measurements"
    )
}

fn print_text(found: &Identified) -> std::io::Result<()> {
    let mut to = std::io::stdout().lock();
    let rows: [(&str, &Parameter, usize); 4] = [
        ("stiffness K_T [N/m2]", &found.stiffness_n_m2, 0),
        ("cut angle [deg]", &found.cut_angle_deg, 3),
        ("natural curvature [1/m]", &found.natural_curvature_per_m, 3),
        ("tip-load scale", &found.tip_load_scale, 2),
    ];
    for (name, p, digits) in rows {
        write!(
            to,
            "{name:<24} {:>9.digits$}   95 %: {:.digits$} to {:.digits$}",
            p.value, p.interval[0], p.interval[1]
        )?;
        match &p.reason {
            None => writeln!(to)?,
            Some(reason) => writeln!(to, "   NOT IDENTIFIED: {reason}")?,
        }
    }
    writeln!(
        to,
        "from {} insertions, {} measurements",
        found.recordings, found.measurements
    )
}
