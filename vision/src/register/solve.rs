//! The most likely registration.

use hal::Transform;
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Point3, UnitQuaternion, Vector3};

use super::measure::{Measured, board, point};
use super::start::{hand_eye, kabsch, point_on_flange};
use super::{RecordedPose, Registration, RegistrationError, RegistrationOptions, Target};
use crate::calibrate::assumed_covariance;
use crate::camera::StereoRig;

/// Registers the cameras to the arm.
///
/// `rig` may hold the container when the poses were recorded through it; `calibration` is the
/// covariance of the rig's parameters, where it is known.
///
/// # Errors
/// See [`RegistrationError`].
pub fn register(
    rig: &StereoRig,
    calibration: Option<&DMatrix<f64>>,
    target: &Target,
    poses: &[RecordedPose],
    options: &RegistrationOptions,
) -> Result<Registration, RegistrationError> {
    check(target, poses, options)?;
    let seen = measure(rig, target, poses, options)?;
    let flange: Vec<_> = poses
        .iter()
        .map(|p| *p.world_from_flange.isometry())
        .collect();
    let mut state = start(target, &seen, &flange)?;
    let not_determined = || RegistrationError::Degenerate {
        hint: "turn the flange about more than one axis between poses",
    };
    for _ in 0..20 {
        let n = normal(&state, target, &seen, &flange, options).ok_or_else(not_determined)?;
        let factor = n
            .information
            .clone()
            .cholesky()
            .ok_or_else(not_determined)?;
        let step = factor.solve(&n.gradient);
        state = state.stepped(&step);
        if step.norm() < 1e-12 {
            break;
        }
    }
    let n = normal(&state, target, &seen, &flange, options).ok_or_else(not_determined)?;
    let factor = n
        .information
        .clone()
        .cholesky()
        .ok_or_else(not_determined)?;
    let unknowns = n.gradient.len();
    let chi2_per_freedom = n.chi2 / (n.rows.saturating_sub(unknowns)).max(1) as f64;
    let of_poses = factor.inverse() * chi2_per_freedom.max(1.0);
    let through = -factor.solve(&n.cross);
    let mut total = of_poses.clone();
    if let Some(c) = calibration.filter(|c| c.nrows() == through.ncols()) {
        total += &through * c * through.transpose();
    }
    let six = |m: &DMatrix<f64>| m.fixed_view::<6, 6>(0, 0).into_owned();
    let sigma = total.fixed_view::<6, 6>(0, 0).diagonal().map(f64::sqrt);
    // A tenth of a radian or of a metre is no registration.
    if sigma.amax().is_nan() || sigma.amax() > 0.1 {
        return Err(not_determined());
    }
    let count = n.distances.len() as f64;
    let (square, freedom) = epipolar(&seen);
    Ok(Registration {
        world_from_left_camera: Transform::assume(state.world_from_left),
        covariance: six(&total),
        covariance_of_poses: six(&of_poses),
        flange_from_target: state.flange_from_target,
        fre: (n.distances.iter().map(|d| d * d).sum::<f64>() / count).sqrt(),
        residuals: n.distances,
        chi2_per_freedom,
        epipolar_rms_px: (square / freedom).sqrt(),
    })
}

/// Covariance of an ordinary calibration of `rig` by boards where the poses' targets were seen, their
/// corners as exact as the poses' pixels, for [`register`] where the calibration's own is not known.
///
/// # Errors
/// As [`register`], where the poses cannot be measured.
pub fn assumed_calibration(
    rig: &StereoRig,
    target: &Target,
    poses: &[RecordedPose],
    options: &RegistrationOptions,
) -> Result<Option<DMatrix<f64>>, RegistrationError> {
    check(target, poses, options)?;
    let seen = measure(rig, target, poses, options)?;
    let sum: Vector3<f64> = seen
        .iter()
        .map(|m| m.left_from_target.translation.vector)
        .sum();
    let centre = Point3::from(sum / seen.len().max(1) as f64);
    Ok(assumed_covariance(rig, &centre, options.pixel_sigma_px))
}

