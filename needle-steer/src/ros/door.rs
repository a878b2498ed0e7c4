//! A run on ROS topics.

use std::sync::Arc;

use hal::frame::{ArmBase, Frame, NeedleBase, World};
use hal::request::Request;
use hal::telemetry::Phase;
use hal::{ArmState, Overlay, StereoFrame, Telemetry};
use rosbridge::bridge::{Bridge, BridgeOptions, CameraModel, Described, Frames, Rates};
use rosbridge::{Node, NodeError, Severity};
use vision::StereoRig;
use vision::camera::Camera;

use super::Link;
use crate::clock::WallTime;
use crate::config::{Backend, Config};
use crate::cycle::Bearings;
use crate::remote::Interface;
use crate::rig;

/// A run's topics and services.
#[derive(Debug)]
pub(crate) struct Door {
    node: Node,
    /// The time that the node shares with the run.
    time: WallTime,
    bridge: Bridge,
    /// The phase that was said last.
    phase: Phase,
    /// Whether the images are this node's to show.
    shows_images: bool,
}

impl Door {
    /// Advertises everything.
    ///
    /// # Errors
    /// The master does not register it.
    pub(crate) fn open(
        config: &Config,
        link: &Link,
        bearings: &Bearings,
    ) -> Result<Self, NodeError> {
        let options = BridgeOptions {
            joint_names: bearings.chain.names().to_vec(),
            joint_states: config.run.backend != Backend::Ros,
            frames: Frames {
                described: described(config, bearings),
                ..frames(bearings)
            },
            cameras: bearings.cameras.as_ref().map(camera_models),
            rates: Rates {
                joint_states_hz: config.ros.joint_states_hz,
                poses_hz: config.ros.poses_hz,
                markers_hz: config.ros.markers_hz,
            },
        };
        let bridge = Bridge::new(&link.node, options)?;
        let (law, seed) = (&config.run.law, config.run.seed);
        let text = format!(
            "needle-steer {} is up: law {law}, seed {seed}",
            crate::VERSION
        );
        link.node.say(Severity::Info, &text);
        Ok(Self {
            bridge,
            phase: Phase::Idle,
            node: link.node.clone(),
            time: link.time(),
            shows_images: match config.run.backend {
                Backend::Sim => true,
                Backend::Viper => config.viper.emulate,
                Backend::Ros => false,
            },
        })
    }
}

impl Interface for Door {
    fn show(&mut self, telemetry: &Arc<Telemetry>) {
        if telemetry.phase != self.phase {
            self.phase = telemetry.phase;
            self.say(Severity::Info, &format!("phase: {:?}", telemetry.phase));
        }
        self.bridge.show(Arc::clone(telemetry));
    }

    /// The arm's time is the node's where that is simulated; a simulation that fell behind takes the node
    /// with it.
    fn show_arm(&mut self, state: &ArmState) {
        self.node.set_time(state.stamp);
        self.node.fall_behind(self.time.behind());
        self.bridge.show_arm(*state);
    }

    fn show_images(&mut self, pair: &StereoFrame, overlay: &Arc<Overlay>) {
        if self.shows_images {
            self.bridge.show_images(pair.clone());
        }
        self.bridge.show_overlay(Arc::clone(overlay));
    }

    fn poll(&mut self) -> Option<Request> {
        self.bridge.poll()
    }

    /// On `/rosout` and on standard error.
    fn say(&mut self, severity: Severity, text: &str) -> bool {
        self.node.say(severity, text);
        true
    }
}

/// The frames that rest, as watchers are told them.
pub(crate) fn frames(bearings: &Bearings) -> Frames {
    Frames {
        world_from_arm_base: bearings.world_from_arm_base,
        described: Described::default(),
        world_from_left_camera: bearings.world_from_left_camera,
        left_from_right: bearings
            .cameras
            .as_ref()
            .map(|pair| pair.right_from_left.inverse()),
    }
}

/// What joins the arm's description to our frames. A root that is called as World stands there, and
/// an arm that begins below the root is where the description has it.
fn described(config: &Config, bearings: &Bearings) -> Described {
    let chain = &bearings.chain;
    let known = [ArmBase::NAME, World::NAME];
    let is_root = config.arm.base_link.is_empty() && !known.contains(&chain.base());
    let holds = chain.tip() != NeedleBase::NAME;
    Described {
        base: is_root.then(|| chain.base().to_owned()),
        holder: holds.then(|| (chain.tip().to_owned(), rig::tool(config))),
    }
}

/// What ROS is told of a calibrated pair.
pub(crate) fn camera_models(pair: &StereoRig) -> [CameraModel; 2] {
    let model = |camera: &Camera, shift: f64| {
        let (distortion_model, distortion) = camera.distortion.ros();
        CameraModel {
            width: u32::try_from(camera.width).unwrap_or(u32::MAX),
            height: u32::try_from(camera.height).unwrap_or(u32::MAX),
            intrinsics: [camera.fx, camera.fy, camera.cx, camera.cy],
            distortion_model,
            distortion,
            shift,
        }
    };
    // The cameras look at the gel from two sides: unrectified, they have no common baseline row.
    [model(&pair.left, 0.0), model(&pair.right, 0.0)]
}
