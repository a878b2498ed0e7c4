//! A point from its two images.

use hal::Position;
use hal::frame::LeftCamera;
use nalgebra::{Matrix2, Matrix3, Point3, Vector3};

use super::{DistortedPx, Ray, View};

/// A reconstructed point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangulated {
    /// The point in the stereo frame \[m\].
    pub position: Position<LeftCamera>,
    /// Covariance from the pixels' covariances (not from the calibration's) \[m2\].
    pub covariance: Matrix3<f64>,
    /// Squared residual in units of the pixels' covariances: chi-square with one degree of
    /// freedom when both pixels show the same point.
    pub misfit: f64,
}

/// Two pixels that give no point.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoPoint {
    /// A pixel to which no ray belongs: the distortion folds there, or the ray misses the window.
    #[error("pixel ({x_px}, {y_px}) belongs to no ray")]
    NoRay {
        /// Column.
        x_px: f64,
        /// Row.
        y_px: f64,
    },
    /// The rays are parallel or meet behind a camera.
    #[error("the two rays do not meet in front of the cameras (angle {angle_rad} rad)")]
    NoMeeting {
        /// Angle between the rays.
        angle_rad: f64,
    },
    /// A covariance is not positive definite.
    #[error("a pixel covariance is not positive definite")]
    Covariance,
}

/// The most likely point for a pixel in each view with Gaussian errors of the given covariances
/// \[px2\]: the midpoint of the refracted rays, then Gauss-Newton on the reprojection errors.
///
/// # Errors
/// No ray belongs to a pixel, the rays do not meet in front of the cameras, or a covariance is
/// not positive definite.
pub fn triangulate(
    views: &[View; 2],
    pixels: &[DistortedPx; 2],
    covariances: &[Matrix2<f64>; 2],
) -> Result<Triangulated, NoPoint> {
    let ray = |k: usize| {
        views[k].ray(pixels[k]).ok_or(NoPoint::NoRay {
            x_px: pixels[k].0.x,
            y_px: pixels[k].0.y,
        })
    };
    let (left, right) = (ray(0)?, ray(1)?);
    let mut point = midpoint(&left, &right)?;
    let mut weights = [Matrix2::zeros(); 2];
    for k in 0..2 {
        weights[k] = covariances[k]
            .cholesky()
            .ok_or(NoPoint::Covariance)?
            .inverse();
    }
    let unseen = || NoPoint::NoMeeting {
        angle_rad: angle(&left, &right),
    };
    // The midpoint is right to first order; the second step is already below 1e-9 px.
    for _ in 0..3 {
        let (information, gradient, _) =
            normal_equations(views, pixels, &weights, &point).ok_or_else(unseen)?;
        let step = information.cholesky().ok_or_else(unseen)?.solve(&gradient);
        point += step;
        if step.norm_squared() < 1e-22 {
            break;
        }
    }
    let (information, _, misfit) =
        normal_equations(views, pixels, &weights, &point).ok_or_else(unseen)?;
    Ok(Triangulated {
        position: Position::new(Point3::from(point)),
        covariance: information.cholesky().ok_or_else(unseen)?.inverse(),
        misfit,
    })
}

fn normal_equations(
    views: &[View; 2],
    pixels: &[DistortedPx; 2],
    weights: &[Matrix2<f64>; 2],
    point: &Vector3<f64>,
) -> Option<(Matrix3<f64>, Vector3<f64>, f64)> {
    let mut information = Matrix3::zeros();
    let mut gradient = Vector3::zeros();
    let mut misfit = 0.0;
    for k in 0..2 {
        let (px, j) = views[k].project_with_derivative(point)?;
        let e = pixels[k].0 - px.0;
        let jw = j.transpose() * weights[k];
        information += jw * j;
        gradient += jw * e;
        misfit += e.dot(&(weights[k] * e));
    }
    Some((information, gradient, misfit))
}

/// The point nearest to both rays.
fn midpoint(a: &Ray, b: &Ray) -> Result<Vector3<f64>, NoPoint> {
    let between = b.origin - a.origin;
    let cos = a.direction.dot(&b.direction);
    let sin2 = a.direction.cross(&b.direction).norm_squared();
    let (da, db) = (between.dot(&a.direction), between.dot(&b.direction));
    let (s, t) = ((da - cos * db) / sin2, (cos * da - db) / sin2);
    // Rays less than 1e-6 rad apart say nothing about depth.
    if sin2 > 1e-12 && s.is_finite() && t.is_finite() && s > 0.0 && t > 0.0 {
        Ok((a.origin + a.direction * s + b.origin + b.direction * t) / 2.0)
    } else {
        Err(NoPoint::NoMeeting {
            angle_rad: angle(a, b),
        })
    }
}

