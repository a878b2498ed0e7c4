//! The telemetry snapshot as the message `needle_steer_msgs/Step` and back, without loss.

use hal::frame::World;
use hal::telemetry::{
    LawReport, ModelReport, Phase, SteeringMode, Telemetry, Tracking, TruthReport,
};
use nalgebra::Vector2;

use crate::codes::Code;
use crate::convert::{self, ConvertError};
use crate::msg::needle_steer_msgs as msgs;
use hal::frame::Frame;

impl From<&LawReport> for msgs::Law {
    fn from(law: &LawReport) -> Self {
        Self {
            mode: law.mode.code(),
            heading_error: law.heading_error,
            bevel_error: law.bevel_error,
            duty_cycle: law.duty_cycle,
            predicted_miss: law.predicted_miss.into(),
            shortfall: law.shortfall,
            base_authority: law.base_authority,
            bevel_authority: law.bevel_authority,
            limits: law.limits.iter().map(|&limit| limit.into()).collect(),
        }
    }
}

impl TryFrom<&msgs::Law> for LawReport {
    type Error = ConvertError;

    fn try_from(m: &msgs::Law) -> Result<Self, ConvertError> {
        Ok(Self {
            mode: SteeringMode::from_code(m.mode)?,
            heading_error: m.heading_error,
            bevel_error: m.bevel_error,
            duty_cycle: m.duty_cycle,
            predicted_miss: Vector2::from(m.predicted_miss),
            shortfall: m.shortfall,
            base_authority: m.base_authority,
            bevel_authority: m.bevel_authority,
            limits: m
                .limits
                .iter()
                .map(TryInto::try_into)
                .collect::<Result<_, _>>()?,
        })
    }
}

impl From<&ModelReport> for msgs::Model {
    fn from(model: &ModelReport) -> Self {
        Self {
            shape: convert::points(&model.shape),
            spring_points: convert::points(&model.spring_points),
            rest_points: convert::points(&model.rest_points),
            predicted_path: convert::points(&model.predicted_path),
            stiffness: model.stiffness,
            stiffness_sigma: model.stiffness_sigma,
            mean_stretch: model.mean_stretch,
            max_stretch: model.max_stretch,
            entry_stretch: model.entry_stretch,
            entry_force: model.entry_force,
            iterations: model.iterations,
            residual: model.residual,
        }
    }
}

impl From<&msgs::Model> for ModelReport {
    fn from(m: &msgs::Model) -> Self {
        Self {
            shape: convert::from_points(&m.shape),
            spring_points: convert::from_points(&m.spring_points),
            rest_points: convert::from_points(&m.rest_points),
            predicted_path: convert::from_points(&m.predicted_path),
            stiffness: m.stiffness,
            stiffness_sigma: m.stiffness_sigma,
            mean_stretch: m.mean_stretch,
            max_stretch: m.max_stretch,
            entry_stretch: m.entry_stretch,
            entry_force: m.entry_force,
            iterations: m.iterations,
            residual: m.residual,
            shaft_off: f64::NAN,
            path_off: f64::NAN,
        }
    }
}

impl From<&TruthReport> for msgs::Truth {
    fn from(truth: &TruthReport) -> Self {
        Self {
            stamp: convert::time(truth.stamp),
            shape: convert::points(&truth.shape),
            tip: convert::point(&truth.tip),
            direction: convert::vector(&truth.direction),
            target: convert::point(&truth.target),
            lateral_error: truth.lateral_error,
            axial_distance: truth.axial_distance,
            max_stretch: truth.max_stretch,
            mean_stretch: truth.mean_stretch,
        }
    }
}

impl From<&msgs::Truth> for TruthReport {
    fn from(m: &msgs::Truth) -> Self {
        Self {
            stamp: convert::stamp(m.stamp),
            shape: convert::from_points(&m.shape),
            tip: convert::from_point(&m.tip),
            direction: convert::from_vector(&m.direction),
            target: convert::from_point(&m.target),
            lateral_error: m.lateral_error,
            axial_distance: m.axial_distance,
            max_stretch: m.max_stretch,
            mean_stretch: m.mean_stretch,
            ..Self::default()
        }
    }
}

impl From<&Telemetry> for msgs::Step {
    fn from(t: &Telemetry) -> Self {
        Self {
            header: convert::header(t.stamp, World::NAME, t.step),
            step: t.step,
            has_image: t.image_stamp.is_some(),
            image_stamp: convert::time(t.image_stamp.unwrap_or_default()),
            phase: t.phase.code(),
            tracking: t.tracking.code(),
            arm: t.arm_mode.into(),
            joints: (&t.joints).into(),
            joint_rates: (&t.joint_rates).into(),
            world_from_base: convert::pose(t.world_from_base.isometry()),
            world_from_tip: convert::pose(t.world_from_tip.isometry()),
            base_twist: convert::twist(&t.base_twist),
            measured_tip: t.measured_tip.iter().map(Into::into).collect(),
            target: convert::point(&t.target.coords()),
            lateral_error: t.lateral_error,
            axial_distance: t.axial_distance,
            depth: t.depth,
            law: (&t.law).into(),
            model: (&t.model).into(),
            truth: t.truth.iter().map(Into::into).collect(),
        }
    }
}

impl TryFrom<&msgs::Step> for Telemetry {
    type Error = ConvertError;

    fn try_from(m: &msgs::Step) -> Result<Self, ConvertError> {
        for (field, found) in [
            ("measured_tip", m.measured_tip.len()),
            ("truth", m.truth.len()),
        ] {
            if found > 1 {
                return Err(ConvertError::Length {
                    field,
                    found,
                    expected: 1,
                });
            }
        }
        Ok(Self {
            step: m.step,
            stamp: convert::stamp(m.header.stamp),
            image_stamp: m.has_image.then(|| convert::stamp(m.image_stamp)),
            phase: Phase::from_code(m.phase)?,
            tracking: Tracking::from_code(m.tracking)?,
            arm_mode: (&m.arm).try_into()?,
            joints: (&m.joints).try_into()?,
            joint_rates: (&m.joint_rates).try_into()?,
            world_from_base: convert::from_pose(&m.world_from_base),
            world_from_tip: convert::from_pose(&m.world_from_tip),
            base_twist: convert::from_twist(&m.base_twist),
            measured_tip: m.measured_tip.first().map(Into::into),
            target: convert::position(&m.target),
            lateral_error: m.lateral_error,
            axial_distance: m.axial_distance,
            depth: m.depth,
            law: (&m.law).try_into()?,
            model: (&m.model).into(),
            truth: m.truth.first().map(Into::into),
        })
    }
}
