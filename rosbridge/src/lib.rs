//! ROS 1: messages, back end, telemetry.