fn check(
    target: &Target,
    poses: &[RecordedPose],
    options: &RegistrationOptions,
) -> Result<(), RegistrationError> {
    let o = options;
    let positive = |s: f64| s > 0.0 && s.is_finite();
    if !(positive(o.pixel_sigma_px)
        && positive(o.arm_position_sigma)
        && positive(o.arm_rotation_sigma))
    {
        return Err(RegistrationError::Sigmas {
            pixel_sigma_px: o.pixel_sigma_px,
            arm_m: o.arm_position_sigma,
            arm_rad: o.arm_rotation_sigma,
        });
    }
    let (needed, expected) = match target {
        Target::KnownPoint(_) => (3, 1),
        Target::Point => (6, 1),
        Target::Board(b) => (3, b.size.count()),
    };
    if poses.len() < needed {
        return Err(RegistrationError::TooFewPoses {
            poses: poses.len(),
            needed,
        });
    }
    for p in poses {
        if p.left.len() != expected || p.right.len() != expected {
            return Err(RegistrationError::PixelCount {
                pose: p.name.clone(),
                left: p.left.len(),
                right: p.right.len(),
                expected,
            });
        }
    }
    Ok(())
}

fn measure(
    rig: &StereoRig,
    target: &Target,
    poses: &[RecordedPose],
    options: &RegistrationOptions,
) -> Result<Vec<Measured>, RegistrationError> {
    let mut seen = Vec::with_capacity(poses.len());
    for pose in poses {
        let no_point = |source| RegistrationError::NoPoint {
            pose: pose.name.clone(),
            source,
        };
        let sigma = options.pixel_sigma_px;
        let one = match target {
            Target::KnownPoint(_) | Target::Point => {
                point(rig, [pose.left[0], pose.right[0]], sigma).map_err(no_point)?
            }
            Target::Board(b) => board(rig, &b.points(), [&pose.left, &pose.right], sigma)
                .map_err(no_point)?
                .ok_or_else(|| RegistrationError::NoBoardPose {
                    pose: pose.name.clone(),
                })?,
        };
        seen.push(one);
    }
    let (square, freedom) = epipolar(&seen);
    let rms_px = (square / freedom).sqrt();
    // Two pixels, or twenty of the assumed sigmas: no error of a corner is that large.
    if rms_px.is_nan() || rms_px > 2.0_f64.max(20.0 * options.pixel_sigma_px) {
        return Err(RegistrationError::OtherCalibration { rms_px });
    }
    Ok(seen)
}

fn epipolar(seen: &[Measured]) -> (f64, f64) {
    let square = seen.iter().map(|m| m.square_px).sum();
    let freedom: usize = seen.iter().map(|m| m.freedom).sum();
    (square, freedom.max(1) as f64)
}

/// What is estimated.
#[derive(Clone, Debug)]
struct State {
    world_from_left: Isometry3<f64>,
    flange_from_target: Isometry3<f64>,
}

fn start(
    target: &Target,
    seen: &[Measured],
    flange: &[Isometry3<f64>],
) -> Result<State, RegistrationError> {
    let degenerate = |hint| move || RegistrationError::Degenerate { hint };
    let places = || seen.iter().map(|m| m.left_from_target.translation.vector);
    match target {
        Target::KnownPoint(p) => {
            let from: Vec<_> = places().map(Point3::from).collect();
            let to: Vec<_> = flange.iter().map(|f| f * p).collect();
            let world_from_left = kabsch(&from, &to).ok_or_else(degenerate(
                "bring the point to places that are not on a line",
            ))?;
            Ok(State {
                world_from_left,
                flange_from_target: Isometry3::from_parts(
                    p.coords.into(),
                    UnitQuaternion::identity(),
                ),
            })
        }
        Target::Point => {
            let from: Vec<_> = places().collect();
            let (world_from_left, p) = point_on_flange(&from, flange).ok_or_else(degenerate(
                "turn the flange between poses, about several axes",
            ))?;
            Ok(State {
                world_from_left,
                flange_from_target: Isometry3::from_parts(p.into(), UnitQuaternion::identity()),
            })
        }
        Target::Board(_) => {
            let from: Vec<_> = seen.iter().map(|m| m.left_from_target).collect();
            let (world_from_left, flange_from_target) = hand_eye(&from, flange).ok_or_else(
                degenerate("turn the flange about at least two axes between poses"),
            )?;
            Ok(State {
                world_from_left,
                flange_from_target,
            })
        }
    }
}

