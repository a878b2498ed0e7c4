//! The application: everything between a configuration file and a verdict.
//!
//! Read [`config`] for what can be asked, [`supervisor`] for what stops a run, and [`outcome`]
//! for what comes out.
//!
//! **Architecture invariant:** no law, sensor or plant is named outside [`config`] and the code
//! that assembles a rig.

pub mod cli;
pub mod clock;
pub mod config;
pub mod experiments;
pub mod odometry;
pub mod outcome;
pub mod plot;
pub mod series;
pub mod statistics;
pub mod supervisor;
