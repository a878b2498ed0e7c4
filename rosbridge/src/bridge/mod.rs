//! A run on ROS topics, and requests from ROS.
//!
//! The run hands over snapshots and polls for requests; neither call ever waits. A thread of the
//! bridge publishes at the rates below, whatever the rate of the run:
//!
//! | topic | type | rate on the wall clock |
//! |---|---|---|
//! | `joint_states` | `sensor_msgs/JointState` | 100 Hz, while the arm reports |
//! | `/tf` (tip below the needle's base) | `tf2_msgs/TFMessage` | 50 Hz |
//! | `/tf_static` (world, cameras; latched) | `tf2_msgs/TFMessage` | 1 Hz |
//! | `needle/tip` | `geometry_msgs/PoseStamped` | 50 Hz |
//! | `needle/state` | `needle_steer_msgs/State` | 50 Hz |
//! | `needle/markers` | `visualization_msgs/MarkerArray` | 20 Hz |
//! | `left/image_raw`, `right/image_raw`, `.../camera_info` | `sensor_msgs/Image`, `CameraInfo` | as taken, with subscribers |
//! | `overlay` | `sensor_msgs/Image` (rgb8) | as shown, with subscribers |
//! | `/diagnostics` | `diagnostic_msgs/DiagnosticArray` | 1 Hz |
//!
//! Between two readings of the arm the newest one is repeated with its own stamp. An arm that has
//! not reported for 200 ms is not shown any more, and in error on `/diagnostics`.
//!
//! On a [simulated](crate::TimeBase::Simulated) clock every snapshot is published as it comes,
//! and `/clock` with it.

mod cameras;
mod diagnostics;
mod publish;
mod requests;

use std::sync::Arc;
use std::sync::mpsc::Receiver;

use hal::frame::{ArmBase, LeftCamera, RightCamera, World};
use hal::request::Request;
use hal::{ArmState, Overlay, StereoFrame, Telemetry, Transform};
use nalgebra::Isometry3;

use crate::aside::Aside;
use crate::{Node, NodeError};

pub use cameras::CameraModel;
pub(crate) use cameras::CameraOutlet;
use publish::Publisher;
pub(crate) use publish::{overlay_message, still};
pub(crate) use requests::{Received, Requests};

/// Snapshots that may wait for the bridge's thread.
const QUEUE: usize = 64;

/// What stands still; becomes `/tf_static`.
#[derive(Clone, Debug)]
pub struct Frames {
    /// The arm's base.
    pub world_from_arm_base: Transform<World, ArmBase>,
    /// What joins the robot's description to these frames.
    pub described: Described,
    /// The left camera, as registered.
    pub world_from_left_camera: Transform<World, LeftCamera>,
    /// The right camera, as calibrated.
    pub left_from_right: Option<Transform<LeftCamera, RightCamera>>,
}

/// What a robot's description calls the arm's base and the link that holds the needle, where it calls
/// them otherwise than these frames are called.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Described {
    /// Its root, which is the arm's base.
    pub base: Option<String>,
    /// The link that holds the needle, and the needle's base in it.
    pub holder: Option<(String, Isometry3<f64>)>,
}

/// What a bridge shows.
#[derive(Clone, Debug)]
pub struct BridgeOptions {
    /// Names of the arm's joints, base to flange.
    pub joint_names: Vec<String>,
    /// Whether to publish `joint_states`; not with the ROS back end, where the robot does.
    pub joint_states: bool,
    /// What stands still.
    pub frames: Frames,
    /// Left and right camera, where known.
    pub cameras: Option<[CameraModel; 2]>,
    /// How often things are published on the wall clock.
    pub rates: Rates,
}

/// Rates on the wall clock \[Hz\]; those below `joint_states_hz` are rounded to a part of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Of `joint_states`; at most 1000.
    pub joint_states_hz: f64,
    /// Of `/tf`, `needle/tip` and `needle/state`.
    pub poses_hz: f64,
    /// Of `needle/markers`.
    pub markers_hz: f64,
}

impl Default for Rates {
    fn default() -> Self {
        Self {
            joint_states_hz: 100.0,
            poses_hz: 50.0,
            markers_hz: 20.0,
        }
    }
}

/// What is to be shown next.
enum Item {
    Step(Arc<Telemetry>),
    Arm(ArmState),
    Stereo(StereoFrame),
    Overlay(Arc<Overlay>),
}

/// The run's side of the bridge. Dropping it ends its thread; topics stay until the node ends.
#[derive(Debug)]
pub struct Bridge {
    items: Aside<Item>,
    requests: Receiver<Received>,
}

impl Bridge {
    /// Advertises all topics and services.
    ///
    /// # Errors
    /// The master does not register them.
    pub fn new(node: &Node, options: BridgeOptions) -> Result<Self, NodeError> {
        let requests = requests::open(node, options.frames.world_from_left_camera)?;
        let publisher = Publisher::new(node, options)?;
        let items = Aside::start("ros-bridge", QUEUE, |items, dropped| {
            publisher.run(items, dropped);
        })
        .map_err(|error| NodeError::Register {
            name: "bridge".to_owned(),
            reason: error.to_string(),
        })?;
        Ok(Self { items, requests })
    }

    /// Shows a snapshot from now on.
    pub fn show(&self, telemetry: Arc<Telemetry>) {
        self.items.put(Item::Step(telemetry));
    }

    /// Shows newer feedback of the arm than the last snapshot had.
    pub fn show_arm(&self, state: ArmState) {
        self.items.put(Item::Arm(state));
    }

    /// Publishes a pair of images.
    pub fn show_images(&self, frame: StereoFrame) {
        self.items.put(Item::Stereo(frame));
    }

    /// Publishes the left image with the tracked curve drawn in.
    pub fn show_overlay(&self, overlay: impl Into<Arc<Overlay>>) {
        self.items.put(Item::Overlay(overlay.into()));
    }

    /// The next request that is not older than 100 ms; older ones are refused and skipped.
    pub fn poll(&self) -> Option<Request> {
        self.requests.try_iter().find_map(Received::fresh)
    }

    /// Items not shown because the bridge was busy.
    pub fn dropped(&self) -> u64 {
        self.items.dropped()
    }
}
