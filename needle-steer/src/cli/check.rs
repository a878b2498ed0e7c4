//! `check`: a configuration, and whether its arm can carry out the insertion.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use robots::kinematics::Chain;

use super::Usage;
use crate::config::{self, Config};
use crate::rig::{self, Course, Demand};
use crate::strut::Strut;

/// Check a configuration, and whether its arm can carry out the insertion.
#[derive(Debug, Args)]
pub(super) struct CheckArgs {
    /// Configuration file (TOML); without it, the defaults.
    config: Option<PathBuf>,
    /// Change one key of the configuration: key=value, the value in TOML.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Look for a place for the arm's base from which it can insert, and print its keys.
    #[arg(long)]
    suggest: bool,
}

pub(super) fn execute(args: &CheckArgs) -> anyhow::Result<ExitCode> {
    let config = config::load(args.config.as_deref(), &args.set)?;
    super::tell_doubts(&config);
    let chain = rig::chain(&config).map_err(|e| Usage(e.to_string()))?;
    let mut out = std::io::stdout().lock();
    if args.suggest {
        rig::check_arm(&config, &chain).map_err(|e| Usage(e.to_string()))?;
        return suggest(&config, &chain, args.config.as_deref(), &mut out);
    }
    let start =
        rig::start(&config, &chain, &rig::arm_place(&config)).map_err(|e| Usage(e.to_string()))?;
    let name = args.config.as_ref().map(|file| file.display().to_string());
    writeln!(out, "{}: valid", name.as_deref().unwrap_or("defaults"))?;
    writeln!(out, "arm: {}", margins(&config, &chain, &start.course))?;
    if chain.len() < 6 {
        let length = config.needle.length_mm * 1e-3;
        writeln!(
            out,
            "device: {}",
            rig::abilities(&chain, &start.joints, length)
        )?;
    }
    if let Some(problem) = Strut::of(&config).and_then(|strut| strut.problem()) {
        out.flush()?;
        anyhow::bail!(problem);
    }
    Ok(ExitCode::SUCCESS)
}

/// What the insertion leaves the arm, in words.
pub(super) fn margins(config: &Config, chain: &Chain, course: &Course) -> String {
    let depth = Demand::of(config).depth * 1e3;
    if course.room.is_infinite() {
        return format!("a straight insertion of {depth:.0} mm fits");
    }
    let (joint, kind) = (&chain.names()[course.joint], chain.kinds()[course.joint]);
    let room = kind.in_words(course.room * kind.unit());
    format!("a straight insertion of {depth:.0} mm fits; {joint} comes within {room} of its end")
}

fn suggest(
    config: &Config,
    chain: &Chain,
    file: Option<&Path>,
    out: &mut impl Write,
) -> anyhow::Result<ExitCode> {
    let Some(place) = rig::suggest(config, chain) else {
        anyhow::bail!(
            "no place for the arm's base was found from which it can carry out this insertion; a \
             shallower target or one less far aside (target.depth_mm, target.offset_mm), or \
             another tissue.inward, asks less of it"
        );
    };
    let mut arm = file.map_or_else(|| Ok(toml::Table::new()), arm_of)?;
    writeln!(out, "# {}", margins(config, chain, &place.course))?;
    if let Some(file) = file {
        let file = file.display();
        if arm.is_empty() {
            writeln!(out, "# a table for {file}:")?;
        } else {
            writeln!(out, "# in the place of the table [arm] of {file}:")?;
        }
    }
    arm.insert("base_mm".into(), place.base_mm.to_vec().into());
    arm.insert("base_rpy_deg".into(), place.base_rpy_deg.to_vec().into());
    let whole = toml::Table::from_iter([("arm".to_owned(), arm.into())]);
    write!(out, "{}", toml::to_string(&whole)?)?;
    Ok(ExitCode::SUCCESS)
}

/// The table `[arm]` of a configuration that was read before.
fn arm_of(file: &Path) -> anyhow::Result<toml::Table> {
    let mut given: toml::Table = std::fs::read_to_string(file)?.parse()?;
    Ok(match given.remove("arm") {
        Some(toml::Value::Table(arm)) => arm,
        _ => toml::Table::new(),
    })
}
