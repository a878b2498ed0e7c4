//! ROS 1 and, with the feature `ros2`, ROS 2: messages, logs of runs, back end, telemetry.
//!
//! Builds with no ROS installed: the message definitions are part of this crate.
//!
//! * [`msg`]: the messages, generated from `msgs` at build time.
//! * [`bridge`]: a run on topics, and requests from services.
//! * [`arm`], [`cameras`], [`marker`]: the back end: devices behind topics.
//! * [`aside`]: a thread beside a run, which is never waited for.
//! * [`dead_man`]: the operator's token.
//! * [`laboratory`], [`lockstep`]: an emulated laboratory, and its time moved by the controller.
//! * [`emulator`]: the other side of the back end: an arm, cameras, a laboratory as a node.
//! * [`motion`]: an arm moved by hand: twists and joint trajectories.
//! * [`relay`]: a watchdog between a program and velocity controllers.
//! * [`stream`]: a run as ROS 1 messages for programs without ROS.
//! * [`log`]: a run as an MCAP file of ROS 1 messages, written while it goes, and read back
//!   bit by bit.
//! * [`bag`]: such a file as a bag of ROS 1 or of ROS 2.
//!
//! **Architecture invariant:** nothing here runs inside the control loop; the loop hands over
//! snapshots and goes on.

pub mod arm;
pub mod aside;
pub mod bag;
pub mod bridge;
pub mod cameras;
#[cfg(feature = "ros2")]
mod cdr;
mod codes;
pub mod convert;
pub mod dead_man;
mod display;
pub mod emulator;
pub mod image;
pub mod laboratory;
pub mod lockstep;
pub mod log;
pub mod marker;
pub mod motion;
pub mod msg;
pub mod relay;
mod seam;
mod status;
mod step;
pub mod stream;

pub use convert::ConvertError;
pub use seam::{
    Domain, Node, NodeEnd, NodeError, NodeOptions, Severity, TimeBase, plain_arguments,
};