impl State {
    /// Six unknowns of the cameras, then none, three or six of the target.
    fn stepped(&self, step: &DVector<f64>) -> Self {
        let moved = |pose: &Isometry3<f64>, at: usize| {
            let three = |k: usize| {
                step.as_slice()
                    .get(k..k + 3)
                    .map_or_else(Vector3::zeros, Vector3::from_column_slice)
            };
            Isometry3::from_parts(
                (pose.translation.vector + three(at)).into(),
                UnitQuaternion::from_scaled_axis(three(at + 3)) * pose.rotation,
            )
        };
        Self {
            world_from_left: moved(&self.world_from_left, 0),
            flange_from_target: moved(&self.flange_from_target, 6),
        }
    }
}

struct Normal {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
    cross: DMatrix<f64>,
    chi2: f64,
    rows: usize,
    distances: Vec<f64>,
}

/// Normal equations of "where the cameras see the target is where the arm holds it", in World.
fn normal(
    state: &State,
    target: &Target,
    seen: &[Measured],
    flange: &[Isometry3<f64>],
    options: &RegistrationOptions,
) -> Option<Normal> {
    let rows = if matches!(target, Target::Board(_)) {
        6
    } else {
        3
    };
    let unknowns = match target {
        Target::KnownPoint(_) => 6,
        Target::Point => 9,
        Target::Board(_) => 12,
    };
    let mut n = Normal {
        information: DMatrix::zeros(unknowns, unknowns),
        gradient: DVector::zeros(unknowns),
        cross: DMatrix::zeros(
            unknowns,
            seen.first().map_or(0, |m| m.by_calibration.ncols()),
        ),
        chi2: 0.0,
        rows: rows * seen.len(),
        distances: Vec::with_capacity(seen.len()),
    };
    let x = &state.world_from_left;
    let rx: Matrix3<f64> = *x.rotation.to_rotation_matrix().matrix();
    for (m, f) in seen.iter().zip(flange) {
        let rf: Matrix3<f64> = *f.rotation.to_rotation_matrix().matrix();
        let by_cameras = x * m.left_from_target;
        let by_arm = f * state.flange_from_target;
        let gap = by_arm.translation.vector - by_cameras.translation.vector;
        let mut r = DVector::zeros(rows);
        r.rows_mut(0, 3).copy_from(&gap);
        let seen_arm = x.rotation * m.left_from_target.translation.vector;
        let held_arm = f.rotation * state.flange_from_target.translation.vector;
        let mut j = DMatrix::zeros(rows, unknowns);
        j.view_mut((0, 0), (3, 3)).fill_with_identity();
        j.view_mut((0, 3), (3, 3))
            .copy_from(&-seen_arm.cross_matrix());
        if unknowns > 6 {
            j.view_mut((0, 6), (3, 3)).copy_from(&-rf);
        }
        let mut turn = DMatrix::zeros(rows, rows);
        turn.view_mut((0, 0), (3, 3)).copy_from(&rx);
        let (sp, sr) = (options.arm_position_sigma, options.arm_rotation_sigma);
        // An error of the flange's orientation moves what it holds.
        let lever = held_arm.cross_matrix();
        let mut arm = DMatrix::zeros(rows, rows);
        let place = Matrix3::identity() * (sp * sp) + lever * lever.transpose() * (sr * sr);
        arm.view_mut((0, 0), (3, 3)).copy_from(&place);
        if rows == 6 {
            let twist = (by_arm.rotation * by_cameras.rotation.inverse()).scaled_axis();
            r.rows_mut(3, 3).copy_from(&twist);
            j.view_mut((3, 3), (3, 3)).fill_with_identity();
            j.view_mut((3, 9), (3, 3)).copy_from(&-rf);
            turn.view_mut((3, 3), (3, 3)).copy_from(&rx);
            arm.view_mut((3, 3), (3, 3))
                .copy_from(&(Matrix3::identity() * (sr * sr)));
            let mixed = -lever * (sr * sr);
            arm.view_mut((0, 3), (3, 3)).copy_from(&mixed);
            arm.view_mut((3, 0), (3, 3)).copy_from(&mixed.transpose());
        }
        let covariance = &turn * &m.covariance * turn.transpose() + arm;
        let factor = covariance.cholesky()?;
        let weighted = factor.solve(&j);
        n.information += j.transpose() * &weighted;
        n.gradient += weighted.transpose() * &r;
        n.cross += weighted.transpose() * &turn * &m.by_calibration;
        n.chi2 += r.dot(&factor.solve(&r));
        n.distances.push(gap.norm());
    }
    Some(n)
}
