//! The channels of a log.

use crate::seam::Message;

use crate::msg::{
    geometry_msgs, needle_steer_msgs, rosgraph_msgs, sensor_msgs, std_msgs, tf2_msgs,
    visualization_msgs,
};

/// A channel: its place in [`TOPICS`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Topic {
    Arm,
    Shape,
    Left,
    Right,
    Step,
    Command,
    Note,
    JointStates,
    Tip,
    Markers,
    Tf,
    TfStatic,
    LeftInfo,
    RightInfo,
    Robot,
}

/// Name, message type and definition of a channel.
pub(super) struct Channel {
    pub(super) topic: Topic,
    pub(super) name: &'static str,
    pub(super) message_type: fn() -> String,
    pub(super) definition: fn() -> String,
    md5sum: fn() -> String,
}

const fn channel<M: Message>(topic: Topic, name: &'static str) -> Channel {
    Channel {
        topic,
        name,
        message_type: M::msg_type,
        definition: M::msg_definition,
        md5sum: M::md5sum,
    }
}

/// All channels, in the order of [`Topic`].
pub(super) const TOPICS: [Channel; 15] = [
    channel::<needle_steer_msgs::ArmState>(Topic::Arm, "/arm/state"),
    channel::<needle_steer_msgs::Shape>(Topic::Shape, "/needle/sensed"),
    channel::<sensor_msgs::Image>(Topic::Left, "/left/image_raw"),
    channel::<sensor_msgs::Image>(Topic::Right, "/right/image_raw"),
    channel::<needle_steer_msgs::Step>(Topic::Step, "/needle/step"),
    channel::<needle_steer_msgs::RateCommand>(Topic::Command, "/arm/command"),
    channel::<rosgraph_msgs::Log>(Topic::Note, "/rosout"),
    channel::<sensor_msgs::JointState>(Topic::JointStates, "/joint_states"),
    channel::<geometry_msgs::PoseStamped>(Topic::Tip, "/needle/tip"),
    channel::<visualization_msgs::MarkerArray>(Topic::Markers, "/needle/markers"),
    channel::<tf2_msgs::TFMessage>(Topic::Tf, "/tf"),
    channel::<tf2_msgs::TFMessage>(Topic::TfStatic, "/tf_static"),
    channel::<sensor_msgs::CameraInfo>(Topic::LeftInfo, "/left/camera_info"),
    channel::<sensor_msgs::CameraInfo>(Topic::RightInfo, "/right/camera_info"),
    channel::<std_msgs::String>(Topic::Robot, "/robot_description"),
];

/// The sum of the definition of a log's topic by which ROS 1 knows a type; nothing where logs have no
/// such topic.
pub(crate) fn log_sum(topic: &str) -> Option<String> {
    let channel = TOPICS.iter().find(|channel| channel.name == topic)?;
    Some((channel.md5sum)())
}

/// Encoding of definitions and of messages, as the MCAP registry names them.
pub(super) const SCHEMA_ENCODING: &str = "ros1msg";
pub(super) const MESSAGE_ENCODING: &str = "ros1";
pub(super) const PROFILE: &str = "ros1";

/// Names of the metadata records that make up a [`RunInfo`](super::RunInfo).
pub(super) const META_RUN: &str = "run";
pub(super) const META_VERSIONS: &str = "versions";
pub(super) const META_LABELS: &str = "labels";
/// What precedes a document's name.
pub(super) const META_DOCUMENT: &str = "document/";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_stand_at_their_topics_place() {
        for (i, channel) in TOPICS.iter().enumerate() {
            assert_eq!(channel.topic as usize, i);
        }
    }
}
