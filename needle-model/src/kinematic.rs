//! Kinematic models of the tip: the needle follows its tip's path exactly. For baselines and duty
//! cycling; \[Webster2006\], R. J. Webster et al., Nonholonomic modeling of needle steering.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use thiserror::Error;

use crate::predictive::{Prediction, PredictionError};

/// Where the tip will be, for a bevel fraction held from now on.
pub trait TipPath {
    /// Why it cannot say.
    type Error;

    /// Position of O in World \[m\] after `distance` \[m\] of insertion with the bevel fraction `bevel`
    /// (|bevel| <= 1: direction and strength of the mean steering, in x and y of the model's frame).
    ///
    /// # Errors
    /// The model's own.
    fn tip_after(&self, distance: f64, bevel: Vector2<f64>) -> Result<Vector3<f64>, Self::Error>;
}

/// A kinematic model was given a value out of range.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error("kinematic model: {name} out of range, got {value}")]
pub struct KinematicError {
    /// Name of the value.
    pub name: &'static str,
    /// Offending value, in SI units.
    pub value: f64,
}

/// Effective curvature under duty cycling \[1/m\]: Eq. (21).
///
/// `natural`: natural curvature \[1/m\]; `duty_cycle` in \[0, 1\], 0 for insertion only.
pub const fn effective_curvature(natural: f64, duty_cycle: f64) -> f64 {
    natural * (1.0 - duty_cycle)
}

/// Natural curvature \[1/m\] of the steady path of a needle of bending stiffness `ei` \[N m2\] that
/// cuts at the angle `gamma` \[rad\] in tissue of stiffness per length `k_t` \[N/m2\]: 2 gamma / lambda
/// with lambda = (4 EI / K_T)^(1/4).
pub fn natural_curvature(ei: f64, k_t: f64, gamma: f64) -> f64 {
    2.0 * gamma * (k_t / (4.0 * ei)).powf(0.25)
}

/// The tip as a unicycle, or a bicycle when the wheel base is not 0.
///
/// The tip frame's z is the heading; a fresh cut bends towards -y (the bevel direction). The bicycle
/// has its front wheel at the tip, `wheel_base` ahead of the back wheel, which follows; its path is
/// that of the back wheel moved ahead along the heading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KinematicTip {
    world_from_tip: Isometry3<f64>,
    curvature: f64,
    wheel_base: f64,
}

impl KinematicTip {
    /// A unicycle at `world_from_tip` with the natural `curvature` \[1/m\].
    ///
    /// # Errors
    /// [`KinematicError`] unless `curvature` is finite and not negative and the pose finite.
    pub fn unicycle(
        world_from_tip: Isometry3<f64>,
        curvature: f64,
    ) -> Result<Self, KinematicError> {
        Self::bicycle(world_from_tip, curvature, 0.0)
    }

    /// A bicycle; see [`KinematicTip::unicycle`]. `curvature` is that of the back wheel's path,
    /// tan(steering angle) / `wheel_base` \[m\].
    ///
    /// # Errors
    /// [`KinematicError`] unless all is finite, `curvature` and `wheel_base` not negative.
    pub fn bicycle(
        world_from_tip: Isometry3<f64>,
        curvature: f64,
        wheel_base: f64,
    ) -> Result<Self, KinematicError> {
        for (name, value) in [("curvature", curvature), ("wheel_base", wheel_base)] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(KinematicError { name, value });
            }
        }
        let pose = &world_from_tip;
        let sum = pose.translation.vector.sum() + pose.rotation.coords.sum();
        if !sum.is_finite() {
            return Err(KinematicError {
                name: "world_from_tip",
                value: sum,
            });
        }
        Ok(Self {
            world_from_tip,
            curvature,
            wheel_base,
        })
    }

    /// Pose of the tip frame in World.
    pub const fn world_from_tip(&self) -> &Isometry3<f64> {
        &self.world_from_tip
    }

    /// Natural curvature \[1/m\].
    pub const fn curvature(&self) -> f64 {
        self.curvature
    }

    /// Moves on by `distance` \[m\] of the back wheel on an arc of the natural curvature times
    /// 1 - `duty_cycle` (clamped to \[0, 1\]) while turning by `roll` \[rad\] about the axis, exactly:
    /// a screw, helical when both turn.
    ///
    /// # Errors
    /// [`KinematicError`] for values that are not finite.
    pub fn advance(
        &mut self,
        distance: f64,
        roll: f64,
        duty_cycle: f64,
    ) -> Result<(), KinematicError> {
        for (name, value) in [
            ("distance", distance),
            ("roll", roll),
            ("duty_cycle", duty_cycle),
        ] {
            if !value.is_finite() {
                return Err(KinematicError { name, value });
            }
        }
        let curvature = effective_curvature(self.curvature, duty_cycle.clamp(0.0, 1.0));
        // Heading turns towards -y: rotation about +x.
        let turn = Vector3::new(curvature * distance, 0.0, roll);
        let ahead = Translation3::new(0.0, 0.0, self.wheel_base);
        let behind = Translation3::new(0.0, 0.0, -self.wheel_base);
        self.world_from_tip *= behind * screw(distance, &turn) * ahead;
        Ok(())
    }
}

impl TipPath for KinematicTip {
    type Error = KinematicError;

