//! Velocity screws.

use nalgebra::{Isometry3, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Velocity of a frame: linear velocity of its origin \[m/s\] and angular velocity \[rad/s\],
/// both along the axes of World unless the variable's name says otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// Velocity of the frame's origin \[m/s\].
    pub linear: Vector3<f64>,
    /// Angular velocity \[rad/s\].
    pub angular: Vector3<f64>,
}

impl Twist {
    /// Standstill.
    pub fn zero() -> Self {
        Self::default()
    }

    /// The screw as \[linear; angular\].
    pub fn to_vector(&self) -> Vector6<f64> {
        let (v, w) = (&self.linear, &self.angular);
        Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
    }

    /// From \[linear; angular\].
    pub fn from_vector(screw: &Vector6<f64>) -> Self {
        Self {
            linear: screw.fixed_rows::<3>(0).into_owned(),
            angular: screw.fixed_rows::<3>(3).into_owned(),
        }
    }

    /// The same motion seen from a point of the same rigid body, displaced by `offset` \[m\].
    #[must_use]
    pub fn at_offset(&self, offset: &Vector3<f64>) -> Self {
        Self {
            linear: self.linear + self.angular.cross(offset),
            angular: self.angular,
        }
    }

    /// Both vectors scaled; a direction-preserving change of speed.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            linear: self.linear * factor,
            angular: self.angular * factor,
        }
    }

    /// Whether all six components are finite.
    pub fn is_finite(&self) -> bool {
        self.linear
            .iter()
            .chain(self.angular.iter())
            .all(|x| x.is_finite())
    }

    /// The pose after moving for `seconds` at this constant twist: rotation about the moving
    /// origin, translation of the origin.
    pub fn integrate(&self, pose: &Isometry3<f64>, seconds: f64) -> Isometry3<f64> {
        let rotation = nalgebra::UnitQuaternion::from_scaled_axis(self.angular * seconds);
        Isometry3::from_parts(
            (pose.translation.vector + self.linear * seconds).into(),
            rotation * pose.rotation,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offset_velocity_is_that_of_the_moved_point() {
        let twist = Twist {
            linear: Vector3::new(0.1, 0.2, -0.3),
            angular: Vector3::new(0.3, -0.5, 0.7),
        };
        let pose = Isometry3::new(Vector3::new(0.4, 0.1, 0.2), Vector3::new(0.2, 0.1, -0.4));
        let local = nalgebra::Point3::new(0.05, -0.02, 0.126);
        let (before, h) = (pose * local, 1e-6);
        let after = twist.integrate(&pose, h) * local;
        let offset = before - nalgebra::Point3::from(pose.translation.vector);
        let velocity = twist.at_offset(&offset).linear;
        // Forward difference: error of order |w|^2 |offset| h.
        assert!(((after - before) / h - velocity).norm() < 1e-6);
        assert_eq!(Twist::from_vector(&twist.to_vector()), twist);
    }
}
