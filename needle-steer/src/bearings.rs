//! Where things stand before a step: geometry of arm, cameras and entry, telemetry of the start.

use hal::frame::{ArmBase, LeftCamera, World};
use hal::telemetry::{ModelReport, Phase, SteeringMode, Telemetry, Tracking};
use hal::{ArmState, Joints, Position, Transform, Twist};
use hybrid_control::{Freedom, TipSensor};
use nalgebra::{Isometry3, Point3, Vector3};
use robots::kinematics::Chain;
use vision::StereoRig;

use crate::config::Config;

/// Where things stand, as calibration and registration know it.
#[derive(Clone, Debug)]
pub struct Bearings {
    /// The arm's chain from its base to the needle's base.
    pub chain: Chain,
    /// Place of the arm.
    pub world_from_arm_base: Transform<World, ArmBase>,
    /// Registration of the stereo frame.
    pub world_from_left_camera: Transform<World, LeftCamera>,
    /// The calibrated cameras, where images close the loop.
    pub cameras: Option<StereoRig>,
    /// What is known of a sensor of the tip alone, where one closes the loop.
    pub tip_sensor: Option<TipSensor>,
}

/// World pose of the needle's base at an encoder reading.
pub fn base_pose(bearings: &Bearings, state: &ArmState) -> Isometry3<f64> {
    bearings.world_from_arm_base.isometry() * bearings.chain.forward(&state.positions)
}

/// What the device can do with the needle's base at an encoder reading. Six joints and more give
/// every twist but in singularities, which are another matter.
pub fn freedom(bearings: &Bearings, state: &ArmState) -> Freedom {
    freedom_at(
        &bearings.chain,
        &state.positions,
        bearings.world_from_arm_base.isometry(),
    )
}

/// The same for joints `q`, as seen from a frame in which the chain's base has a pose.
pub(crate) fn freedom_at(chain: &Chain, q: &Joints, base: &Isometry3<f64>) -> Freedom {
    if chain.len() >= 6 {
        return Freedom::full();
    }
    let jacobian = chain.jacobian(q);
    Freedom::of(chain.kinds().iter().enumerate().map(|(joint, kind)| {
        let twist = Twist::from_vector(&(jacobian.column(joint) * kind.unit()));
        Twist {
            linear: base.rotation * twist.linear,
            angular: base.rotation * twist.angular,
        }
    }))
}

/// Where the needle's axis meets the surface.
pub(crate) fn entry_point(config: &Config, world_from_base: &Isometry3<f64>) -> Point3<f64> {
    let (surface, inward) = (config.entry(), config.inward());
    let axis = world_from_base.rotation * Vector3::z();
    let origin = Point3::from(world_from_base.translation.vector);
    let slope = axis.dot(&inward);
    if slope < 0.1 {
        return surface;
    }
    origin + axis * ((surface - origin).dot(&inward) / slope)
}

/// Telemetry before the first step.
pub(crate) fn first_telemetry(
    state: &ArmState,
    world_from_base: &Isometry3<f64>,
    world_from_tip: &Isometry3<f64>,
) -> Telemetry {
    Telemetry {
        step: 0,
        stamp: state.stamp,
        image_stamp: None,
        phase: Phase::Idle,
        tracking: Tracking::None,
        arm_mode: state.mode,
        joints: state.positions,
        joint_rates: state.positions.zeroed(),
        world_from_base: Transform::assume(*world_from_base),
        world_from_tip: Transform::assume(*world_from_tip),
        base_twist: Twist::zero(),
        measured_tip: None,
        target: Position::new(Point3::origin()),
        lateral_error: f64::NAN,
        axial_distance: f64::NAN,
        depth: 0.0,
        law: hal::telemetry::LawReport {
            mode: SteeringMode::Hold,
            ..Default::default()
        },
        model: ModelReport::default(),
        truth: None,
    }
}
