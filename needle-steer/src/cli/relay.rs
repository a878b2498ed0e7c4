//! `relay`: a watchdog between a program and the velocity controllers of `ros_control` and
//! `ros2_control`.

use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

use clap::Args;

use super::Usage;
use super::run::interrupt_flag;
use crate::config;
use crate::config::quoted;

/// Longest silence that the watchdog may be set to \[ms\].
const LONGEST_MS: u64 = 1000;
/// Shortest one: two periods of the velocities \[ms\].
const SHORTEST_MS: u64 = 32;

/// A watchdog for velocity controllers.
#[derive(Debug, Args)]
pub(super) struct RelayArgs {
    /// Topic of the program's velocities (`std_msgs/Float64MultiArray`).
    #[arg(long, default_value = "needle_steer/velocities")]
    input: String,
    /// Topic of the controllers.
    #[arg(long, default_value = "joint_group_velocity_controller/command")]
    output: String,
    /// Joints of the arm.
    #[arg(long, default_value_t = 6)]
    joints: usize,
    /// Silence after which zeros are sent [ms].
    #[arg(long, default_value_t = 100)]
    timeout_ms: u64,
    /// Relay on ROS 2.
    #[arg(long, conflicts_with = "uri")]
    ros2: bool,
    /// Let other machines connect; ROS has no authentication.
    #[arg(long)]
    network: bool,
    /// Address of ROS 1's master; without it, `ROS_MASTER_URI`.
    #[arg(long)]
    uri: Option<String>,
}

pub(super) fn execute(args: &RelayArgs) -> anyhow::Result<ExitCode> {
    if !(SHORTEST_MS..=LONGEST_MS).contains(&args.timeout_ms) {
        return Err(Usage(format!(
            "--timeout-ms is to be from {SHORTEST_MS} to {LONGEST_MS}, not {}",
            args.timeout_ms
        ))
        .into());
    }
    if args.joints == 0 {
        return Err(Usage("--joints is to be at least 1".into()).into());
    }
    let mut overrides = vec![
        "ros.publish=true".into(),
        format!("ros.network={}", args.network),
        format!("ros.version={}", if args.ros2 { 2 } else { 1 }),
    ];
    overrides.extend(
        args.uri
            .iter()
            .map(|uri| format!("ros.uri={}", quoted(uri))),
    );
    let config = config::load(None, &overrides)?;
    crate::ros::choose_master(&config)?;
    let controls = interrupt_flag()?;
    let options = rosbridge::relay::RelayOptions {
        input: args.input.clone(),
        output: args.output.clone(),
        joints: args.joints,
        silence: Duration::from_millis(args.timeout_ms),
    };
    crate::ros::relay(&config, &options, &controls, || {
        // Nobody may be listening.
        let _ = writeln!(std::io::stdout(), "ready");
    })?;
    Ok(ExitCode::SUCCESS)
}
