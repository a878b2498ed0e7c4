//! ROS 1 and, with the feature `ros2`, ROS 2: messages, logs of runs, back end, telemetry.
//!
//! A control loop that must not wait, and a middleware that may: between them stand bounded queues and
//! threads of their own. Builds with no ROS installed: the message definitions are part of this crate.
//!
//! A run that is shown and asked:
//! * [`Node`]: one node of either ROS; [`msg`]: the messages, generated from `msgs` at build time.
//! * [`bridge`]: a run on topics, and requests from services; [`dead_man`]: the operator's token.
//! * [`aside`]: a thread beside a run, which is never waited for.
//!
//! Devices behind topics:
//! * [`arm`], [`cameras`], [`marker`]: the back end, each a device of `hal`.
//! * [`emulator`]: the other side of it: an arm, cameras, a laboratory as a node.
//! * [`laboratory`], [`lockstep`]: an emulated laboratory, and its time moved by the controller.
//! * [`motion`]: an arm moved by hand: twists and joint trajectories.
//! * [`relay`]: a watchdog between a program and velocity controllers.
//!
//! What is kept:
//! * [`log`]: a run as an MCAP file of ROS 1 messages, written while it goes, and read back bit by bit.
//! * [`bag`]: such a file as a bag of ROS 1 or of ROS 2; [`stream`]: a run for programs without ROS.
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

/// The example of the README, as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
