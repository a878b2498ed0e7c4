//! Where the arm holds the needle at the start of an insertion.

use std::path::PathBuf;

use hal::Transform;
use hal::frame::{ArmBase, LeftCamera, World};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robots::arms;
use robots::kinematics::{Chain, Turns};

use super::RigBuildError;
use crate::config::Config;
use crate::cycle::Bearings;

/// The arm's chain to the needle's base.
///
/// # Errors
/// The URDF file cannot be read or gives no chain.
pub fn chain(config: &Config) -> Result<Chain, RigBuildError> {
    let link = if config.arm.tip_link.is_empty() {
        arms::NEEDLE_BASE
    } else {
        config.arm.tip_link.as_str()
    };
    if config.arm.urdf.is_empty() {
        return Ok(Chain::from_urdf(arms::VIPER_S650, link)?);
    }
    let file = PathBuf::from(&config.arm.urdf);
    let xml = std::fs::read_to_string(&file)
        .map_err(|source| RigBuildError::UrdfFile { file, source })?;
    Ok(Chain::from_urdf(&xml, link)?)
}

/// Where things stand for a controller on `config`, with the stereo frame as registered.
///
/// # Errors
/// As [`chain`].
pub fn bearings(
    config: &Config,
    world_from_left_camera: Transform<World, LeftCamera>,
) -> Result<Bearings, RigBuildError> {
    Ok(Bearings {
        chain: chain(config)?,
        world_from_arm_base: arm_place(config),
        world_from_left_camera,
        cameras: None,
    })
}

pub(super) fn arm_place(config: &Config) -> Transform<World, ArmBase> {
    let [x, y, z] = config.arm.base_mm.map(|v| v * 1e-3);
    let [roll, pitch, yaw] = config.arm.base_rpy_deg.map(f64::to_radians);
    Transform::assume(Isometry3::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    ))
}

/// Start pose of the needle's base and the joints for it. The needle's roll is free: it is chosen
/// so that the last joint starts at zero, with all of its travel in both senses.
pub(super) fn start_pose(
    config: &Config,
    chain: &Chain,
    world_from_arm_base: &Transform<World, ArmBase>,
) -> Result<(Isometry3<f64>, hal::Joints), RigBuildError> {
    let start = config.world_from_start_base();
    let p = start.translation.vector * 1e3;
    let unreachable = || RigBuildError::StartUnreachable {
        position_mm: [p.x, p.y, p.z],
    };
    let reach = |pose: &Isometry3<f64>| {
        start_joints(chain, &(world_from_arm_base.isometry().inverse() * pose))
    };
    let mut joints = reach(&start).ok_or_else(unreachable)?;
    let roll = joints.last().copied().unwrap_or(0.0);
    let turned = start * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -roll);
    if let Some(last) = joints.last_mut() {
        *last = 0.0;
    }
    // An arm whose last joint does not turn about the needle keeps the first pose.
    let reached = world_from_arm_base.isometry() * chain.forward(&joints);
    if (reached.to_homogeneous() - turned.to_homogeneous())
        .abs()
        .max()
        < 1e-6
    {
        return Ok((turned, joints));
    }
    Ok((start, reach(&start).ok_or_else(unreachable)?))
}

/// The branch with most room: far from singularities and from the ends of the joints, its last
/// joint turned least, so that the needle can spin in both senses.
fn start_joints(chain: &Chain, base_from_tip: &Isometry3<f64>) -> Option<hal::Joints> {
    /// Reach over which the Jacobian's rows are compared \[m\].
    const LENGTH: f64 = 0.1;
    /// Room beyond which more is no better \[rad\].
    const ENOUGH: f64 = 1.0;
    let merit = |q: &hal::Joints| {
        let room = |(q, limit): (&f64, &hal::JointLimit)| (q - limit.lower).min(limit.upper - q);
        let least = q
            .iter()
            .zip(chain.limits())
            .map(room)
            .fold(ENOUGH, f64::min);
        let turned = q.last().map_or(0.0, |last| last.abs());
        chain.dexterity(q, LENGTH) + least - 0.1 * turned
    };
    chain
        .inverse(base_from_tip, Turns::One)
        .into_iter()
        .max_by(|a, b| merit(a).total_cmp(&merit(b)))
}