    fn tip_after(
        &self,
        distance: f64,
        bevel: Vector2<f64>,
    ) -> Result<Vector3<f64>, KinematicError> {
        let strength = bevel.norm();
        if !(strength <= 1.0 + 1e-9) {
            return Err(KinematicError {
                name: "bevel",
                value: strength,
            });
        }
        // Turn the frame so that -y is the wanted direction; the duty cycle does the rest.
        let azimuth = if strength > 0.0 {
            bevel.x.atan2(-bevel.y)
        } else {
            0.0
        };
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), azimuth);
        let mut tip = Self {
            world_from_tip: self.world_from_tip * roll,
            ..*self
        };
        tip.advance(distance, 0.0, 1.0 - strength)?;
        Ok(tip.world_from_tip.translation.vector)
    }
}

impl TipPath for Prediction {
    type Error = PredictionError;

    fn tip_after(
        &self,
        distance: f64,
        bevel: Vector2<f64>,
    ) -> Result<Vector3<f64>, PredictionError> {
        let strength = bevel.norm();
        if !(strength <= 1.0 + 1e-9) {
            return Err(PredictionError::Value {
                name: "bevel",
                value: strength,
            });
        }
        let depth = self.depth() + distance;
        let rollout = self.roll_out(depth, 1.25e-3)?;
        let across = rollout.free + bevel * rollout.bevel;
        let entry = self.entry_depth();
        let point = nalgebra::Point3::new(across.x, across.y, entry + depth);
        Ok((self.world_from_frame() * point).coords)
    }
}

/// Motion along z by `distance` while turning by `turn` (a constant screw in the moving frame).
fn screw(distance: f64, turn: &Vector3<f64>) -> Isometry3<f64> {
    let angle = turn.norm();
    let v = Vector3::new(0.0, 0.0, distance);
    let (a, b) = if angle < 1e-4 {
        // Series: the next terms are angle^4 / 720 = 1e-19.
        (
            0.5 - angle * angle / 24.0,
            1.0 / 6.0 - angle * angle / 120.0,
        )
    } else {
        (
            (1.0 - angle.cos()) / (angle * angle),
            (angle - angle.sin()) / angle.powi(3),
        )
    };
    let turned = turn.cross(&v);
    let translation = v + turned * a + turn.cross(&turned) * b;
    Isometry3::from_parts(Translation3::from(translation), UnitQuaternion::new(*turn))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arc_has_its_radius_and_bends_in_the_bevel_direction() {
        let mut tip = KinematicTip::unicycle(Isometry3::identity(), 2.0).unwrap();
        let (r, angle) = (0.5, 0.16_f64);
        for _ in 0..8 {
            tip.advance(r * angle / 8.0, 0.0, 0.0).unwrap();
        }
        let expected = Vector3::new(0.0, -r * (1.0 - angle.cos()), r * angle.sin());
        assert!((tip.world_from_tip().translation.vector - expected).norm() < 1e-15);
        let once = tip_after(&KinematicTip::unicycle(Isometry3::identity(), 2.0).unwrap());
        assert!((once - expected).norm() < 1e-15);
    }

    fn tip_after(tip: &impl TipPath<Error = KinematicError>) -> Vector3<f64> {
        tip.tip_after(0.08, Vector2::new(0.0, -1.0)).unwrap()
    }

    #[test]
    fn fast_rotation_goes_straight_and_duty_cycle_is_linear() {
        let mut tip = KinematicTip::unicycle(Isometry3::identity(), 2.0).unwrap();
        tip.advance(0.08, 400.0 * std::f64::consts::TAU, 0.0)
            .unwrap();
        // A helix whose axis leaves at curvature / rate = 6.4e-5 rad: 5.1 um over 80 mm.
        let aside = tip.world_from_tip().translation.vector.xy().norm();
        assert!(aside < 6e-6, "{aside:e}");
        assert!((effective_curvature(2.0, 0.25) - 1.5).abs() < 1e-15);
        let half = KinematicTip::unicycle(Isometry3::identity(), 2.0).unwrap();
        let reach = half.tip_after(0.08, Vector2::new(0.5, 0.0)).unwrap().x;
        let expected = 1.0 - (0.08_f64).cos();
        assert!((reach - expected).abs() < 1e-12, "{reach} {expected}");
    }

    #[test]
    fn the_bicycle_wheel_cuts_the_corner() {
        let start = Isometry3::identity();
        let (l, k, s) = (5e-3, 2.0, 0.05);
        let mut front = KinematicTip::bicycle(start, k, l).unwrap();
        let back = Isometry3::translation(0.0, 0.0, -l);
        let mut back = KinematicTip::unicycle(back, k).unwrap();
        front.advance(s, 0.0, 0.0).unwrap();
        back.advance(s, 0.0, 0.0).unwrap();
        let ahead = back.world_from_tip() * nalgebra::Point3::new(0.0, 0.0, l);
        assert!((ahead.coords - front.world_from_tip().translation.vector).norm() < 1e-16);
        assert!(KinematicTip::bicycle(start, k, f64::NAN).is_err());
    }

    #[test]
    fn natural_curvature_of_the_biopsy_needle() {
        // 2 x 1.75 deg / 29.3 mm = 2.08 1/m at K_T = 1e4 N/m2.
        let k = natural_curvature(1.836e-3, 1e4, 1.75_f64.to_radians());
        assert!((k - 2.085).abs() < 5e-3, "{k}");
    }
}
