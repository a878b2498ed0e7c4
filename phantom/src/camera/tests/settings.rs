//! Bad settings are refused with their range.

use super::scene::{rig, world_from_phantom};
use crate::SettingsError;
use crate::camera::{CameraSettings, RigError, StereoRig};

struct Refused {
    text: String,
    key: &'static str,
    value: f64,
    lowest: f64,
    highest: f64,
}

fn refused(change: impl FnOnce(&mut CameraSettings)) -> Refused {
    let mut settings = CameraSettings::default();
    change(&mut settings);
    match StereoRig::new(&settings, &world_from_phantom(), 1) {
        Err(RigError::Settings(e)) => {
            let text = e.to_string();
            match e {
                SettingsError::OutOfRange {
                    key,
                    value,
                    lowest,
                    highest,
                } => Refused {
                    text,
                    key,
                    value,
                    lowest,
                    highest,
                },
                other => panic!("no range: {other:?}"),
            }
        }
        other => panic!("not refused: {other:?}"),
    }
}

#[test]
fn what_is_outside_its_range_is_refused_with_the_range() {
    let e = refused(|s| s.container.gel_index = 0.9);
    assert_eq!((e.key, e.value), ("container.gel_index", 0.9));
    assert_eq!((e.lowest, e.highest), (1.0, 1.7));
    assert_eq!(e.text, "container.gel_index = 0.9: must be from 1 to 1.7");
    assert_eq!(refused(|s| s.focal_px = f64::NAN).key, "focal_px");
    assert_eq!(refused(|s| s.focal_px = f64::INFINITY).key, "focal_px");
    assert_eq!(refused(|s| s.width_px = 0).key, "width_px");
    assert_eq!(refused(|s| s.height_px = 100_000).key, "height_px");
    assert_eq!(refused(|s| s.distance_mm = 60.0).key, "distance_mm");
    assert_eq!(refused(|s| s.separation_deg = 0.0).key, "separation_deg");
    assert_eq!(refused(|s| s.rate_hz = 0.0).key, "rate_hz");
    assert_eq!(refused(|s| s.rate_hz = -30.0).key, "rate_hz");
    assert_eq!(refused(|s| s.distortion[1][0] = -3.0).key, "distortion k1");
    let e = refused(|s| {
        s.delivery.latency_min_ms = 60.0;
        s.delivery.latency_max_ms = 30.0;
    });
    assert_eq!((e.key, e.lowest), ("delivery.latency_max_ms", 60.0));
    let e = refused(|s| s.delivery.drop_probability = 1.5);
    assert_eq!(e.key, "delivery.drop_probability");
    assert_eq!(
        refused(|s| s.noise.gaussian_grey = -1.0).key,
        "noise.gaussian_grey"
    );
    assert_eq!(
        refused(|s| s.calibration.views = 1).key,
        "calibration.views"
    );
}

#[test]
fn a_folding_distortion_is_refused() {
    let mut settings = CameraSettings {
        focal_px: 400.0,
        ..CameraSettings::default()
    };
    settings.distortion[0][0] = -0.9;
    let built = StereoRig::new(&settings, &world_from_phantom(), 1);
    assert_eq!(built.map(|_| ()), Err(RigError::Folded { camera: "left" }));
}

#[test]
fn settings_survive_serialisation_and_unknown_keys_do_not() {
    for settings in [
        CameraSettings::ideal(),
        CameraSettings::paper(),
        CameraSettings::harsh(),
        CameraSettings::paper().at_1280(),
    ] {
        settings.validate().unwrap();
        let text = toml::to_string(&settings).unwrap();
        assert_eq!(toml::from_str::<CameraSettings>(&text).unwrap(), settings);
    }
    let partial: CameraSettings = toml::from_str("separation_deg = 30.0").unwrap();
    assert_eq!(partial.separation_deg, 30.0);
    assert_eq!(partial.focal_px, 2000.0);
    let e = toml::from_str::<CameraSettings>("[noise]\ngausian_grey = 1.0").unwrap_err();
    assert!(e.to_string().contains("gausian_grey"), "{e}");
}

#[test]
fn the_default_rig_is_the_documented_one() {
    let rig = rig(&CameraSettings::default(), 1);
    let truth = rig.truth();
    // 90 degrees at 0.5 m: a baseline of 0.5 sqrt 2 m, the right camera on the right.
    let right = truth.right_from_left.inverse().origin().coords();
    assert!((right.norm() - 0.5 * 2f64.sqrt()).abs() < 1e-12);
    assert!(right.x > 0.4 && right.y.abs() < 1e-12);
    let angle = truth.right_from_left.isometry().rotation.angle();
    assert!((angle - core::f64::consts::FRAC_PI_2).abs() < 1e-12);
    // The gel's centre is half a metre before both, on the optical axes.
    let centre = world_from_phantom() * nalgebra::Point3::new(0.0, 0.0, 0.05);
    let in_left = truth.left_from_world.isometry() * centre;
    assert!((in_left.coords - nalgebra::Vector3::z() * 0.5).norm() < 1e-12);
    let in_right = truth.right_from_left.isometry() * in_left;
    assert!((in_right.coords - nalgebra::Vector3::z() * 0.5).norm() < 1e-12);
    // Images are upright: down in the gel is down in the image.
    let down = truth.left_from_world.rotate(&-nalgebra::Vector3::z());
    assert!((down - nalgebra::Vector3::y()).norm() < 1e-12);
    assert_eq!(rig.given(), truth);
    assert_eq!(
        rig.world_from_left_camera(),
        truth.left_from_world.inverse()
    );
}
