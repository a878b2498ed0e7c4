//! Errors of a calibration: drawn from the covariance they are said to come from.

use nalgebra::{Matrix3, Point3, Vector3};

use super::scene::{rig, world_from_phantom};
use crate::camera::calibration::given;
use crate::camera::{
    CalibrationSettings, CameraSettings, RigParameters, Side, StereoRig, Through, Undetermined,
    calibration_sigma,
};

fn calibrated(corner_sigma_px: f64) -> CameraSettings {
    CameraSettings {
        width_px: 640,
        calibration: CalibrationSettings {
            corner_sigma_px,
            ..CalibrationSettings::default()
        },
        ..CameraSettings::ideal()
    }
}

#[test]
fn a_perfect_calibration_gives_the_truth() {
    let rig = rig(&CameraSettings::ideal(), 9);
    assert_eq!(rig.given(), rig.truth());
}

#[test]
fn sigma_scales_with_the_corners_and_falls_with_views() {
    let truth = rig(&CameraSettings::ideal(), 0).truth().clone();
    let sigma = |corner_sigma_px, views| {
        let settings = CalibrationSettings {
            views,
            corner_sigma_px,
            ..CalibrationSettings::default()
        };
        calibration_sigma(&truth, &settings, 1).unwrap()
    };
    let one = sigma(0.1, 20);
    println!("20 views, 0.1 px: {one:?}");
    let double = sigma(0.2, 20);
    for (a, b) in one.lenses[0].iter().zip(&double.lenses[0]) {
        assert!((b / a - 2.0).abs() < 1e-6);
    }
    // Four times the views: half the error, but for the luck of the poses.
    let more = sigma(0.1, 80);
    let ratio = one.lenses[0][0] / more.lenses[0][0];
    assert!((1.4..2.9).contains(&ratio), "{ratio}");
}

#[test]
fn drawn_errors_have_the_calibrations_sigma() {
    let settings = calibrated(0.1);
    let truth = rig(&CameraSettings::ideal(), 0).truth().clone();
    let centre = Point3::new(0.4, 0.0, 0.2);
    let (mut drawn, mut expected) = ([0.0; 3], [0.0; 3]);
    let n = 150;
    for seed in 0..n {
        let given = given(&truth, &settings.calibration, &centre, seed)
            .unwrap()
            .parameters;
        let sigma = calibration_sigma(&truth, &settings.calibration, seed).unwrap();
        let shift = given.right_from_left.isometry().inverse() * truth.right_from_left.isometry();
        for (k, (e, s)) in [
            (given.left.fx - truth.left.fx, sigma.lenses[0][0]),
            (given.right.cy - truth.right.cy, sigma.lenses[1][3]),
            (shift.rotation.angle(), Vector3::from(sigma.rotation).norm()),
        ]
        .into_iter()
        .enumerate()
        {
            drawn[k] += e * e;
            expected[k] += s * s;
        }
    }
    for k in 0..3 {
        // A variance of 150 draws is known to 12 %, 1 sigma; the root to 6 %.
        let ratio = (drawn[k] / expected[k]).sqrt();
        assert!((0.8..1.2).contains(&ratio), "parameter {k}: {ratio}");
    }
}

/// Least-squares intersection of both cameras' rays through given pixels, in World.
fn triangulated(rig: &RigParameters, pixels: [[f64; 2]; 2]) -> Point3<f64> {
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for side in Side::BOTH {
        let ray = rig
            .view(side)
            .ray(pixels[side.index()], Through::Gel)
            .unwrap();
        let across = Matrix3::identity() - ray.direction * ray.direction.transpose();
        a += across;
        b += across * ray.origin.coords;
    }
    Point3::from(a.try_inverse().unwrap() * b)
}

