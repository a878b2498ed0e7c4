//! Where the arm holds the needle at the start of an insertion.

use core::f64::consts::TAU;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use hal::frame::{ArmBase, LeftCamera, World};
use hal::{JointLimit, Joints, Transform};
use hybrid_control::TipSensor;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robots::arms;
use robots::kinematics::{Chain, Section, Turns};

use super::RigBuildError;
use super::device;
use super::fit::{self, Course, Demand, Misfit};
use crate::config::{Config, InsertionBy, SensorKind};
use crate::cycle::Bearings;
use crate::distortion::DistortionMap;
use crate::fbg::FibreShape;
use crate::hand::ByHand;
use crate::roll;

/// Distance that guarded joints keep from their limits \[rad\]; of sliding joints by their unit.
const JOINT_MARGIN: f64 = 8.727e-3;

/// What is known of a sensor of the tip alone, and the map of its field.
type Field = (Option<TipSensor>, Option<Arc<DistortionMap>>);

/// The arm's chain to the needle's base.
///
/// # Errors
/// The URDF file cannot be read or gives no chain.
pub fn chain(config: &Config) -> Result<Chain, RigBuildError> {
    let chain = as_in_file(config)?;
    let speed = config.arm.joint_speed_deg_s.to_radians();
    Ok(if speed > 0.0 {
        chain.with_speed(speed)
    } else {
        chain
    })
}

/// Which joints move at a speed that the configuration gives, because their URDF does not; a line
/// for the user.
pub fn assumed_speeds(config: &Config) -> Option<String> {
    let chain = as_in_file(config).ok()?;
    let joints: Vec<&str> = chain.without_speed().collect();
    let speed = config.arm.joint_speed_deg_s;
    (!joints.is_empty() && speed > 0.0).then(|| {
        format!(
            "arm.joint_speed_deg_s: {speed} deg/s for {}, whose speed the URDF does not give",
            joints.join(", ")
        )
    })
}

/// The arm's description, URDF; nothing where its file cannot be read as text.
pub fn description(config: &Config) -> Option<String> {
    if config.arm.urdf.is_empty() {
        return Some(arms::VIPER_S650.to_owned());
    }
    std::fs::read_to_string(&config.arm.urdf).ok()
}

/// The chain with the limits of its file.
fn as_in_file(config: &Config) -> Result<Chain, RigBuildError> {
    let arm = &config.arm;
    let link = if arm.tip_link.is_empty() {
        arms::NEEDLE_BASE
    } else {
        arm.tip_link.as_str()
    };
    let mut section = if arm.mechanism {
        Section::mechanism(link)
    } else {
        Section::arm(link)
    };
    if !arm.base_link.is_empty() {
        section = section.from(&arm.base_link);
    }
    for (joint, position) in &arm.held_joints_mm {
        section = section.holding(joint, position * 1e-3);
    }
    for (joint, position) in &arm.held_joints_deg {
        section = section.holding(joint, position.to_radians());
    }
    let chain = if arm.urdf.is_empty() {
        Chain::from_section(arms::VIPER_S650.as_bytes(), &section)
            .map_err(|error| RigBuildError::Urdf(format!("the built-in Viper S650: {error}")))?
    } else {
        let file = PathBuf::from(&arm.urdf);
        let bytes = std::fs::read(&file).map_err(|source| RigBuildError::UrdfFile {
            file: file.clone(),
            source,
        })?;
        Chain::from_section(&bytes, &section)
            .map_err(|error| RigBuildError::Urdf(error.in_file(&file)))?
    };
    let tip_from_tool = tool(config);
    Ok(if tip_from_tool == Isometry3::identity() {
        chain
    } else {
        chain.with_tool(&tip_from_tool)
    })
}

/// The needle's base in the tip link.
pub(crate) fn tool(config: &Config) -> Isometry3<f64> {
    let [x, y, z] = config.arm.tip_mm.map(|v| v * 1e-3);
    let [roll, pitch, yaw] = config.arm.tip_rpy_deg.map(f64::to_radians);
    Isometry3::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    )
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
        tip_sensor: field(config)?.0,
    })
}

/// What is known of a sensor of the tip alone, and the map of its field, where there are such.
pub(super) fn field(config: &Config) -> Result<Field, RigBuildError> {
    match config.run.sensor {
        SensorKind::Em => {}
        SensorKind::Fbg if config.fbg.lasting => {
            return Ok((Some(FibreShape::of(config)?.tip_sensor()), None));
        }
        _ => return Ok((None, None)),
    }
    let map = match config.em.map.as_str() {
        "" => None,
        file => Some(Arc::new(DistortionMap::read(Path::new(file))?)),
    };
    Ok((Some(config.em.tip_sensor(map.as_deref())), map))
}

/// What does not depend on where the arm stands, with the file that it is about.
///
/// # Errors
/// The arm cannot insert anywhere.
pub fn check_arm(config: &Config, chain: &Chain) -> Result<(), RigBuildError> {
    fit::check_chain(chain).map_err(|misfit| {
        if config.arm.urdf.is_empty() {
            misfit.into()
        } else {
            let file = PathBuf::from(&config.arm.urdf);
            let misfit = Box::new(misfit);
            RigBuildError::Arm { file, misfit }
        }
    })
}

/// Place of the arm's base that the configuration gives.
pub fn arm_place(config: &Config) -> Transform<World, ArmBase> {
    let [x, y, z] = config.arm.base_mm.map(|v| v * 1e-3);
    let [roll, pitch, yaw] = config.arm.base_rpy_deg.map(f64::to_radians);
    Transform::assume(Isometry3::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    ))
}

