//! ROS at the edge of a run: the node, topics and services, the back end `ros`, and the
//! emulated laboratory.
//!
//! Nothing here sits between a measurement and a command: the run hands snapshots over and looks
//! for requests once an arm period, and neither waits.

mod domain;
mod door;
mod laboratory;
mod motion;
mod relay;
mod remote;

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use hal::{Arm, ArmDescription, Clock};
use robots::kinematics::Chain;
use rosbridge::arm::{RosArm, RosArmError, RosArmOptions};
use rosbridge::cameras::{RosCameras, RosCamerasOptions};
use rosbridge::laboratory::{Laboratory, RosShapes};
use rosbridge::lockstep::Lockstep;
use rosbridge::marker::RosMarker;
use rosbridge::motion::Hand;
use rosbridge::{Node, NodeError, NodeOptions, TimeBase};

use crate::clock::{WallClock, WallTime};
use crate::config::{Backend, Config, RosClock, RosImages, SensorKind, TargetKind};
use crate::controls::Controls;
use crate::rig::{Eyes, MarkerEyes, Pace};

pub(crate) use door::{Door, camera_models, frames};
pub use laboratory::{Watchdog, emulate, serve};
pub(crate) use motion::to_rates;
pub use relay::{RelayNodeError, relay};
use remote::RemoteLaboratory;

/// Wait for an emulated laboratory's first truth, on the wall clock: a real one has none.
const TRUTH: Duration = Duration::from_secs(1);

/// Starts the program anew where the configuration names another master than the environment,
/// which is where the ROS library looks.
///
/// # Errors
/// The program cannot be started anew.
pub fn choose_master(config: &Config) -> std::io::Result<()> {
    const VARIABLE: &str = "ROS_MASTER_URI";
    let uri = &config.ros.uri;
    let wanted =
        (config.ros.publish || config.run.backend == Backend::Ros) && config.ros.version == 1;
    if uri.is_empty() || !wanted || std::env::var_os(VARIABLE).is_some_and(|set| set == uri[..]) {
        return Ok(());
    }
    let mut again = std::process::Command::new(std::env::current_exe()?);
    again.args(std::env::args_os().skip(1)).env(VARIABLE, uri);
    become_process(&mut again)
}

#[cfg(unix)]
fn become_process(command: &mut std::process::Command) -> std::io::Result<()> {
    use std::os::unix::process::CommandExt;
    Err(command.exec())
}

#[cfg(not(unix))]
fn become_process(_: &mut std::process::Command) -> std::io::Result<()> {
    Err(std::io::Error::other(
        "ros.uri needs Unix; set ROS_MASTER_URI instead",
    ))
}

/// A node, and the time that it shares with the run.
#[derive(Clone, Debug)]
pub struct Link {
    /// The node.
    pub node: Node,
    time: WallTime,
    clock: RosClock,
}

/// The devices of a run over ROS.
pub(crate) struct RosDevices {
    pub(crate) clock: Box<dyn Clock>,
    pub(crate) arm: Box<dyn Arm>,
    pub(crate) eyes: Eyes,
    pub(crate) truth: Option<RemoteLaboratory>,
}

impl Link {
    /// Becomes a node where `config` asks for it.
    ///
    /// # Errors
    /// No master, one that does not answer, a domain that cannot be joined, or a node open to other
    /// machines that should not be.
    pub fn new(config: &Config) -> Result<Option<Self>, NodeError> {
        let back_end = config.run.backend == Backend::Ros;
        if !(config.ros.publish || back_end) {
            return Ok(None);
        }
        let simulated = if back_end {
            TimeBase::Remote
        } else {
            TimeBase::Simulated
        };
        Self::named(config, "needle_steer", simulated).map(Some)
    }

    /// Ends the program when the node is asked to end or loses its name: the arm comes to rest and
    /// the results are written, and nobody is left to be deceived by a node out of reach.
    pub fn end_with_node(&self, controls: &Arc<Controls>) {
        let controls = Arc::clone(controls);
        self.node.on_end(move |end| controls.interrupt_because(end));
    }

