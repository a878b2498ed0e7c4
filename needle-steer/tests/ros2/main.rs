//! The binary as a node of ROS 2, in a domain of its own on the loopback interface. The judge is Cyclone
//! DDS in other processes, with ROS 2's names and types (`tests/peers/ros2_types.py`): a DDS
//! implementation of another project, but not ROS 2's own client library.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    clippy::disallowed_methods,
    reason = "tests of live processes: they wait, tell what they skip, and fail by panicking"
)]

mod arm;
mod foreign_arm;
mod launch;
mod lockstep;
mod peer;
mod telemetry;
#[path = "../peers/ur_robot.rs"]
mod ur_robot;
