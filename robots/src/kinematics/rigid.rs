//! Rigid motions as rotation matrix and translation.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Rotation matrix and translation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rigid {
    pub(super) rotation: Matrix3<f64>,
    pub(super) translation: Vector3<f64>,
}

impl Rigid {
    pub(super) const IDENTITY: Self = Self {
        rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        translation: Vector3::new(0.0, 0.0, 0.0),
    };

    pub(super) fn of(isometry: &Isometry3<f64>) -> Self {
        Self {
            rotation: isometry.rotation.to_rotation_matrix().into_inner(),
            translation: isometry.translation.vector,
        }
    }

    pub(super) fn then(&self, next: &Self) -> Self {
        Self {
            rotation: self.rotation * next.rotation,
            translation: self.rotation * next.translation + self.translation,
        }
    }

    pub(super) fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }

    /// Followed by a rotation about z.
    pub(super) fn turned(&self, angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        let r = &self.rotation;
        let (x, y) = (r.column(0), r.column(1));
        Self {
            rotation: Matrix3::from_columns(&[
                x * cos + y * sin,
                y * cos - x * sin,
                r.column(2).into_owned(),
            ]),
            translation: self.translation,
        }
    }

    /// Followed by a translation along z.
    pub(super) fn slid(&self, distance: f64) -> Self {
        Self {
            rotation: self.rotation,
            translation: self.translation + self.rotation.column(2) * distance,
        }
    }

    pub(super) fn to_isometry(self) -> Isometry3<f64> {
        let rotation = Rotation3::from_matrix_unchecked(self.rotation);
        Isometry3::from_parts(
            Translation3::from(self.translation),
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    }
}

/// Rotation that takes z to the unit vector `axis`; exact for the axes of the frame.
pub(super) fn z_onto(axis: &Vector3<f64>) -> Matrix3<f64> {
    if *axis == Vector3::z() {
        return Matrix3::identity();
    }
    let mut helper = Vector3::zeros();
    helper[axis.iamin()] = 1.0;
    let x = helper.cross(axis).normalize();
    Matrix3::from_columns(&[x, axis.cross(&x), *axis])
}
