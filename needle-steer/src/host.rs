//! The real controller of the Viper behind a network address, for dry runs.

use std::sync::Arc;
use std::time::Duration;

use hal::guarded::SpeedCaps;
use hal::{Arm, Joints, Stamp};
use robots::kinematics::Chain;
use robots::viper::driver::{Core, LinkError, SetupError, ToolLimits, Unfit};
use robots::viper::lockstep::await_link;
use robots::viper::tcp::StartError;
use robots::viper::{self, Dialect, Monitor, ViperArm};

use crate::clock::{WallClock, WallTime};
use crate::config::{Config, ViperDialect};
use crate::rig::{NotAtStart, PlacedTool, arm_place};
use crate::world::Body;

/// Longest wait for the link and the first report.
const CONNECT: Duration = Duration::from_secs(5);

/// Why the controller cannot be used; nothing moved.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    /// The driver's settings.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// No thread for the driver.
    #[error(transparent)]
    Start(#[from] StartError),
    /// There is no link.
    #[error("the controller at {host}: {source}")]
    Link {
        /// Host of the controller.
        host: String,
        /// Why.
        source: LinkError,
    },
    /// Another arm.
    #[error("the controller at {host}: {source}")]
    Unfit {
        /// Host of the controller.
        host: String,
        /// What differs.
        source: Unfit,
    },
    /// The arm does not stand at the start of the insertion.
    #[error("the controller at {host}: {source}, or it is another arm")]
    NotAtStart {
        /// Host of the controller.
        host: String,
        /// Where it stands.
        source: Box<NotAtStart>,
    },
    /// A device.
    #[error(transparent)]
    Device(#[from] hal::Error),
}

/// Joint positions in degrees, as messages show them.
pub fn degrees(joints: &Joints) -> String {
    let values: Vec<String> = joints
        .iter()
        .map(|q| format!("{:.3}", q.to_degrees()))
        .collect();
    format!("[{}]", values.join(", "))
}

/// The driver's settings for the configured controller.
pub fn settings(config: &Config) -> viper::Config {
    let dialect = match config.viper.dialect {
        ViperDialect::Steer => Dialect::Steer,
        ViperDialect::Adept2018 => Dialect::Adept2018,
    };
    let mut settings = viper::Config::viper(&config.viper.host, dialect);
    settings.seed = config.run.seed;
    if config.viper.motion_port != 0 {
        settings.motion_port = config.viper.motion_port;
    }
    if config.viper.state_port != 0 {
        settings.state_port = config.viper.state_port;
    }
    settings
}

/// Connects to the controller and checks that its arm is the configured one and, where `start`
/// is given, stands there. Nothing moves.
///
/// # Errors
/// See [`HostError`].
pub fn connect(
    config: &Config,
    chain: &Chain,
    start: Option<&Joints>,
    time: WallTime,
) -> Result<(ViperArm, HostArm), HostError> {
    let core = Core::new(settings(config))?.with_tool(ToolLimits {
        tool: PlacedTool::new(chain, arm_place(config).isometry()),
        workspace: config.workspace(),
        caps: SpeedCaps::INSERTING,
    });
    let mut clock = WallClock::since(time.clone());
    let mut arm = ViperArm::run(core, Arc::new(move || time.now()))?;
    let host = config.viper.host.clone();
    await_link(&arm, &mut clock, CONNECT).map_err(|source| HostError::Link {
        host: host.clone(),
        source,
    })?;
    let state = arm.state()?;
    let monitor = arm.monitor();
    if let Some(source) = monitor.unfit() {
        return Err(HostError::Unfit { host, source });
    }
    if let Some(start) = start {
        NotAtStart::check(chain, &state.positions, start)
            .map_err(|source| HostError::NotAtStart { host, source })?;
    }
    let last = state.positions;
    Ok((arm, HostArm { monitor, last }))
}

/// The arm at the controller, where its encoders say it is.
#[derive(Debug)]
pub struct HostArm {
    monitor: Monitor,
    last: Joints,
}

impl Body for HostArm {
    fn advance_to(&mut self, _: Stamp) -> Joints {
        if let Some(positions) = self.monitor.positions() {
            self.last = positions;
        }
        self.last
    }
}
