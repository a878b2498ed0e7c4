//! Measurements, commands and geometry as messages and back, without loss.
//!
//! Reading back never normalises: unit vectors and quaternions keep every bit, so that a replay
//! starts from exactly what was recorded.

use hal::frame::{Frame, LeftCamera};
use hal::joints::TooManyJoints;
use hal::{
    ArmState, CameraFrame, Joints, Position, RateCommand, SensedPoint, SensedShape, SensedTip,
    Stamp, Transform, Twist,
};
use nalgebra::{
    Isometry3, Matrix3, Point3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3,
};

use crate::image::ImageRefused;
use crate::msg::{geometry_msgs, needle_steer_msgs as msgs, sensor_msgs, std_msgs};
use crate::seam::Time;

/// A message that does not say what its definition promises.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConvertError {
    /// A number that is not one of the field's constants.
    #[error("{field} = {code} is not one of its constants")]
    UnknownCode {
        /// The field.
        field: &'static str,
        /// Its value.
        code: u8,
    },
    /// More joints than an arm can have.
    #[error(transparent)]
    Joints(#[from] TooManyJoints),
    /// The image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageRefused),
    /// A frame other than the expected one.
    #[error("given in frame {found:?}, expected {expected:?}")]
    Frame {
        /// The frame the message names.
        found: String,
        /// The only frame that is understood.
        expected: &'static str,
    },
    /// Wrong number of values.
    #[error("{found} values of {field}, expected {expected}")]
    Length {
        /// The field.
        field: &'static str,
        /// Values found.
        found: usize,
        /// Values expected.
        expected: usize,
    },
    /// A joint that the arm has is missing in the message.
    #[error("joint {joint} is missing")]
    MissingJoint {
        /// The joint's name.
        joint: String,
    },
    /// A value that is not a finite number.
    #[error("{field} is not finite")]
    NonFinite {
        /// The field.
        field: &'static str,
    },
}

/// A stamp as ROS's seconds and nanoseconds; saturates after 136 years.
pub(crate) fn time(stamp: Stamp) -> Time {
    let nanoseconds = stamp.as_nanos();
    let nsec = u32::try_from(nanoseconds % 1_000_000_000).unwrap_or(0);
    match u32::try_from(nanoseconds / 1_000_000_000) {
        Ok(sec) => Time { sec, nsec },
        Err(_) => Time {
            sec: u32::MAX,
            nsec: 999_999_999,
        },
    }
}

pub(crate) fn stamp(time: Time) -> Stamp {
    Stamp::from_nanos(u64::from(time.sec) * 1_000_000_000 + u64::from(time.nsec))
}

/// A header; `seq` counts messages in ROS 1 and wraps.
pub(crate) fn header(at: Stamp, frame: &str, sequence: u64) -> std_msgs::Header {
    std_msgs::Header {
        seq: u32::try_from(sequence & u64::from(u32::MAX)).unwrap_or(0),
        stamp: time(at),
        frame_id: frame.to_owned(),
    }
}

pub(crate) fn point(p: &Vector3<f64>) -> geometry_msgs::Point {
    geometry_msgs::Point {
        x: p.x,
        y: p.y,
        z: p.z,
    }
}

pub(crate) fn points(list: &[Vector3<f64>]) -> Vec<geometry_msgs::Point> {
    list.iter().map(point).collect()
}

pub(crate) fn from_point(p: &geometry_msgs::Point) -> Vector3<f64> {
    Vector3::new(p.x, p.y, p.z)
}

pub(crate) fn from_points(list: &[geometry_msgs::Point]) -> Vec<Vector3<f64>> {
    list.iter().map(from_point).collect()
}

pub(crate) fn position<F: Frame>(p: &geometry_msgs::Point) -> Position<F> {
    Position::new(Point3::from(from_point(p)))
}

pub(crate) fn vector(v: &Vector3<f64>) -> geometry_msgs::Vector3 {
    geometry_msgs::Vector3 {
        x: v.x,
        y: v.y,
        z: v.z,
    }
}

pub(crate) fn from_vector(v: &geometry_msgs::Vector3) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

fn quaternion(q: &UnitQuaternion<f64>) -> geometry_msgs::Quaternion {
    geometry_msgs::Quaternion {
        x: q.i,
        y: q.j,
        z: q.k,
        w: q.w,
    }
}

pub(crate) fn pose(isometry: &Isometry3<f64>) -> geometry_msgs::Pose {
    geometry_msgs::Pose {
        position: point(&isometry.translation.vector),
        orientation: quaternion(&isometry.rotation),
    }
}

pub(crate) fn transform(isometry: &Isometry3<f64>) -> geometry_msgs::Transform {
    geometry_msgs::Transform {
        translation: vector(&isometry.translation.vector),
        rotation: quaternion(&isometry.rotation),
    }
}

pub(crate) fn from_pose<A: Frame, B: Frame>(pose: &geometry_msgs::Pose) -> Transform<A, B> {
    let q = &pose.orientation;
    Transform::assume(Isometry3::from_parts(
        Translation3::from(from_point(&pose.position)),
        UnitQuaternion::new_unchecked(Quaternion::new(q.w, q.x, q.y, q.z)),
    ))
}

