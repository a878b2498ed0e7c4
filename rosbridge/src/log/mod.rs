//! A run as an MCAP file: measurements, decisions, commands and, in simulation, truth.
//!
//! Everything is stored as ROS 1 messages with their definitions, so that Foxglove and Lichtblick
//! open the file and common tools convert it to a bag. Own messages hold what a replay needs,
//! bit by bit; standard ones (`/joint_states`, `/tf`, `/needle/markers`, ...) repeat what a
//! viewer draws and are skipped on reading.
//!
//! [`Log`] writes on a thread of its own while the run goes on, in whole chunks and at least
//! twice a second, so that a killed process leaves a readable file; [`LogReader`] reads such a
//! file up to where it breaks off.

mod chunk;
mod error;
mod kind;
mod messages;
mod read;
mod recorder;
mod records;
mod topic;
mod write;

use std::collections::BTreeMap;
use std::time::Duration;

use hal::frame::{LeftCamera, World};
use hal::{ArmState, RateCommand, SensedShape, Stamp, StereoFrame, Telemetry, Transform};

use crate::bridge::{CameraModel, Frames};
use crate::seam::RosMsg;

use crate::msg::needle_steer_msgs;

pub use error::{Damage, ReadError};
pub use kind::FileKind;
pub use messages::{Messages, RawChannel, RawMessage};
pub use read::LogReader;
pub use recorder::{Log, Overflow, Written};
pub(crate) use topic::log_sum;
pub(crate) use write::level_code;
pub use write::{LogWriter, WriteError};

/// What a log says about its run as a whole.
#[derive(Clone, Debug, PartialEq)]
pub struct RunInfo {
    /// The complete configuration as text (TOML).
    pub config: String,
    /// The run's seed.
    pub seed: u64,
    /// Versions: of this software, of the message definitions, of devices; by name.
    pub versions: BTreeMap<String, String>,
    /// Names of back end, law, phantom and the like; by name.
    pub labels: BTreeMap<String, String>,
    /// Wall-clock time since the epoch when the run's time was zero; nothing where it is unknown.
    pub began: Option<Duration>,
    /// Names of the arm's joints, base to flange.
    pub joint_names: Vec<String>,
    /// The registered pose of the left camera: where targets and measurements are drawn.
    pub world_from_left_camera: Transform<World, LeftCamera>,
}

/// What a viewer needs besides a run's records; written, and not read back.
#[derive(Clone, Debug, Default)]
pub struct Scenery {
    /// The arm's description, URDF.
    pub robot: Option<String>,
    /// What stands still.
    pub frames: Option<Frames>,
    /// Left and right camera, where known.
    pub cameras: Option<[CameraModel; 2]>,
}

impl Default for RunInfo {
    fn default() -> Self {
        Self {
            config: String::new(),
            seed: 0,
            versions: BTreeMap::new(),
            labels: BTreeMap::new(),
            began: None,
            joint_names: Vec::new(),
            world_from_left_camera: Transform::identity(),
        }
    }
}

/// How much a note matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Normal course of a run.
    Info,
    /// Worth attention.
    Warning,
    /// A fault or the reason of a stop.
    Error,
}

/// One entry of a log. Entries are read back in the order in which they were written, so that
/// each step follows the measurements it was computed from.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// Feedback of the arm.
    Arm(ArmState),
    /// A shape measurement.
    Shape(SensedShape),
    /// A pair of images.
    Stereo(StereoFrame),
    /// What was computed in one step.
    Step(Box<Telemetry>),
    /// Rates sent to the arm.
    Command(RateCommand),
    /// Something that happened, in words.
    Note {
        /// When it happened.
        stamp: Stamp,
        /// How much it matters.
        level: Level,
        /// What happened.
        text: String,
    },
    /// A text that belongs to the run, such as its result.
    Document {
        /// Name of the text, such as `result.json`.
        name: String,
        /// The text.
        text: String,
    },
}

impl From<ArmState> for Record {
    fn from(state: ArmState) -> Self {
        Self::Arm(state)
    }
}

impl From<SensedShape> for Record {
    fn from(shape: SensedShape) -> Self {
        Self::Shape(shape)
    }
}

impl From<StereoFrame> for Record {
    fn from(frame: StereoFrame) -> Self {
        Self::Stereo(frame)
    }
}

impl From<Telemetry> for Record {
    fn from(telemetry: Telemetry) -> Self {
        Self::Step(Box::new(telemetry))
    }
}

impl From<RateCommand> for Record {
    fn from(command: RateCommand) -> Self {
        Self::Command(command)
    }
}

/// Whether two snapshots are the same bit by bit, so that NaN equals itself and 0.0 differs
/// from -0.0.
pub fn same_step(a: &Telemetry, b: &Telemetry) -> bool {
    let bytes = |t| needle_steer_msgs::Step::from(t).encode_vec();
    // Encoding to memory does not fail; if it did, nothing would be known to be equal.
    matches!((bytes(a), bytes(b)), (Ok(a), Ok(b)) if a == b)
}

#[cfg(test)]
mod tests;
