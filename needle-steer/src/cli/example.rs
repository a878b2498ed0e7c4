//! `example`: files to try other commands on.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Subcommand;

use super::Usage;
use crate::{config, samples, springs};

/// Files to try other commands on, made by simulation; prints these commands.
#[derive(Debug, Subcommand)]
pub(super) enum ExampleCommand {
    /// Chessboards, a film of an insertion and the cameras' calibration, for `calibrate` and `track`.
    Images {
        /// New folder.
        folder: PathBuf,
    },
    /// Recorded insertions as tables, for `estimate` and `validate`.
    Recordings {
        /// New folder.
        folder: PathBuf,
    },
    /// A needle in air in a run's electromagnetic field, for `calibrate distortion`.
    Distortion {
        /// New folder.
        folder: PathBuf,
        /// Configuration of the run; the built-in defaults without.
        config: Option<PathBuf>,
        /// Seed of the run: every seed has another field.
        #[arg(long, value_parser = super::seed)]
        seed: Option<u64>,
    },
}

/// Insertions that are recorded.
const RECORDINGS: u64 = 3;

pub(super) fn execute(command: &ExampleCommand) -> anyhow::Result<ExitCode> {
    let next = match command {
        ExampleCommand::Images { folder } => images(begun(folder)?)?,
        ExampleCommand::Recordings { folder } => recordings(begun(folder)?)?,
        ExampleCommand::Distortion {
            folder,
            config,
            seed,
        } => distortion(folder, config.as_deref(), *seed)?,
    };
    writeln!(std::io::stdout(), "{next}")?;
    Ok(ExitCode::SUCCESS)
}

/// The folder, made.
fn begun(folder: &Path) -> anyhow::Result<&Path> {
    let is_used = folder
        .read_dir()
        .is_ok_and(|mut entries| entries.next().is_some());
    if is_used {
        let problem = "is not empty, and nothing is written over; name another folder";
        return Err(Usage(format!("{}: {problem}", folder.display())).into());
    }
    std::fs::create_dir_all(folder).map_err(|e| Usage(format!("{}: {e}", folder.display())))?;
    Ok(folder)
}

fn images(folder: &Path) -> anyhow::Result<String> {
    let config = config::load(None, &[])?;
    samples::calibration(&config, folder)?;
    let square_mm = samples::boards(&config, &folder.join("boards"))? * 1e3;
    let pairs = samples::film(&config, &folder.join("film"))?;
    let bevel_mm = springs::bevel_length(&config) * 1e3;
    let boards = samples::BOARDS;
    let name = folder.display();
    Ok(format!(
        "{name}/boards: {boards} pairs of a chessboard\n\
         {name}/film: {pairs} pairs of an insertion, {name}/stereo.yml: their calibration\n\
         next:\n  \
         needle-steer calibrate stereo --left {name}/boards/left_*.png --right \
         {name}/boards/right_*.png --board 9x6 --square-mm {square_mm} --out {name}/calibration\n  \
         needle-steer track --left {name}/film/left_*.png --right {name}/film/right_*.png \
         --calibration {name}/stereo.yml --bevel-mm {bevel_mm:.2} --out {name}/tips.jsonl \
         --overlay {name}/overlay"
    ))
}

fn distortion(folder: &Path, file: Option<&Path>, seed: Option<u64>) -> anyhow::Result<String> {
    let seeds = seed.map(|seed| format!("run.seed={seed}"));
    let sets: Vec<String> = seeds.into_iter().collect();
    let config = config::load(file, &sets)?;
    let table = begun(folder)?.join("in_air.csv");
    let places = samples::in_air(&config, &table)?;
    let (name, seed) = (folder.display(), config.run.seed);
    let run = file.map_or(String::new(), |file| format!(" {}", file.display()));
    Ok(format!(
        "{name}/in_air.csv: {places} places in the field of seed {seed}\n\
         next:\n  \
         needle-steer calibrate distortion {name}/in_air.csv --exact --out {name}/map.toml\n  \
         needle-steer run{run} --sensor em --seed {seed} --set em.map={name}/map.toml"
    ))
}

fn recordings(folder: &Path) -> anyhow::Result<String> {
    let mut files = Vec::new();
    for seed in 1..=RECORDINGS {
        let sets = ["run.sensor=shape".to_owned(), format!("run.seed={seed}")];
        let config = config::load(None, &sets)?;
        let file = folder.join(format!("insertion_{seed}.csv"));
        samples::recording(&config, &file)?;
        files.push(file.display().to_string());
    }
    let name = folder.display();
    Ok(format!(
        "{name}: {RECORDINGS} insertions with the default needle and tissue\n\
         next:\n  \
         needle-steer estimate {} {} --out {name}/needle.toml\n  \
         needle-steer validate {} --config {name}/needle.toml",
        files[0], files[1], files[2]
    ))
}
