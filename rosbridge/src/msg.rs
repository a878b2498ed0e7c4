//! ROS 1 messages, generated at build time: ROS's own as far as they are in use and
//! `needle_steer_lockstep` from `msgs`, and `needle_steer_msgs`, which hold a run without loss, from
//! the ROS package of that name. `rcl_interfaces` is ROS 2's alone.
//!
//! Lengths are metres, angles radians, `world` is the laboratory; each definition says the rest.

pub use generated::{
    diagnostic_msgs, geometry_msgs, industrial_msgs, needle_steer_lockstep, needle_steer_msgs,
    rcl_interfaces, roscpp, rosgraph_msgs, sensor_msgs, std_msgs, std_srvs, tf2_msgs,
    trajectory_msgs, visualization_msgs,
};

#[allow(
    missing_docs,
    unused_qualifications,
    clippy::all,
    clippy::pedantic,
    clippy::allow_attributes_without_reason,
    clippy::allow_attributes,
    reason = "generated from message definitions, which carry the documentation"
)]
mod generated {
    rosrust::rosmsg_include!(
        diagnostic_msgs / DiagnosticArray,
        geometry_msgs / PointStamped,
        geometry_msgs / PoseStamped,
        geometry_msgs / TwistStamped,
        industrial_msgs / RobotStatus,
        needle_steer_lockstep / Advance,
        needle_steer_lockstep / World,
        needle_steer_msgs / ArmState,
        needle_steer_msgs / RateCommand,
        needle_steer_msgs / Shape,
        needle_steer_msgs / State,
        needle_steer_msgs / Step,
        rcl_interfaces / GetLoggerLevels,
        rcl_interfaces / SetLoggerLevels,
        roscpp / GetLoggers,
        roscpp / SetLoggerLevel,
        rosgraph_msgs / Clock,
        rosgraph_msgs / Log,
        sensor_msgs / CameraInfo,
        sensor_msgs / CompressedImage,
        sensor_msgs / Image,
        sensor_msgs / JointState,
        std_msgs / Empty,
        std_msgs / Float64MultiArray,
        std_msgs / String,
        std_srvs / SetBool,
        std_srvs / Trigger,
        tf2_msgs / TFMessage,
        trajectory_msgs / JointTrajectory,
        visualization_msgs / MarkerArray
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use rosrust::Message;

    /// The sums that ROS 1 (Noetic) peers check on every connection.
    #[test]
    fn definitions_are_those_of_ros() {
        fn check<M: Message>(name: &str, md5: &str) {
            assert_eq!(M::msg_type(), name);
            assert_eq!(M::md5sum(), md5, "{name}");
        }
        check::<sensor_msgs::JointState>(
            "sensor_msgs/JointState",
            "3066dcd76a6cfaef579bd0f34173e9fd",
        );
        check::<tf2_msgs::TFMessage>("tf2_msgs/TFMessage", "94810edda583a504dfda3829e70d7eec");
        check::<visualization_msgs::MarkerArray>(
            "visualization_msgs/MarkerArray",
            "d155b9ce5188fbaf89745847fd5882d7",
        );
        check::<sensor_msgs::Image>("sensor_msgs/Image", "060021388200f6f0f447d0fcd9c64743");
        check::<sensor_msgs::CameraInfo>(
            "sensor_msgs/CameraInfo",
            "c9a58c1b0b154e0e6da7578cb991d214",
        );
        check::<geometry_msgs::PoseStamped>(
            "geometry_msgs/PoseStamped",
            "d3812c3cbc69362b77dc0b19b345f8f5",
        );
        check::<geometry_msgs::PointStamped>(
            "geometry_msgs/PointStamped",
            "c63aecb41bfdfd6b7e1fac37c7cbe7bf",
        );
        check::<geometry_msgs::TwistStamped>(
            "geometry_msgs/TwistStamped",
            "98d34b0043a2093cf9d9345ab6eef12e",
        );
        check::<std_msgs::Float64MultiArray>(
            "std_msgs/Float64MultiArray",
            "4b7d974086d4060e7db4613a7e6c3ba4",
        );
        check::<trajectory_msgs::JointTrajectory>(
            "trajectory_msgs/JointTrajectory",
            "65b4f94a94d1ed67169da35a02f33d3f",
        );
        check::<std_msgs::String>("std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1");
        check::<std_msgs::Empty>("std_msgs/Empty", "d41d8cd98f00b204e9800998ecf8427e");
        check::<diagnostic_msgs::DiagnosticArray>(
            "diagnostic_msgs/DiagnosticArray",
            "60810da900de1dd6ddd437c3503511da",
        );
        check::<industrial_msgs::RobotStatus>(
            "industrial_msgs/RobotStatus",
            "b733cb45a38101840b75c4c0d6093d19",
        );
        check::<rosgraph_msgs::Clock>("rosgraph_msgs/Clock", "a9c97c1d230cfc112e270351a944ee47");
        check::<rosgraph_msgs::Log>("rosgraph_msgs/Log", "acffd30cd6b6de30f120938c17c593fb");
        check::<roscpp::GetLoggers>("roscpp/GetLoggers", "32e97e85527d4678a8f9279894bb64b0");
        check::<roscpp::SetLoggerLevel>(
            "roscpp/SetLoggerLevel",
            "51da076440d78ca1684d36c868df61ea",
        );
        check::<std_srvs::SetBool>("std_srvs/SetBool", "09fb03525b03e7ea1fd3992bafd87e16");
        check::<std_srvs::Trigger>("std_srvs/Trigger", "937c9679a518e3a18d831e57125ea522");
    }

    /// ROS 2 asks for a package before every type, and calls time otherwise; the rest is the same.
    #[test]
    fn definitions_for_ros_2_are_the_same() {
        let folder =
            |ros: &str| format!("{}/{ros}/needle_steer_msgs/msg", env!("CARGO_MANIFEST_DIR"));
        let [ones, twos] = ["ros", "ros2"].map(|ros| std::fs::read_dir(folder(ros)).unwrap());
        assert_eq!(ones.count(), twos.count());
        for file in std::fs::read_dir(folder("ros")).unwrap() {
            let file = file.unwrap();
            let one = std::fs::read_to_string(file.path()).unwrap();
            let expected: Vec<_> = one
                .lines()
                .map(|line| match line.split_once(' ') {
                    Some(("Header", rest)) => format!("std_msgs/Header {rest}"),
                    Some(("time", rest)) => format!("builtin_interfaces/Time {rest}"),
                    _ => line.to_owned(),
                })
                .collect();
            let two = format!("{}/{}", folder("ros2"), file.file_name().to_string_lossy());
            let two = std::fs::read_to_string(&two).unwrap();
            assert_eq!(two.lines().collect::<Vec<_>>(), expected, "{file:?}");
        }
    }

    #[test]
    fn definitions_name_every_type_they_use() {
        let definition = needle_steer_msgs::Step::msg_definition();
        for name in [
            "ArmMode",
            "Joints",
            "SensedTip",
            "Law",
            "Limit",
            "Model",
            "Truth",
        ] {
            assert!(
                definition.contains(&format!("MSG: needle_steer_msgs/{name}\n")),
                "{name}"
            );
        }
        assert!(definition.contains("MSG: geometry_msgs/Quaternion\n"));
        assert!(definition.contains("MSG: std_msgs/Header\n"));
    }
}
