//! Motion of the tissue: breathing, drift, shear.

use nalgebra::{Matrix3, Vector3};

use crate::settings::MotionSettings;

/// Where the tissue is at an instant: phantom = `deformation` * material + `shift`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placement {
    deformation: Matrix3<f64>,
    inverse: Matrix3<f64>,
    shift: Vector3<f64>,
}

impl Placement {
    pub(crate) fn at_rest() -> Self {
        Self {
            deformation: Matrix3::identity(),
            inverse: Matrix3::identity(),
            shift: Vector3::zeros(),
        }
    }

    /// The placement `seconds` after the start.
    pub(crate) fn at(settings: &MotionSettings, seconds: f64) -> Self {
        let direction = Vector3::from(settings.breathing_direction);
        let size = direction.norm();
        let direction = if size > 0.0 {
            direction / size
        } else {
            Vector3::zeros()
        };
        let phase = core::f64::consts::PI * settings.breathing_hz * seconds
            + settings.breathing_phase_deg.to_radians();
        // Lujan's model of breathing, cos^4, as a displacement from its value at the start.
        let start = settings.breathing_phase_deg.to_radians().cos().powi(4);
        let breath = settings.breathing_mm * 1e-3 * (start - phase.cos().powi(4));
        let drift = Vector3::from(settings.drift_mm_min) * (1e-3 / 60.0 * seconds);
        let rotation = settings.rotation_deg_min.to_radians() / 60.0 * seconds;
        let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), rotation);
        // The motion of breathing fades with depth: an affine shear.
        let fading = -settings.breathing_fade_1_m * breath;
        let deformation =
            turn.matrix() * (Matrix3::identity() + direction * Vector3::z().transpose() * fading);
        Self {
            deformation,
            inverse: deformation.try_inverse().unwrap_or_else(Matrix3::identity),
            shift: direction * breath + drift,
        }
    }

    pub(crate) fn phantom_of(&self, material: &Vector3<f64>) -> Vector3<f64> {
        self.deformation * material + self.shift
    }

    pub(crate) fn material_of(&self, phantom: &Vector3<f64>) -> Vector3<f64> {
        self.inverse * (phantom - self.shift)
    }
}

impl MotionSettings {
    /// Whether the tissue moves at all.
    pub(crate) fn moves(&self) -> bool {
        self.breathing_mm != 0.0
            || self.rotation_deg_min != 0.0
            || self.drift_mm_min.iter().any(|x| *x != 0.0)
    }
}