fn angle(a: &Ray, b: &Ray) -> f64 {
    a.direction
        .cross(&b.direction)
        .norm()
        .atan2(a.direction.dot(&b.direction))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Container, Distortion, FlatWindow, StereoRig};
    use hal::Transform;
    use nalgebra::{Isometry3, Unit};

    /// The laboratory's rig: 0.5 m away, 90 degrees apart, each camera square to its wall.
    fn rig() -> StereoRig {
        let camera = Camera {
            width: 640,
            height: 480,
            fx: 2000.0,
            fy: 2000.0,
            cx: 319.5,
            cy: 239.5,
            distortion: Distortion::from_array([-0.1, 0.05, 0.001, -0.0005, 0.0]),
        };
        let turn = Isometry3::rotation(Vector3::y() * core::f64::consts::FRAC_PI_2);
        let centre = Isometry3::translation(0.0, 0.0, 0.5);
        let window = FlatWindow {
            normal: Unit::new_normalize(Vector3::new(0.0, 0.0, 1.0)),
            distance: 0.447,
            thickness: 0.003,
            wall_index: 1.49,
            gel_index: 1.34,
        };
        StereoRig {
            left: camera,
            right: camera,
            right_from_left: Transform::assume(centre * turn * centre.inverse()),
            container: Some(Container {
                left: window,
                right: window,
            }),
        }
    }

    fn volume() -> impl Iterator<Item = Vector3<f64>> {
        let steps = [-0.02, -0.01, 0.0, 0.01, 0.02];
        steps.into_iter().flat_map(move |x| {
            steps
                .into_iter()
                .flat_map(move |y| steps.into_iter().map(move |z| Vector3::new(x, y, 0.5 + z)))
        })
    }

    #[test]
    fn modelled_refraction_leaves_nothing_and_ignored_refraction_most_of_a_millimetre() {
        let rig = rig();
        let (views, air) = (rig.views(), rig.with_container(None).views());
        let unit = [Matrix2::identity(); 2];
        let (mut square, mut worst, mut count) = (0.0_f64, 0.0_f64, 0.0);
        for p in volume() {
            let px = [views[0].project(&p).unwrap(), views[1].project(&p).unwrap()];
            let with = triangulate(&views, &px, &unit).unwrap();
            assert!((with.position.coords() - p).norm() < 1e-10);
            assert!(with.misfit < 1e-12);
            let without = triangulate(&air, &px, &unit).unwrap();
            let e = (without.position.coords() - p).norm();
            square += e * e;
            worst = worst.max(e);
            count += 1.0;
        }
        let rms = (square / count).sqrt();
        println!("ignored refraction: rms {rms:e} m, worst {worst:e} m");
        assert!(rms > 3e-4, "{rms}");
    }

    #[test]
    fn covariance_is_that_of_repeated_reconstructions() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};
        let rig = rig();
        let views = rig.views();
        let p = Vector3::new(0.01, -0.02, 0.51);
        let px = [views[0].project(&p).unwrap(), views[1].project(&p).unwrap()];
        let sigmas = [0.2, 0.1];
        let cov = [
            Matrix2::identity() * sigmas[0] * sigmas[0],
            Matrix2::identity() * sigmas[1] * sigmas[1],
        ];
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut noise = |s: f64| -> f64 {
            let z: f64 = StandardNormal.sample(&mut rng);
            s * z
        };
        let n = 4000;
        let (mut sample, mut stated, mut misfit) = (Matrix3::zeros(), Matrix3::zeros(), 0.0);
        for _ in 0..n {
            let mut q = px;
            for k in 0..2 {
                q[k].0.x += noise(sigmas[k]);
                q[k].0.y += noise(sigmas[k]);
            }
            let t = triangulate(&views, &q, &cov).unwrap();
            let e = t.position.coords() - p;
            sample += e * e.transpose() / f64::from(n);
            stated = t.covariance;
            misfit += t.misfit / f64::from(n);
        }
        // Sampling error of a covariance from 4000: 2.2 % (1 sigma).
        assert!((sample - stated).norm() < 0.1 * stated.norm());
        assert!((misfit - 1.0).abs() < 0.1, "{misfit}");
    }

    #[test]
    fn rays_that_do_not_meet_are_an_error() {
        let mut rig = rig().with_container(None);
        rig.right_from_left = Transform::assume(Isometry3::translation(-0.1, 0.0, 0.0));
        let views = rig.views();
        let unit = [Matrix2::identity(); 2];
        let c = DistortedPx::new(319.5, 239.5);
        let parallel = triangulate(&views, &[c, c], &unit);
        assert!(matches!(parallel, Err(NoPoint::NoMeeting { .. })));
        let behind = triangulate(&views, &[c, DistortedPx::new(400.0, 239.5)], &unit);
        assert!(matches!(behind, Err(NoPoint::NoMeeting { .. })));
        let nan = triangulate(&views, &[c, DistortedPx::new(f64::NAN, 0.0)], &unit);
        assert!(matches!(nan, Err(NoPoint::NoRay { .. })));
    }
}
