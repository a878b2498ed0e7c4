//! The needle's base as the guard watches it: in World, where its box is given.

use hal::guarded::Tool;
use hal::{Joints, Twist};
use nalgebra::{Isometry3, Point3};
use robots::kinematics::Chain;

use super::RigBuildError;
use crate::config::Config;

/// A chain on its stand.
#[derive(Debug)]
pub(crate) struct PlacedTool {
    chain: Chain,
    world_from_arm_base: Isometry3<f64>,
}

impl PlacedTool {
    pub(crate) fn new(chain: &Chain, world_from_arm_base: &Isometry3<f64>) -> Box<Self> {
        Box::new(Self {
            chain: chain.clone(),
            world_from_arm_base: *world_from_arm_base,
        })
    }
}

impl Tool for PlacedTool {
    fn pose(&self, positions: &Joints) -> Isometry3<f64> {
        self.world_from_arm_base * self.chain.forward(positions)
    }

    fn twist(&self, positions: &Joints, rates: &Joints) -> Twist {
        let twist = self.chain.twist(positions, rates);
        let turn = self.world_from_arm_base.rotation;
        Twist {
            linear: turn * twist.linear,
            angular: turn * twist.angular,
        }
    }
}

/// Refuses a start of the needle's base outside of its box.
pub(super) fn check_start(config: &Config, start: &Point3<f64>) -> Result<(), RigBuildError> {
    match config.workspace() {
        Some(workspace) if workspace.excess(start) > 0.0 => Err(RigBuildError::OutsideWorkspace {
            position_mm: (start.coords * 1e3).into(),
            min_mm: config.supervisor.workspace_min_mm,
            max_mm: config.supervisor.workspace_max_mm,
        }),
        _ => Ok(()),
    }
}
