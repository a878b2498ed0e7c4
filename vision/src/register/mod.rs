//! Where the cameras stand in the laboratory: registration to the arm.
//!
//! The arm carries a point (the needle's tip, a ball) or a calibration board to known flange
//! poses and both cameras look. Points need \[Kabsch1976\], a board the hand-eye equation
//! AX = XB \[Park1994\]; the start is closed-form, the result the most likely one under errors of
//! corners and arm. The calibration's covariance is carried through, refraction included.

mod file;
mod measure;
mod solve;
mod start;

pub use file::{
    PoseEntry, PosesFile, RegistrationFile, TargetEntry, read_poses, read_registration,
};
pub use solve::{assumed_calibration, register};
pub use start::kabsch;

use hal::frame::{Flange, LeftCamera, World};
use hal::{Position, Transform};
use nalgebra::{Isometry3, Matrix3, Matrix3x6, Matrix6, Point2, Point3};

use crate::calibrate::Board;
use crate::camera::NoPoint;

/// What the arm shows to the cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// A point whose place on the flange is known \[m\].
    KnownPoint(Point3<f64>),
    /// A point fixed to the flange somewhere: its place is estimated too.
    Point,
    /// A board fixed to the flange somewhere: its pose is estimated too.
    Board(Board),
}

/// One pose of the arm and what both cameras saw.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedPose {
    /// What the pose is called in messages.
    pub name: String,
    /// The flange, from the arm's encoders.
    pub world_from_flange: Transform<World, Flange>,
    /// The point, or the board's corners row-major, in the left image \[px\].
    pub left: Vec<Point2<f64>>,
    /// The same in the right image \[px\].
    pub right: Vec<Point2<f64>>,
}

/// Assumed errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegistrationOptions {
    /// Standard deviation of an observed pixel, per axis \[px\].
    pub pixel_sigma_px: f64,
    /// Standard deviation of the flange's position, per axis \[m\].
    pub arm_position_sigma: f64,
    /// Standard deviation of the flange's orientation, per axis \[rad\].
    pub arm_rotation_sigma: f64,
}

impl Default for RegistrationOptions {
    fn default() -> Self {
        // An industrial arm's kinematics without calibration of its own.
        Self {
            pixel_sigma_px: 0.15,
            arm_position_sigma: 0.1e-3,
            arm_rotation_sigma: 0.5e-3,
        }
    }
}

/// The cameras in the laboratory.
#[derive(Clone, Debug)]
pub struct Registration {
    /// Takes the left camera's coordinates to World.
    pub world_from_left_camera: Transform<World, LeftCamera>,
    /// Covariance of its translation \[m\] and rotation \[rad\] along World's axes, from
    /// corners, arm and (where its covariance was given) calibration.
    pub covariance: Matrix6<f64>,
    /// The part of it that corners and arm account for; more poses reduce only this.
    pub covariance_of_poses: Matrix6<f64>,
    /// The target on the flange: for points the identity rotation.
    pub flange_from_target: Isometry3<f64>,
    /// Residual of each pose: distance of its target (a board's: of its origin) \[m\].
    pub residuals: Vec<f64>,
    /// Fiducial registration error: RMS of the residuals \[m\].
    pub fre: f64,
    /// Weighted squared residuals over their degrees of freedom: about 1 when the assumed
    /// errors are right. Above 1 the covariance has been scaled by it.
    pub chi2_per_freedom: f64,
    /// RMS over all poses of the residual between the two images \[px\].
    pub epipolar_rms_px: f64,
}

impl Registration {
    /// Predicted covariance of where the registration puts a point \[m2\]; the square root of
    /// its trace is the predicted target registration error \[Fitzpatrick1998\].
    pub fn target_covariance(&self, point: &Position<LeftCamera>) -> Matrix3<f64> {
        let arm = self.world_from_left_camera.rotate(&point.coords());
        let mut j = Matrix3x6::zeros();
        j.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        j.fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&-arm.cross_matrix());
        j * self.covariance * j.transpose()
    }

    /// Predicted target registration error: root mean square distance \[m\].
    pub fn predicted_tre(&self, point: &Position<LeftCamera>) -> f64 {
        self.target_covariance(point).trace().sqrt()
    }
}

/// Why there is no registration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RegistrationError {
    /// Fewer poses than the unknowns need.
    #[error("{poses} poses, at least {needed} are needed")]
    TooFewPoses {
        /// Poses given.
        poses: usize,
        /// Poses needed.
        needed: usize,
    },
    /// A pose without the target's pixels.
    #[error("pose {pose}: {left} left and {right} right pixels, the target has {expected}")]
    PixelCount {
        /// The pose.
        pose: String,
        /// Left pixels.
        left: usize,
        /// Right pixels.
        right: usize,
        /// Points of the target.
        expected: usize,
    },
    /// Two pixels that give no point.
    #[error("pose {pose}: {source}")]
    NoPoint {
        /// The pose.
        pose: String,
        /// Why.
        source: NoPoint,
    },
    /// A board that cannot be placed.
    #[error("pose {pose}: the corners give no board pose")]
    NoBoardPose {
        /// The pose.
        pose: String,
    },
    /// Both images contradict the calibration.
    #[error(
        "left and right pixels disagree by {rms_px:.1} px RMS: this is the calibration of other \
         cameras, or they have moved (or left and right are exchanged)"
    )]
    OtherCalibration {
        /// Residual between the two images.
        rms_px: f64,
    },
    /// The poses do not determine the registration.
    #[error("the poses do not determine the registration: {hint}")]
    Degenerate {
        /// What would help.
        hint: &'static str,
    },
    /// An assumed error is not positive.
    #[error("assumed errors must be positive: {pixel_sigma_px} px, {arm_m} m, {arm_rad} rad")]
    Sigmas {
        /// Of a pixel.
        pixel_sigma_px: f64,
        /// Of the flange's position.
        arm_m: f64,
        /// Of its orientation.
        arm_rad: f64,
    },
}
