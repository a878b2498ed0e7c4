//! `emulate viper`: the Viper's controller on TCP, without an arm.

use std::io::Write;
use std::net::IpAddr;
use std::process::ExitCode;
use std::sync::{Arc, mpsc};

use anyhow::Context;
use clap::{Args, Subcommand, ValueEnum};
use hal::Joints;
use robots::viper::emulator::{EmulatorConfig, Server};
use robots::viper::{Dialect, Emulator};

use super::Usage;
use super::arm::numbers;
use crate::clock::WallTime;

/// Emulated hardware.
#[derive(Debug, Subcommand)]
pub(super) enum EmulateCommand {
    /// The Viper's controller on TCP, until Ctrl-C.
    Viper(ViperArgs),
}

/// The program that the emulated controller runs.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Program {
    /// The project's own program.
    Steer,
    /// The public program of 2018.
    Adept2018,
}

#[derive(Debug, Args)]
pub(super) struct ViperArgs {
    /// The program that the controller runs.
    #[arg(long, default_value = "steer")]
    dialect: Program,
    /// Address to listen on.
    #[arg(long, default_value = "127.0.0.1")]
    listen: IpAddr,
    /// Port for points and stops; the program's own by default, 0 for any.
    #[arg(long)]
    motion_port: Option<u16>,
    /// Port of the feedback; the program's own by default, 0 for any.
    #[arg(long)]
    state_port: Option<u16>,
    /// Where the arm stands \[rad\], comma-separated.
    #[arg(long, default_value = "0,-1.2,2.8,0,1.5,0", allow_hyphen_values = true)]
    joints: String,
}

pub(super) fn execute(command: &EmulateCommand) -> anyhow::Result<ExitCode> {
    let EmulateCommand::Viper(args) = command;
    let (dialect, ports) = match args.dialect {
        Program::Steer => (Dialect::Steer, [11_010, 11_012]),
        Program::Adept2018 => (Dialect::Adept2018, [11_000, 11_002]),
    };
    let start = Joints::from_slice(&numbers(&args.joints, 6, "--joints")?)
        .map_err(|e| Usage(e.to_string()))?;
    let ports = [
        args.motion_port.unwrap_or(ports[0]),
        args.state_port.unwrap_or(ports[1]),
    ];
    let (interrupt, interrupted) = mpsc::channel();
    ctrlc::set_handler(move || {
        // The receiver is gone only when the program is ending anyway.
        let _ = interrupt.send(());
    })
    .context("installing the signal handler")?;
    let clock = WallTime::start();
    let server = Server::start(
        Emulator::new(EmulatorConfig::viper(dialect, start)),
        args.listen,
        ports,
        Some(Arc::new(move || clock.now())),
    )?;
    writeln!(
        std::io::stdout(),
        "motion {}\nstate {}",
        server.motion,
        server.state
    )?;
    interrupted.recv().context("waiting for Ctrl-C")?;
    Ok(ExitCode::SUCCESS)
}