    /// Becomes a node; on a simulated clock, of this kind.
    #[expect(
        clippy::disallowed_methods,
        reason = "ROS time is wall-clock time since the epoch"
    )]
    fn named(config: &Config, name: &str, simulated: TimeBase) -> Result<Self, NodeError> {
        let time = WallTime::start();
        let epoch = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        let base = match config.ros.clock {
            RosClock::Wall => TimeBase::Wall {
                origin: epoch.unwrap_or_default(),
            },
            RosClock::Simulated => simulated,
        };
        let place = if config.ros.version == 2 {
            let get = |name: &str| std::env::var_os(name)?.into_string().ok();
            Some(domain::place(config.ros.network, get)?)
        } else {
            None
        };
        let node = Node::connect(&NodeOptions {
            name: name.to_owned(),
            network: config.ros.network,
            time: base,
            domain: place.as_ref().map(|place| place.domain),
        })?;
        if let Some(said) = place.and_then(|place| place.said) {
            node.warn(&said);
        }
        Ok(Self {
            node,
            time,
            clock: config.ros.clock,
        })
    }

    /// The time that the node shares with the run.
    pub(crate) fn time(&self) -> WallTime {
        self.time.clone()
    }

    /// What sees the needle over topics: cameras, or a tracker.
    pub(crate) fn eyes(&self, config: &Config) -> Result<Eyes, NodeError> {
        let node = &self.node;
        Ok(match config.run.sensor {
            SensorKind::Images => Eyes::Cameras(Box::new(RosCameras::new(
                node,
                RosCamerasOptions {
                    compressed: config.ros.images == RosImages::Compressed,
                    ..RosCamerasOptions::default()
                },
            )?)),
            SensorKind::Shape | SensorKind::Em | SensorKind::Fbg => {
                Eyes::Shape(Box::new(RosShapes::new(node)?))
            }
        })
    }

    /// The marker of the tissue over a topic, where the target is one.
    pub(crate) fn marker(&self, config: &Config) -> Result<MarkerEyes, NodeError> {
        if config.target.kind != TargetKind::Marker {
            return Ok(MarkerEyes::default());
        }
        let sigma = config.ros.marker_sigma_mm * 1e-3;
        Ok(MarkerEyes::new(Box::new(RosMarker::new(
            &self.node, sigma,
        )?)))
    }

    /// Lets the topic and the service `~dead_man` refresh the token of `controls`.
    ///
    /// # Errors
    /// The master does not register them.
    pub fn listen_to_dead_man(&self, controls: &Arc<Controls>) -> Result<(), NodeError> {
        let controls = Arc::clone(controls);
        rosbridge::dead_man::listen(&self.node, move || controls.refresh_dead_man())
    }

    /// Motion by hand over topics.
    ///
    /// # Errors
    /// The master does not register them.
    pub(crate) fn hand(&self, joint_names: &[String]) -> Result<Hand, NodeError> {
        Hand::new(&self.node, joint_names)
    }

    /// The pace of a simulated world that the node shows.
    pub(crate) fn pace(&self) -> Pace {
        match self.clock {
            RosClock::Wall => Pace::Paced(self.time()),
            RosClock::Simulated => Pace::Free,
        }
    }

    /// The back end `ros`.
    pub(crate) fn devices(
        &self,
        config: &Config,
        chain: &Chain,
    ) -> Result<RosDevices, RosArmError> {
        let mut options = RosArmOptions::new(ArmDescription {
            name: "ros".to_owned(),
            joint_names: chain.names().to_vec(),
            limits: chain.limits().to_vec(),
            period: Duration::from_secs_f64(config.ros.period_ms * 1e-3),
        });
        let late = Duration::from_secs_f64(config.ros.late_ms * 1e-3);
        options.timing.feedback = late;
        options.timing.command_late = late;
        options.timing.command_fault = 2 * late;
        let node = &self.node;
        if self.clock == RosClock::Simulated {
            let parts = Lockstep::open(node, &options)?;
            return Ok(RosDevices {
                clock: Box::new(parts.clock),
                arm: Box::new(parts.arm),
                eyes: match config.run.sensor {
                    SensorKind::Images => Eyes::Cameras(Box::new(parts.cameras)),
                    SensorKind::Shape | SensorKind::Em | SensorKind::Fbg => {
                        Eyes::Shape(Box::new(parts.shapes))
                    }
                },
                truth: Some(RemoteLaboratory::new(parts.laboratory)),
            });
        }
        let laboratory = RemoteLaboratory::new(Laboratory::new(node)?);
        let arm = RosArm::new(node, options)?;
        let eyes = self.eyes(config)?;
        let mut clock = WallClock::since(self.time());
        let patience = clock.now() + TRUTH;
        while !laboratory.is_known() && clock.now() < patience {
            let next = clock.now() + Duration::from_millis(10);
            clock.wait_until(next);
        }
        Ok(RosDevices {
            clock: Box::new(clock),
            arm: Box::new(arm),
            eyes,
            truth: laboratory.is_known().then_some(laboratory),
        })
    }
}
