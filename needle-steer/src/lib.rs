//! The application: everything between a configuration file and a verdict.
//!
//! Read [`cycle`] first: one step from measurements to joint rates. [`run`](mod@run) moves an arm
//! with it, [`rig`] assembles the devices that a [`config`] asks for, [`world`] is the simulated
//! one ([`twin`] puts the controller's own model in the phantom's place), [`ros`] the way to topics,
//! [`remote`] to OpenIGTLink; a [`session`] answers what they ask. [`supervisor`] stops what must not go on. [`experiments`], [`comparison`], [`robustness`],
//! [`env`](mod@env) and [`cli`] sit on top.
//!
//! **Architecture invariant:** only [`run`](mod@run) and, while no insertion is under way,
//! [`session`] write to an arm, and every way out of them stops the arm.

pub mod cycle;
mod tissue;
pub mod sight;
pub mod bearings;
mod roll;
pub mod springs;
pub mod odometry;
pub mod withdrawal;
pub mod run;
mod observer;
pub mod bias;
pub mod aim;
pub mod controls;
pub mod rig;
pub mod guide;
pub mod strut;
pub mod hand;
pub mod host;
pub mod world;
pub mod score;
pub mod ros;
pub mod remote;
pub mod session;
pub mod cameras;
pub mod distortion;
pub mod fbg;
pub mod twin;
pub mod clock;
pub mod monitor;
pub mod supervisor;
pub mod config;
pub mod reference;
pub mod outcome;
pub mod progress;
pub mod passing;
pub mod holds;
pub mod journal;
pub mod replay;
pub mod diff;
pub mod campaign;
pub mod report;
pub mod identify;
pub mod series;
pub mod record;
pub mod shape;
pub mod tracked;
pub mod stereo;
pub mod reproduction;
pub mod env;
pub mod results;
pub mod statistics;
pub mod plot;
pub mod experiments;
pub mod export;
pub mod samples;
pub mod comparison;
pub mod robustness;
pub mod cli;

/// Version of this build, with the commit where it is known.
pub const VERSION: &str = env!("NEEDLE_STEER_VERSION");
