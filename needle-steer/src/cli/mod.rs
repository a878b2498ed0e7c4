//! The command line: human text on stderr, results on stdout, exit code 0 done, 1 failed run or
//! fault, 2 bad usage or configuration.

mod arm;
mod arms;
mod boards;
mod calibrate;
mod calibration;
mod campaign;
mod check;
mod dead_man;
mod emulate;
mod estimate;
mod example;
mod export;
mod faults;
mod images;
mod model;
mod plain;
mod relay;
mod replay;
mod report;
mod reproduce;
mod run;
mod served;
mod track;
mod validate;
mod way_out;
mod withdraw;

use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::config;
use crate::results::ResultsError;

/// Steers a flexible bevel-tip needle to a target.
#[derive(Debug, Parser)]
#[command(name = "needle-steer", version = crate::VERSION, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// One insertion to a target.
    Run(run::RunArgs),
    /// The needle out of the tissue, after an insertion that was stopped.
    Withdraw(withdraw::WithdrawArgs),
    /// The paper's four experiments over seeds: Table I beside the paper's values.
    Reproduce(reproduce::ReproduceArgs),
    /// Monte-Carlo over laws, phantoms, targets and seeds, resumable and in shards.
    Campaign(campaign::CampaignArgs),
    /// A recorded run's measurements through this build: the same commands, bit for bit?
    Replay(replay::ReplayArgs),
    /// Where two recorded runs part.
    Diff(replay::DiffArgs),
    /// A recorded run as a bag of ROS 1 or ROS 2, or as a table.
    Export(export::ExportArgs),
    /// One HTML page of a run, a campaign or the paper's experiments; needs no network.
    Report(report::ReportArgs),
    /// Stiffness, tip load and natural curvature of one's own needle from recorded insertions.
    Estimate(estimate::EstimateArgs),
    /// Predictions of recorded steps against what was measured.
    Validate(validate::ValidateArgs),
    /// Equilibrium of the needle model for a given state, as JSON.
    Shape(model::ShapeArgs),
    /// Camera calibration and registration.
    #[command(subcommand)]
    Calibrate(calibrate::CalibrateCommand),
    /// The needle in recorded pairs of images: a JSON line a frame.
    Track(track::TrackArgs),
    /// Files to try other commands on, made by simulation.
    #[command(subcommand)]
    Example(example::ExampleCommand),
    /// Emulated hardware.
    #[command(subcommand)]
    Emulate(emulate::EmulateCommand),
    /// A watchdog between a program and velocity controllers on ROS, which have none: sends zeros
    /// when velocities stop.
    Relay(relay::RelayArgs),
    /// Forward kinematics of an arm: pose and Jacobian of a link.
    Fk(arm::FkArgs),
    /// Inverse kinematics of an arm: every joint vector that reaches a pose.
    Ik(arm::IkArgs),
    /// Which arms of a folder of URDFs can carry out the default insertion: a Markdown table.
    Arms(arms::ArmsArgs),
    /// Check a configuration, and whether its arm can carry out the insertion.
    Check(check::CheckArgs),
    /// Print a configuration.
    Config {
        #[command(subcommand)]
        which: ConfigCommand,
    },
    /// Print a completion script for a shell.
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
}

#[derive(Debug, Subcommand)]
enum ConfigCommand {
    /// The commented default configuration.
    Default,
    /// Every key with its default and meaning, as Markdown.
    Reference,
}

/// Runs the program.
pub fn main() -> ExitCode {
    // roslaunch adds `__name:=`, `__log:=` and remappings.
    let command = with_negative_numbers(Cli::command());
    let given = command.get_matches_from(rosbridge::plain_arguments());
    let cli = Cli::from_arg_matches(&given).unwrap_or_else(|error| error.exit());
    match dispatch(cli) {
        Ok(code) => code,
        // The reader of stdout has seen enough, as `head` has.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            report(&error);
            let usage = error.downcast_ref::<config::ConfigError>().is_some()
                || error.downcast_ref::<ResultsError>().is_some()
                || error.downcast_ref::<Usage>().is_some();
            if usage {
                ExitCode::from(2)
            } else {
                ExitCode::from(1)
            }
        }
    }
}

/// The command, in which a negative number is the value of the option before it: it is then told what
/// that option expects, not that there is no option `-1`.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let options = command.mut_args(|option| {
        if option.get_action().takes_values() {
            option.allow_negative_numbers(true)
        } else {
            option
        }
    });
    options.mut_subcommands(with_negative_numbers)
}

/// A seed of a command line.
fn seed(text: &str) -> Result<u64, String> {
    let number = text
        .parse()
        .ok()
        .filter(|seed| *seed <= config::LARGEST_SEED);
    number.ok_or_else(|| format!("expected a whole number from 0 to {}", config::LARGEST_SEED))
}

