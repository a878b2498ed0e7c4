//! ROS 2's wire: topics and services as bytes in CDR over DDS, under the names that ROS 2 gives them.
//!
//! A program that speaks with ROS 2 need not be built by ROS 2: on the wire there are DDS topics with
//! agreed names, and a topic on which nodes say who they are. This crate knows no message: what the bytes
//! mean is the caller's business. Built on RustDDS, and needs no ROS to build or to run.
//!
//! * [`names`]: ROS's names, remappings, and what DDS calls them.
//! * [`Participant`]: one ROS 2 node as one participant of a DDS domain.
//! * [`Writer`], [`Reader`]: a topic's ends. A reader has a thread of its own.
//! * [`Server`]: a service, for clients of either way in which ROS 2 tells whose answer it is.
//! * [`Quality`]: what a topic's ends promise each other.
//!
//! **Architecture invariant:** sending never waits: what nobody takes in time is dropped.

mod graph;
pub mod names;
mod participant;
mod peers;
mod quality;
mod server;
mod topic;

pub use graph::Gids;
pub use participant::{Participant, Settings, WireError};
pub use quality::Quality;
pub use server::Server;
pub use topic::{Reader, Sample, Writer};

/// The example of the README, as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
