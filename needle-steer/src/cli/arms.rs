//! `arms`: which arms of a folder of URDFs can carry out the default insertion.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use robots::kinematics::{Chain, JointKind, Section, arm_sections};

use super::Usage;
use crate::config::Config;
use crate::rig::{self, Misfit};

/// Speed of the joints for which a URDF gives none \[deg/s\].
const SPEED_DEG_S: f64 = 90.0;
/// Folders within folders that are looked into.
const DEPTH: usize = 6;

/// Which arms of a folder of URDFs can carry out the default insertion: a Markdown table.
#[derive(Debug, Args)]
pub(super) struct ArmsArgs {
    /// URDF files, or folders of them.
    #[arg(required = true)]
    paths: Vec<PathBuf>,
}

pub(super) fn execute(args: &ArmsArgs) -> anyhow::Result<ExitCode> {
    let mut files = Vec::new();
    for path in &args.paths {
        collect(path, DEPTH, &mut files)?;
    }
    files.sort();
    let mut out = std::io::stdout().lock();
    writeln!(out, "| arm | chain | joints | settings | verdict |")?;
    writeln!(out, "|---|---|---|---|---|")?;
    for file in &files {
        let name = file.file_stem().unwrap_or_default().to_string_lossy();
        writeln!(out, "| {name} | {} |", row(file).join(" | "))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The URDFs at `path` and below.
fn collect(path: &Path, depth: usize, files: &mut Vec<PathBuf>) -> Result<(), Usage> {
    let unreadable = |e: std::io::Error| Usage(format!("{}: cannot be read: {e}", path.display()));
    if !std::fs::metadata(path).map_err(unreadable)?.is_dir() {
        files.push(path.to_owned());
        return Ok(());
    }
    if depth == 0 {
        return Ok(());
    }
    for entry in std::fs::read_dir(path).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?.path();
        let is_urdf = entry.extension().is_some_and(|suffix| suffix == "urdf");
        if is_urdf || entry.is_dir() {
            collect(&entry, depth - 1, files)?;
        }
    }
    Ok(())
}

/// Chain, joints, settings and verdict.
fn row(file: &Path) -> [String; 4] {
    let none = String::new;
    let bytes = match std::fs::read(file) {
        Ok(bytes) => bytes,
        Err(error) => return [none(), none(), none(), error.to_string()],
    };
    let sections = match arm_sections(&bytes) {
        Ok(sections) => sections,
        Err(error) => return [none(), none(), none(), error.to_string()],
    };
    let Some((base, tip)) = sections.first() else {
        let verdict = "no chain of six or seven turning joints".to_owned();
        return [none(), none(), none(), verdict];
    };
    let section = Section::arm(tip).from(base);
    let ends = format!("{base} to {tip}");
    match Chain::from_section(&bytes, &section) {
        Err(error) => [ends, none(), none(), error.to_string()],
        Ok(chain) => {
            let (settings, verdict) = verdict(&chain);
            [ends, joints(&chain), settings, verdict]
        }
    }
}

fn joints(chain: &Chain) -> String {
    let endless = chain.kinds().iter();
    let endless = endless.filter(|kind| **kind == JointKind::Continuous);
    match endless.count() {
        0 => chain.len().to_string(),
        some => format!("{}, {some} without ends", chain.len()),
    }
}

/// What has to be set, and whether the default insertion is possible with that.
fn verdict(chain: &Chain) -> (String, String) {
    let config = Config::default();
    let mut settings = Vec::new();
    let mut chain = chain.clone();
    if chain.without_speed().next().is_some() {
        settings.push(format!("`joint_speed_deg_s = {SPEED_DEG_S}`"));
        chain = chain.with_speed(SPEED_DEG_S.to_radians());
    }
    if let Err(Misfit::OffAxis { remedy, .. }) = rig::check_chain(&chain)
        && let Some(tool) = chain.tool_on_last_axis()
    {
        settings.push(remedy);
        chain = chain.with_tool(&tool);
    }
    if let Err(misfit) = rig::check_chain(&chain) {
        return (settings.join(", "), misfit.to_string());
    }
    let verdict = match rig::start(&config, &chain, &rig::arm_place(&config)) {
        Ok(start) => super::check::margins(&config, &chain, &start.course),
        Err(_) => match rig::suggest(&config, &chain) {
            Some(place) => {
                settings.push(format!("`base_mm = {:?}`", place.base_mm));
                let [_, _, yaw] = place.base_rpy_deg;
                if yaw != 0.0 {
                    settings.push(format!("`base_rpy_deg = {:?}`", place.base_rpy_deg));
                }
                super::check::margins(&config, &chain, &place.course)
            }
            None => "no place to stand was found".to_owned(),
        },
    };
    (settings.join(", "), verdict)
}
