//! Keys of the table `ros`.

use serde::{Deserialize, Serialize};

/// What a ROS node's time is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RosClock {
    /// The wall clock, at real-time factor 1.
    #[default]
    Wall,
    /// Simulated time on `/clock`, as fast as it goes; with the back end `ros`, in lockstep with
    /// the emulated laboratory.
    Simulated,
}

/// How the images of the back end `ros` come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RosImages {
    /// `sensor_msgs/Image`.
    #[default]
    Raw,
    /// `sensor_msgs/CompressedImage`, JPEG or PNG, on the topics below the raw ones'.
    Compressed,
}

/// ROS.
#[expect(
    clippy::struct_excessive_bools,
    reason = "switches of a configuration, each with a key of its own"
)]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ros {
    /// Which ROS: 1, or 2 in builds with the feature `ros2`.
    pub version: u8,
    /// Show the run on topics and offer services, whatever the back end.
    pub publish: bool,
    /// Start at once, else when `~start` is called.
    pub autostart: bool,
    /// Keep the node up after the run, until it is interrupted.
    pub stay: bool,
    /// Let other machines connect: ROS has no authentication.
    pub network: bool,
    /// Address of ROS 1's master; empty for `ROS_MASTER_URI`.
    pub uri: String,
    /// What time is.
    pub clock: RosClock,
    /// Period of the velocities that the back end `ros` sends \[ms\].
    pub period_ms: f64,
    /// Age at which the back end `ros` takes feedback and commands for late \[ms\]: a machine
    /// without real-time scheduling, or a busy one, may need more.
    pub late_ms: f64,
    /// Rate of `joint_states` \[Hz\].
    pub joint_states_hz: f64,
    /// Rate of `/tf`, `needle/tip` and `needle/state` \[Hz\].
    pub poses_hz: f64,
    /// Rate of `needle/markers` \[Hz\].
    pub markers_hz: f64,
    /// How the images come that the back end `ros` sees with.
    pub images: RosImages,
    /// Standard deviation of the marker's places on the topic `marker`, per axis \[mm\].
    pub marker_sigma_mm: f64,
}

impl Default for Ros {
    fn default() -> Self {
        Self {
            version: 1,
            publish: false,
            autostart: true,
            stay: true,
            network: false,
            uri: String::new(),
            clock: RosClock::Wall,
            period_ms: 16.0,
            late_ms: 100.0,
            joint_states_hz: 100.0,
            poses_hz: 50.0,
            markers_hz: 20.0,
            images: RosImages::Raw,
            marker_sigma_mm: 0.2,
        }
    }
}
