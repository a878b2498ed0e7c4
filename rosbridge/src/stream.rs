//! A run as ROS 1 messages for programs that show it without ROS: topics and definitions of
//! [logs](crate::log), and what the [bridge](crate::bridge) publishes besides.

use hal::frame::{Frame, LeftCamera, RightCamera};
use hal::{ArmState, Joints, Overlay, Stamp, StereoFrame, Telemetry};

use crate::bridge::{CameraModel, Frames, overlay_message, still};
use crate::log::Level;
use crate::log::level_code;
use crate::msg::{
    geometry_msgs, needle_steer_msgs, rosgraph_msgs, sensor_msgs, std_msgs, tf2_msgs,
    visualization_msgs,
};
use crate::seam::{Message, RosMsg};
use crate::{convert, display};

/// Encoding of definitions.
pub const SCHEMA_ENCODING: &str = "ros1msg";
/// Encoding of messages.
pub const MESSAGE_ENCODING: &str = "ros1";

/// What is shown; each is a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "named as their topics")]
pub enum Topic {
    JointStates,
    Tip,
    State,
    Markers,
    Tf,
    TfStatic,
    LeftImage,
    RightImage,
    LeftInfo,
    RightInfo,
    Overlay,
    Note,
    Robot,
}

/// A topic's name, type and definition.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Name, as in logs where they have it.
    pub name: &'static str,
    /// Type of its messages.
    pub message_type: String,
    /// Definition of that type, with all that it is made of.
    pub definition: String,
}

fn channel<M: Message>(name: &'static str) -> Channel {
    Channel {
        name,
        message_type: M::msg_type(),
        definition: M::msg_definition(),
    }
}

impl Topic {
    /// All topics.
    pub const ALL: [Self; 13] = [
        Self::JointStates,
        Self::Tip,
        Self::State,
        Self::Markers,
        Self::Tf,
        Self::TfStatic,
        Self::LeftImage,
        Self::RightImage,
        Self::LeftInfo,
        Self::RightInfo,
        Self::Overlay,
        Self::Note,
        Self::Robot,
    ];

    /// Name, type and definition.
    pub fn channel(self) -> Channel {
        match self {
            Self::JointStates => channel::<sensor_msgs::JointState>("/joint_states"),
            Self::Tip => channel::<geometry_msgs::PoseStamped>("/needle/tip"),
            Self::State => channel::<needle_steer_msgs::State>("/needle/state"),
            Self::Markers => channel::<visualization_msgs::MarkerArray>("/needle/markers"),
            Self::Tf => channel::<tf2_msgs::TFMessage>("/tf"),
            Self::TfStatic => channel::<tf2_msgs::TFMessage>("/tf_static"),
            Self::LeftImage => channel::<sensor_msgs::Image>("/left/image_raw"),
            Self::RightImage => channel::<sensor_msgs::Image>("/right/image_raw"),
            Self::LeftInfo => channel::<sensor_msgs::CameraInfo>("/left/camera_info"),
            Self::RightInfo => channel::<sensor_msgs::CameraInfo>("/right/camera_info"),
            Self::Overlay => channel::<sensor_msgs::Image>("/overlay"),
            Self::Note => channel::<rosgraph_msgs::Log>("/rosout"),
            Self::Robot => channel::<std_msgs::String>("/robot_description"),
        }
    }
}

/// Puts a run's snapshots into bytes; nothing where a message has none.
#[derive(Clone, Debug)]
pub struct Stream {
    /// Names of the arm's joints, base to flange.
    pub joint_names: Vec<String>,
    /// What stands still.
    pub frames: Frames,
    /// Left and right camera, where known.
    pub cameras: Option<[CameraModel; 2]>,
    /// The arm's description, URDF.
    pub robot: Option<String>,
}

impl Stream {
    /// `/joint_states`.
    pub fn joint_states(&self, arm: &ArmState) -> Option<Vec<u8>> {
        let values: [&Joints; 2] = [&arm.positions, &arm.rates];
        let header = convert::header(arm.stamp, "", 0);
        bytes(&display::joint_state(header, &self.joint_names, values))
    }

    /// `/tf`: needle's base and tip.
    pub fn tf(&self, t: &Telemetry) -> Option<Vec<u8>> {
        let needle = vec![
            display::edge(&t.world_from_base, t.stamp),
            display::tip_edge(t),
        ];
        bytes(&display::tree(needle))
    }

    /// `/tf_static`: the arm's base and the cameras.
    pub fn tf_static(&self, stamp: Stamp) -> Option<Vec<u8>> {
        bytes(&still(&self.frames, stamp))
    }

    /// `/needle/tip`.
    pub fn tip(&self, t: &Telemetry) -> Option<Vec<u8>> {
        bytes(&display::tip(t))
    }

    /// `/needle/state`.
    pub fn state(&self, t: &Telemetry) -> Option<Vec<u8>> {
        bytes(&display::state(t))
    }

    /// `/needle/markers`.
    pub fn markers(&self, t: &Telemetry) -> Option<Vec<u8>> {
        bytes(&display::markers(t))
    }

    /// `/left/image_raw` and `/right/image_raw`.
    pub fn image(&self, pair: &StereoFrame, right: bool) -> Option<Vec<u8>> {
        let (frame, name) = if right {
            (&pair.right, RightCamera::NAME)
        } else {
            (&pair.left, LeftCamera::NAME)
        };
        bytes(&convert::image(frame, name))
    }

    /// `/left/camera_info` and `/right/camera_info`.
    pub fn camera_info(&self, pair: &StereoFrame, right: bool) -> Option<Vec<u8>> {
        let [left_model, right_model] = self.cameras.as_ref()?;
        let (model, frame, name) = if right {
            (right_model, &pair.right, RightCamera::NAME)
        } else {
            (left_model, &pair.left, LeftCamera::NAME)
        };
        bytes(&model.message(convert::header(frame.stamp, name, frame.sequence)))
    }

    /// `/overlay`.
    pub fn overlay(&self, overlay: &Overlay) -> Option<Vec<u8>> {
        bytes(&overlay_message(overlay, overlay.image.stamp))
    }

    /// `/robot_description`.
    pub fn robot(&self) -> Option<Vec<u8>> {
        let data = self.robot.clone()?;
        bytes(&std_msgs::String { data })
    }

    /// `/rosout`: a warning.
    pub fn warning(&self, stamp: Stamp, text: &str) -> Option<Vec<u8>> {
        bytes(&rosgraph_msgs::Log {
            header: convert::header(stamp, "", 0),
            level: level_code(Level::Warning),
            name: "needle_steer".to_owned(),
            msg: text.to_owned(),
            ..rosgraph_msgs::Log::default()
        })
    }
}

fn bytes(message: &impl RosMsg) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    message.encode(&mut bytes).ok().map(|()| bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_are_named_once_and_defined() {
        let mut names: Vec<_> = Topic::ALL.iter().map(|t| t.channel().name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), Topic::ALL.len());
        for (i, topic) in Topic::ALL.into_iter().enumerate() {
            assert_eq!(topic as usize, i);
            let channel = topic.channel();
            assert!(channel.message_type.contains('/'), "{channel:?}");
            assert!(!channel.definition.is_empty(), "{channel:?}");
        }
    }
}