/// Where an insertion starts.
#[derive(Clone, Debug)]
pub struct Start {
    /// Pose of the needle's base in World.
    pub world_from_base: Isometry3<f64>,
    /// The joints for it.
    pub joints: Joints,
    /// What the straight insertion from there leaves the arm.
    pub course: Course,
}

/// Start of the insertion: of all postures of the arm, that with most room from which it can go
/// the whole way. The needle's roll is free: it is chosen so that the last joint starts in the
/// middle of its travel.
///
/// # Errors
/// The arm cannot reach the start, or cannot insert from there.
pub fn start(
    config: &Config,
    chain: &Chain,
    world_from_arm_base: &Transform<World, ArmBase>,
) -> Result<Start, RigBuildError> {
    check_arm(config, chain)?;
    if device::is_device(chain) {
        return device::start(config, chain, world_from_arm_base);
    }
    let demand = Demand::of(config);
    let nominal = config.world_from_start_base();
    let arm_base_from_world = world_from_arm_base.isometry().inverse();
    let mut best: Option<(f64, Start)> = None;
    let mut misfit: Option<(f64, Misfit)> = None;
    for turn in rolls(chain) {
        let start = nominal * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
        for q in chain.inverse(&(arm_base_from_world * start), Turns::One) {
            let merit = merit(chain, &q);
            let (world_from_base, joints) = centred(chain, world_from_arm_base, &start, &q);
            match fit::follow(chain, &joints, &demand) {
                Ok(course) if best.as_ref().is_none_or(|(most, _)| merit >= *most) => {
                    let start = Start {
                        world_from_base,
                        joints,
                        course,
                    };
                    best = Some((merit, start));
                }
                Err(why) if misfit.as_ref().is_none_or(|(most, _)| merit >= *most) => {
                    misfit = Some((merit, why));
                }
                _ => {}
            }
        }
        if let Some((_, start)) = best {
            return Ok(start);
        }
    }
    let p = nominal.translation.vector * 1e3;
    Err(match misfit {
        Some((_, misfit)) => misfit.into(),
        None => RigBuildError::StartUnreachable {
            position_mm: [p.x, p.y, p.z],
        },
    })
}

/// Rolls of the needle to start with: one, where the last joint can turn to any other.
fn rolls(chain: &Chain) -> impl Iterator<Item = f64> {
    let travel = roll::spin_limit(chain).map_or(TAU, |limit| limit.upper - limit.lower);
    let tried = if travel < TAU { 3 } else { 1 };
    (0..tried).map(|k| f64::from(k) * TAU / 3.0)
}

/// The pose `start`, reached with the joints `q`, rolled so that the last joint is in the middle
/// of its travel.
fn centred(
    chain: &Chain,
    world_from_arm_base: &Transform<World, ArmBase>,
    start: &Isometry3<f64>,
    q: &Joints,
) -> (Isometry3<f64>, Joints) {
    let mut joints = *q;
    let spinner = chain.spin().and_then(|spin| joints.get_mut(spin.joint));
    let Some(last) = spinner else {
        return (*start, *q);
    };
    let middle = roll::middle(chain);
    let turn = roll::sense(chain) * (middle - *last);
    *last = middle;
    let turned = start * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
    let wanted = world_from_arm_base.isometry().inverse() * turned;
    let reached = chain.forward(&joints);
    let off = (reached.to_homogeneous() - wanted.to_homogeneous())
        .abs()
        .max();
    if off < 1e-6 {
        return (turned, joints);
    }
    // An axis that calibration has found slightly off the needle: the other joints make up for it.
    let near = chain.inverse_near(&wanted, &joints);
    near.map_or((*start, *q), |joints| (turned, joints))
}

/// How much room a posture has: far from singularities and from the ends of the joints, its last
/// joint turned least, so that the needle can spin in both senses.
fn merit(chain: &Chain, q: &Joints) -> f64 {
    /// Reach over which the Jacobian's rows are compared \[m\].
    const LENGTH: f64 = 0.1;
    /// Room beyond which more is no better \[rad\].
    const ENOUGH: f64 = 1.0;
    let joints = q.iter().zip(chain.limits()).zip(chain.kinds());
    let least = joints
        .map(|((q, limit), kind)| (q - limit.lower).min(limit.upper - q) / kind.unit())
        .fold(ENOUGH, f64::min);
    let turned = chain
        .spin()
        .and_then(|spin| q.get(spin.joint))
        .map_or(0.0, |q| q.abs());
    chain.dexterity(q, LENGTH) + least - 0.1 * turned
}

/// The needle in its guide, where the configuration has a hand push it.
pub(super) fn by_hand(
    config: &Config,
    chain: &Chain,
    joints: &Joints,
) -> Result<Option<ByHand>, RigBuildError> {
    if config.insertion.by == InsertionBy::Axis || config.is_dry() {
        return Ok(None);
    }
    match ByHand::new(chain, joints) {
        Some(by) => Ok(Some(by)),
        None => Err(RigBuildError::NoSlide),
    }
}

/// The joints' limits less what guarded ones keep from them.
pub(super) fn kept(chain: &Chain) -> Vec<JointLimit> {
    let joints = chain.limits().iter().zip(chain.kinds());
    joints
        .map(|(limit, kind)| JointLimit {
            lower: limit.lower + JOINT_MARGIN * kind.unit(),
            upper: limit.upper - JOINT_MARGIN * kind.unit(),
            ..*limit
        })
        .collect()
}
