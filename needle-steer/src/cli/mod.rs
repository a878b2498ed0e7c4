//! The command line: human text on stderr, results on stdout, exit code 0 done, 1 failed run or
//! fault, 2 bad usage or configuration.

mod arm;
mod calibrate;
mod emulate;
mod model;
mod reproduce;
mod run;
mod track;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

use crate::config;

/// Steers a flexible bevel-tip needle to a target.
#[derive(Debug, Parser)]
#[command(name = "needle-steer", version, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// One insertion to a target.
    Run(run::RunArgs),
    /// The paper's four experiments over seeds: Table I beside the paper's values.
    Reproduce(reproduce::ReproduceArgs),
    /// Equilibrium of the needle model for a given state, as JSON.
    Shape(model::ShapeArgs),
    /// Camera calibration and registration.
    #[command(subcommand)]
    Calibrate(calibrate::CalibrateCommand),
    /// The needle in recorded pairs of images: a JSON line a frame.
    Track(track::TrackArgs),
    /// Emulated hardware.
    #[command(subcommand)]
    Emulate(emulate::EmulateCommand),
    /// Forward kinematics of an arm: pose and Jacobian of a link.
    Fk(arm::FkArgs),
    /// Inverse kinematics of an arm: every joint vector that reaches a pose.
    Ik(arm::IkArgs),
    /// Check a configuration.
    Check {
        /// Configuration file (TOML).
        config: PathBuf,
    },
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
}

/// Runs the program.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    match dispatch(cli) {
        Ok(code) => code,
        // The reader of stdout has seen enough, as `head` has.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            report(&error);
            let usage = error.downcast_ref::<config::ConfigError>().is_some()
                || error.downcast_ref::<Usage>().is_some();
            if usage {
                ExitCode::from(2)
            } else {
                ExitCode::from(1)
            }
        }
    }
}

/// Arguments or input files that cannot be used: exit code 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Usage(String);

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

/// One line for the error, one for each cause.
fn report(error: &anyhow::Error) {
    let mut stderr = std::io::stderr().lock();
    let text = error
        .chain()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join("\n  caused by: ");
    // Nothing can be done about a closed stderr.
    let _ = writeln!(stderr, "error: {text}");
}

fn dispatch(cli: Cli) -> anyhow::Result<ExitCode> {
    match cli.command {
        Command::Run(args) => return run::execute(&args),
        Command::Reproduce(args) => return reproduce::execute(&args),
        Command::Shape(args) => return model::shape(&args),
        Command::Calibrate(command) => return calibrate::execute(&command),
        Command::Track(args) => return track::execute(&args),
        Command::Emulate(command) => return emulate::execute(&command),
        Command::Fk(args) => return arm::fk(&args),
        Command::Ik(args) => return arm::ik(&args),
        Command::Check { config } => {
            config::load(Some(&config), &[])?;
            writeln!(std::io::stdout(), "{}: valid", config.display())?;
        }
        Command::Config {
            which: ConfigCommand::Default,
        } => {
            std::io::stdout().write_all(config::DEFAULT_TOML.as_bytes())?;
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
