//! One step of control: from measurements to joint rates. Read this file first.
//!
//! [`Cycle::step`] is the data flow in order, one line a stage. It is a function of the cycle's
//! state and the [`Snapshot`]: no I/O, no clock.

use hal::frame::{ArmBase, LeftCamera, NeedleBase, World};
use hal::telemetry::{Limit, Phase, Telemetry, Tracking};
use hal::{ArmState, Joints, Position, SensedShape, Stamp, Transform};
use hybrid_control::estimator::{Estimator, Health, Observation};
use hybrid_control::view::{Decision, Entry, Law, RollTravel, Springs, Target, Tip, View};
use nalgebra::{Isometry3, Point3, Vector3};
use needle_model::insertion::Insertion;
use robots::kinematics::Chain;
use robots::kinematics::rates::RateMapper;

use crate::odometry::Odometry;

/// Everything a step reads.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot<'a> {
    /// The present time.
    pub now: Stamp,
    /// Newest encoder reading.
    pub arm: &'a ArmState,
    /// A new measurement of the needle, if one arrived.
    pub shape: Option<&'a SensedShape>,
    /// What the run is doing.
    pub phase: Phase,
}
