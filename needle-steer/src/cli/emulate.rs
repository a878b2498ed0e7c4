//! `emulate`: the Viper's controller on TCP, without an arm; a laboratory as a ROS node.

use std::io::Write;
use std::net::IpAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::{Arc, mpsc};

use anyhow::Context;
use clap::{Args, Subcommand, ValueEnum};
use hal::Joints;
use robots::viper::emulator::{EmulatorConfig, Server};
use robots::viper::{Dialect, Emulator};

use super::Usage;
use super::arm::numbers;
use super::faults::{self, Laboratory, Viper};
use super::run::interrupt_flag;
use crate::clock::WallTime;
use crate::config::{self, Config, quoted};
use crate::rig;
use crate::ros::Watchdog;

/// Emulated hardware.
#[derive(Debug, Subcommand)]
pub(super) enum EmulateCommand {
    /// The Viper's controller on TCP, until Ctrl-C.
    Viper(ViperArgs),
    /// The simulated arm, phantom and sensors as a ROS node, until Ctrl-C.
    Ros(RosArgs),
}

#[derive(Debug, Args)]
pub(super) struct RosArgs {
    /// Configuration file (TOML); without it, the default one.
    config: Option<PathBuf>,
    /// Change one key of the configuration: key=value, the value in TOML.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// What sees the needle: images, shape, em [default: run.sensor, images].
    #[arg(long)]
    sensor: Option<String>,
    /// Preset of the phantom.
    #[arg(long)]
    phantom: Option<String>,
    /// Seed of everything random.
    #[arg(long, value_parser = super::seed)]
    seed: Option<u64>,
    /// A node of ROS 2.
    #[arg(long)]
    ros2: bool,
    /// Move in lockstep with the controller, on /clock.
    #[arg(long)]
    lockstep: bool,
    /// Hold the last velocity for ever, as ros_control's velocity controllers do: what `relay` is
    /// for.
    #[arg(long, conflicts_with = "lockstep")]
    no_watchdog: bool,
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
    /// Where the arm stands [deg], comma-separated, as runs print it.
    #[arg(
        long,
        value_name = "JOINTS",
        default_value = "0,-70,160,0,85,0",
        allow_hyphen_values = true
    )]
    joints_deg: String,
}

pub(super) fn execute(command: &EmulateCommand) -> anyhow::Result<ExitCode> {
    match command {
        EmulateCommand::Viper(args) => viper(args),
        EmulateCommand::Ros(args) => ros(args),
    }
}

fn ros(args: &RosArgs) -> anyhow::Result<ExitCode> {
    let mut overrides = args.set.clone();
    overrides.push("run.backend='ros'".into());
    overrides.extend(args.seed.map(|seed| format!("run.seed={seed}")));
    let named = [("run.sensor", &args.sensor), ("run.phantom", &args.phantom)];
    for (key, name) in named {
        overrides.extend(name.as_ref().map(|name| format!("{key}={}", quoted(name))));
    }
    if args.ros2 {
        overrides.push("ros.version=2".into());
    }
    if args.lockstep {
        overrides.push("ros.clock='simulated'".into());
    }
    let config = config::load(args.config.as_deref(), &overrides)?;
    crate::ros::choose_master(&config)?;
    let controls = interrupt_flag()?;
    let watchdog = if args.no_watchdog {
        Watchdog::Missing
    } else {
        Watchdog::Stops
    };
    let mut listening = Ok(());
    crate::ros::serve(&config, watchdog, &controls, |arm, reports| {
        // Nobody may be listening.
        let _ = writeln!(std::io::stdout(), "ready");
        if !args.lockstep {
            listening = faults::listen(Laboratory::new(arm, reports));
        }
    })?;
    Ok(listening.map(|()| ExitCode::SUCCESS)?)
}

/// Refuses a place \[deg\] in which the Viper cannot stand.
fn check_limits(joints: &[f64]) -> Result<(), Usage> {
    let chain = rig::chain(&Config::default()).map_err(|e| Usage(e.to_string()))?;
    for (k, (x, limits)) in joints.iter().zip(chain.limits()).enumerate() {
        let [from, to] = [limits.lower, limits.upper].map(f64::to_degrees);
        if !(from..=to).contains(x) {
            return Err(Usage(format!(
                "--joints-deg, joint {}: {x:.1} deg, expected {from:.1} to {to:.1} deg",
                k + 1
            )));
        }
    }
    Ok(())
}

fn viper(args: &ViperArgs) -> anyhow::Result<ExitCode> {
    let (dialect, ports) = match args.dialect {
        Program::Steer => (Dialect::Steer, [11_010, 11_012]),
        Program::Adept2018 => (Dialect::Adept2018, [11_000, 11_002]),
    };
    let degrees = numbers(&args.joints_deg, 6, "--joints-deg")?;
    check_limits(&degrees)?;
    let start: Vec<f64> = degrees.iter().map(|x| x.to_radians()).collect();
    let start = Joints::from_slice(&start).map_err(|e| Usage(e.to_string()))?;
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
    let emulator = Emulator::new(EmulatorConfig::viper(dialect, start));
    let server = Server::start(
        emulator.clone(),
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
    faults::listen(Viper(emulator))?;
    interrupted.recv().context("waiting for Ctrl-C")?;
    Ok(ExitCode::SUCCESS)
}
