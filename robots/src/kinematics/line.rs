//! Axes of joints as lines in space.

use nalgebra::{Matrix3, Rotation3, Unit, Vector3};

use super::rigid::Rigid;

/// A line: a point and a unit vector.
#[derive(Clone, Debug)]
pub(super) struct Line {
    pub(super) point: Vector3<f64>,
    pub(super) direction: Vector3<f64>,
}

impl Line {
    /// The axis of a joint: z of its frame.
    pub(super) fn of(frame: &Rigid) -> Self {
        Self {
            point: frame.translation,
            direction: frame.rotation.column(2).into_owned(),
        }
    }

    /// Up to an angle \[rad\].
    pub(super) fn is_parallel(&self, other: &Self, tolerance: f64) -> bool {
        self.direction.cross(&other.direction).norm() < tolerance
    }

    /// Up to an angle \[rad\].
    pub(super) fn is_perpendicular(&self, other: &Self, tolerance: f64) -> bool {
        self.direction.dot(&other.direction).abs() < tolerance
    }

    /// Where two perpendicular lines meet, if they miss each other by less than `tolerance`,
    /// on this line.
    pub(super) fn meets(&self, other: &Self, tolerance: f64) -> Option<Vector3<f64>> {
        let between = other.point - self.point;
        let common = self.direction.cross(&other.direction);
        if between.dot(&common).abs() > tolerance || !self.is_perpendicular(other, tolerance) {
            return None;
        }
        let lean = self.direction.dot(&other.direction);
        let along = (between.dot(&self.direction) - lean * between.dot(&other.direction))
            / (1.0 - lean * lean);
        Some(self.point + self.direction * along)
    }

    /// The point of the line next to `point`.
    pub(super) fn foot(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.point + self.direction * (point - self.point).dot(&self.direction)
    }
}

/// Rotation about a unit vector.
pub(super) fn rotation(axis: &Vector3<f64>, angle: f64) -> Matrix3<f64> {
    Rotation3::from_axis_angle(&Unit::new_unchecked(*axis), angle).into_inner()
}