pub(crate) fn twist(twist: &Twist) -> geometry_msgs::Twist {
    geometry_msgs::Twist {
        linear: vector(&twist.linear),
        angular: vector(&twist.angular),
    }
}

pub(crate) fn from_twist(twist: &geometry_msgs::Twist) -> Twist {
    Twist {
        linear: from_vector(&twist.linear),
        angular: from_vector(&twist.angular),
    }
}

impl From<&Joints> for msgs::Joints {
    fn from(joints: &Joints) -> Self {
        let mut values = [0.0; 7];
        for (value, joint) in values.iter_mut().zip(joints.iter()) {
            *value = *joint;
        }
        // `Joints` holds at most as many as fit.
        Self {
            count: u8::try_from(joints.len()).unwrap_or(0),
            values,
        }
    }
}

impl TryFrom<&msgs::Joints> for Joints {
    type Error = ConvertError;

    fn try_from(m: &msgs::Joints) -> Result<Self, ConvertError> {
        let count = usize::from(m.count);
        let values = m.values.get(..count).ok_or(TooManyJoints { len: count })?;
        Ok(Self::from_slice(values)?)
    }
}

impl From<&ArmState> for msgs::ArmState {
    fn from(state: &ArmState) -> Self {
        Self {
            header: header(state.stamp, "", 0),
            positions: (&state.positions).into(),
            rates: (&state.rates).into(),
            mode: state.mode.into(),
        }
    }
}

impl TryFrom<&msgs::ArmState> for ArmState {
    type Error = ConvertError;

    fn try_from(m: &msgs::ArmState) -> Result<Self, ConvertError> {
        Ok(Self {
            stamp: stamp(m.header.stamp),
            positions: (&m.positions).try_into()?,
            rates: (&m.rates).try_into()?,
            mode: (&m.mode).try_into()?,
        })
    }
}

impl From<&RateCommand> for msgs::RateCommand {
    fn from(command: &RateCommand) -> Self {
        Self {
            header: header(command.stamp, "", command.sequence),
            sequence: command.sequence,
            rates: (&command.rates).into(),
        }
    }
}

impl TryFrom<&msgs::RateCommand> for RateCommand {
    type Error = ConvertError;

    fn try_from(m: &msgs::RateCommand) -> Result<Self, ConvertError> {
        Ok(Self {
            sequence: m.sequence,
            stamp: stamp(m.header.stamp),
            rates: (&m.rates).try_into()?,
        })
    }
}

impl From<&SensedTip> for msgs::SensedTip {
    fn from(tip: &SensedTip) -> Self {
        let c = &tip.covariance;
        Self {
            position: point(&tip.position.coords()),
            covariance: core::array::from_fn(|i| c[(i / 3, i % 3)]),
            direction: vector(&tip.direction),
            direction_sigma: tip.direction_sigma,
        }
    }
}

impl From<&msgs::SensedTip> for SensedTip {
    fn from(m: &msgs::SensedTip) -> Self {
        Self {
            position: position(&m.position),
            covariance: Matrix3::from_row_slice(&m.covariance),
            direction: Unit::new_unchecked(from_vector(&m.direction)),
            direction_sigma: m.direction_sigma,
        }
    }
}

impl From<&SensedShape> for msgs::Shape {
    fn from(shape: &SensedShape) -> Self {
        Self {
            header: header(shape.stamp, LeftCamera::NAME, shape.sequence),
            sequence: shape.sequence,
            points: shape
                .points
                .iter()
                .map(|p| msgs::SensedPoint {
                    position: point(&p.position.coords()),
                    sigma: p.sigma,
                })
                .collect(),
            tip: (&shape.tip).into(),
        }
    }
}

impl TryFrom<&msgs::Shape> for SensedShape {
    type Error = ConvertError;

    fn try_from(m: &msgs::Shape) -> Result<Self, ConvertError> {
        if m.header.frame_id != LeftCamera::NAME {
            return Err(ConvertError::Frame {
                found: m.header.frame_id.clone(),
                expected: LeftCamera::NAME,
            });
        }
        Ok(Self {
            stamp: stamp(m.header.stamp),
            sequence: m.sequence,
            points: m
                .points
                .iter()
                .map(|p| SensedPoint {
                    position: position(&p.position),
                    sigma: p.sigma,
                })
                .collect(),
            tip: (&m.tip).into(),
        })
    }
}

/// One camera's image; the exposure's number goes into the header's `seq` and wraps at 2^32
/// (4.5 years at 30 Hz).
pub(crate) fn image(frame: &CameraFrame, frame_id: &str) -> sensor_msgs::Image {
    let (width, height) = (frame.image.width(), frame.image.height());
    let [width, height] = [width, height].map(|n| u32::try_from(n).unwrap_or(u32::MAX));
    sensor_msgs::Image {
        header: header(frame.stamp, frame_id, frame.sequence),
        height,
        width,
        encoding: "mono8".to_owned(),
        is_bigendian: 0,
        step: width,
        data: frame.image.pixels().to_vec(),
    }
}
