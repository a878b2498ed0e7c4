//! Keys of the table `live`, and what all ways to watch a run come to.

use serde::{Deserialize, Serialize};

use super::Config;

/// The live view over Foxglove's WebSocket protocol.
#[expect(
    clippy::struct_excessive_bools,
    reason = "switches of a configuration, each with a key of its own"
)]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Live {
    /// Serve the run, whatever the back end.
    pub serve: bool,
    /// Address and port.
    pub address: String,
    /// Let other machines connect: the protocol has no authentication.
    pub network: bool,
    /// Start at once, else when the service `start` is called.
    pub autostart: bool,
    /// Keep the server up after the run, until it is interrupted.
    pub stay: bool,
    /// Rate of poses and of the state \[Hz\].
    pub poses_hz: f64,
    /// Rate of lines \[Hz\].
    pub lines_hz: f64,
    /// Highest rate of images \[Hz\].
    pub images_hz: f64,
}

impl Default for Live {
    fn default() -> Self {
        Self {
            serve: false,
            address: "127.0.0.1:8765".into(),
            network: false,
            autostart: true,
            stay: true,
            poses_hz: 50.0,
            lines_hz: 20.0,
            images_hz: 30.0,
        }
    }
}

impl Config {
    /// Whether an insertion starts by itself: no connection that is asked for wants to be waited for.
    pub const fn autostarts(&self) -> bool {
        (self.ros.autostart || !self.has_node())
            && (self.igtl.autostart || !self.igtl.serve)
            && (self.live.autostart || !self.live.serve)
    }

    /// Whether a connection stays up after the insertion.
    pub const fn stays(&self) -> bool {
        self.has_node() && self.ros.stay
            || self.igtl.serve && self.igtl.stay
            || self.live.serve && self.live.stay
    }

    /// Whether the run is shown on topics.
    pub(super) const fn has_node(&self) -> bool {
        self.ros.publish
    }

    /// Whether somebody outside of ROS watches, for whom a simulated world keeps step with the wall
    /// clock.
    pub const fn is_watched(&self) -> bool {
        self.igtl.serve || self.live.serve
    }
}