/// Arguments or input files that cannot be used: exit code 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Usage(String);

/// An input file that cannot be used, with all causes in one line.
fn unusable(file: &Path, error: impl Into<anyhow::Error>) -> Usage {
    let text = words(&error.into()).join(": ");
    let name = file.display().to_string();
    Usage(if text.contains(&name) {
        text
    } else {
        format!("{name}: {text}")
    })
}

/// Says which lengths of a configuration may be in another unit, before anything else is blamed.
fn tell_doubts(config: &config::Config) {
    for doubt in config.doubtful_lengths() {
        // A closed stderr is no reason to stop.
        let _ = writeln!(std::io::stderr(), "note: {doubt}");
    }
}

/// One JSON document on stdout.
fn print_json(value: &impl serde::Serialize) -> anyhow::Result<()> {
    let mut stdout = std::io::stdout().lock();
    serde_json::to_writer(&mut stdout, value)?;
    writeln!(stdout)?;
    Ok(())
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let broken = |e: &std::io::Error| e.kind() == std::io::ErrorKind::BrokenPipe;
    error.downcast_ref().is_some_and(broken)
}

/// The error and its causes, less those that the one before already tells.
fn words(error: &anyhow::Error) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    for cause in error.chain().map(|cause| plain::plain(&cause.to_string())) {
        if !words.last().is_some_and(|last| last.contains(&cause)) {
            words.push(cause);
        }
    }
    words
}

/// One line for the error, one for each cause.
fn report(error: &anyhow::Error) {
    let mut stderr = std::io::stderr().lock();
    let text = words(error).join("\n  caused by: ");
    // Nothing can be done about a closed stderr.
    let _ = writeln!(stderr, "error: {text}");
    if let Some(excerpt) = error.downcast_ref().and_then(excerpt) {
        let _ = write!(stderr, "{excerpt}");
    }
}

/// The line of a configuration that an error is about, marked.
fn excerpt(error: &config::ConfigError) -> Option<String> {
    let (origin, key) = match error {
        config::ConfigError::Syntax { origin, .. } => (origin, None),
        config::ConfigError::Key { origin, key, .. } => (origin, key.rsplit('.').next()),
        _ => return None,
    };
    let config::Origin::File { file, line } = origin else {
        return None;
    };
    let text = std::fs::read_to_string(file).ok()?;
    let shown = text.lines().nth(line.checked_sub(1)?)?.trim_end();
    let start = key.and_then(|key| shown.find(key)).unwrap_or(0);
    let width = key
        .filter(|key| shown.contains(key))
        .map_or(shown.len(), str::len);
    let margin = " ".repeat(line.to_string().len());
    Some(format!(
        " {margin} |\n {line} | {shown}\n {margin} | {}{}\n",
        " ".repeat(start),
        "^".repeat(width.max(1))
    ))
}

fn dispatch(cli: Cli) -> anyhow::Result<ExitCode> {
    match cli.command {
        Command::Run(args) => return run::execute(&args),
        Command::Withdraw(args) => return withdraw::execute(&args),
        Command::Reproduce(args) => return reproduce::execute(&args),
        Command::Campaign(args) => return campaign::execute(&args),
        Command::Replay(args) => return replay::execute(&args),
        Command::Diff(args) => return replay::execute_diff(&args),
        Command::Export(args) => return export::execute(&args),
        Command::Report(args) => return report::execute(&args),
        Command::Estimate(args) => return estimate::execute(&args),
        Command::Validate(args) => return validate::execute(&args),
        Command::Shape(args) => return model::shape(&args),
        Command::Calibrate(command) => return calibrate::execute(&command),
        Command::Track(args) => return track::execute(&args),
        Command::Example(command) => return example::execute(&command),
        Command::Emulate(command) => return emulate::execute(&command),
        Command::Relay(args) => return relay::execute(&args),
        Command::Fk(args) => return arm::fk(&args),
        Command::Ik(args) => return arm::ik(&args),
        Command::Arms(args) => return arms::execute(&args),
        Command::Check(args) => return check::execute(&args),
        Command::Config {
            which: ConfigCommand::Default,
        } => {
            std::io::stdout().write_all(config::DEFAULT_TOML.as_bytes())?;
        }
        Command::Config {
            which: ConfigCommand::Reference,
        } => {
            std::io::stdout().write_all(crate::reference::page().as_bytes())?;
        }
        Command::Completions { shell } => {
            clap_complete::generate(
                shell,
                &mut Cli::command(),
                "needle-steer",
                &mut std::io::stdout(),
            );
        }
    }
    Ok(ExitCode::SUCCESS)
}