#[test]
fn a_calibrations_errors_cancel_where_its_boards_were() {
    let n = 60;
    for (separation_deg, drift_mrad, bound) in [
        (90.0, 0.0, 0.02e-3),
        (30.0, 0.0, 0.02e-3),
        (90.0, 0.5, 0.05e-3),
        (30.0, 0.5, 0.12e-3),
    ] {
        let mut settings = CameraSettings {
            separation_deg,
            ..calibrated(0.1)
        };
        settings.calibration.drift_mrad = drift_mrad;
        let (mut fitted, mut optical) = (0.0, 0.0);
        for seed in 0..n {
            let rig = StereoRig::new(&settings, &world_from_phantom(), seed).unwrap();
            let place = Point3::new(0.008, -0.01, 0.08);
            let world = world_from_phantom() * place;
            let pixels = Side::BOTH.map(|s| {
                let view = rig.truth().view(s);
                view.project(&world, Through::Gel).unwrap()
            });
            let error = triangulated(rig.truth(), pixels) - world;
            assert!(error.norm() < 1e-11, "{error}");
            let given = triangulated(rig.given(), pixels);
            fitted += (given - world).norm_squared();
            let in_left = rig.given().left_from_world.isometry() * given;
            let true_left = rig.truth().left_from_world.isometry() * world;
            optical += (in_left - true_left).norm_squared();
        }
        let rms = |sum: f64| (sum / n as f64).sqrt();
        println!(
            "{separation_deg} deg, drift {drift_mrad} mrad: a point 80 mm deep {:.3} mm RMS in the fitted stereo frame, {:.3} mm in the optical one",
            1e3 * rms(fitted),
            1e3 * rms(optical)
        );
        assert!(rms(fitted) < bound && rms(fitted) < 0.5 * rms(optical));
    }
}

#[test]
fn boards_out_of_view_do_not_determine_a_calibration() {
    let settings = CameraSettings {
        width_px: 32,
        height_px: 32,
        focal_px: 20_000.0,
        calibration: CalibrationSettings {
            corner_sigma_px: 0.1,
            views: 3,
            ..CalibrationSettings::default()
        },
        ..CameraSettings::ideal()
    };
    let e = StereoRig::new(&settings, &world_from_phantom(), 1).unwrap_err();
    assert!(e.to_string().contains("3 views"), "{e}");
    let truth = rig(
        &CameraSettings {
            calibration: CalibrationSettings::default(),
            ..settings.clone()
        },
        1,
    )
    .truth()
    .clone();
    let e = calibration_sigma(&truth, &settings.calibration, 1);
    assert!(matches!(e, Err(Undetermined { views: 3, .. })));
}

#[test]
fn container_and_registration_are_misplaced_as_set() {
    let mut settings = CameraSettings::ideal();
    settings.calibration.container_mm = 0.2;
    settings.calibration.registration_mm = 0.5;
    settings.calibration.registration_deg = 0.1;
    let centre = Point3::new(0.4, 0.0, 0.2);
    let (mut walls, mut laboratory) = (0.0, 0.0);
    let n = 200;
    for seed in 0..n {
        let truth = rig(&CameraSettings::ideal(), seed).truth().clone();
        let given = given(&truth, &settings.calibration, &centre, seed)
            .unwrap()
            .parameters;
        assert_eq!(given.left, truth.left);
        let wall = |r: &RigParameters| r.container.left_wall.point.coords();
        walls += (wall(&given) - wall(&truth)).norm_squared();
        let entry = world_from_phantom() * Point3::origin();
        let at = |r: &RigParameters| r.left_from_world.isometry() * entry;
        laboratory += (at(&given) - at(&truth)).norm_squared();
    }
    // Three axes; 600 numbers know a sigma to 3 %.
    let rms = |sum: f64| 1e3 * (sum / n as f64 / 3.0).sqrt();
    assert!((rms(walls) / 0.2 - 1.0).abs() < 0.1, "{}", rms(walls));
    assert!(
        (rms(laboratory) / 0.5 - 1.0).abs() < 0.1,
        "{}",
        rms(laboratory)
    );
}
