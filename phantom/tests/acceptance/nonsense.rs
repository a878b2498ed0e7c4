//! Poses and times that make no sense, and leaps that do: refused or simulated, never a NaN.

use hal::frame::{NeedleBase, World};
use hal::{Stamp, Transform};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use phantom::camera::{CameraSettings, RigError, StereoRig};
use phantom::experiment::{default_setup, uncontrolled};
use phantom::{Bench, Event, Plant, RodPlant, Settings, SettingsError};

use crate::support::{GJ, Rig, finite, ideal, standing};

/// Poses that are none.
fn nonsense() -> Vec<Isometry3<f64>> {
    let turned = |w, x| {
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, x, 0.0, 0.0));
        Isometry3::from_parts(standing().translation, rotation)
    };
    vec![
        Isometry3::translation(f64::NAN, 0.0, 0.0),
        Isometry3::translation(0.0, f64::INFINITY, 0.0),
        Isometry3::translation(0.0, 0.0, -1e6),
        turned(f64::NAN, 0.0),
        turned(0.0, 0.0),
        turned(1.0, 1.0),
    ]
}

fn harsh() -> Settings {
    Settings::preset("harsh").unwrap()
}

#[test]
fn nothing_is_built_in_no_place() {
    let settings = harsh();
    let good = default_setup(&settings, 1);
    for bad in nonsense() {
        let base: Transform<World, NeedleBase> = Transform::assume(bad);
        let plant = |phantom, base| RodPlant::new(&settings, phantom, base, 1).map(drop);
        let refused = |key| Err(SettingsError::Pose { key });
        assert_eq!(
            plant(&bad, &good.world_from_base),
            refused("world_from_phantom")
        );
        assert_eq!(
            plant(&good.world_from_phantom, &base),
            refused("world_from_base")
        );
        let (mut a, mut b, mut c) = (good, good, good);
        a.world_from_phantom = bad;
        b.world_from_base = base;
        c.left_from_world = Transform::assume(bad);
        for (setup, key) in [
            (a, "world_from_phantom"),
            (b, "world_from_base"),
            (c, "left_from_world"),
        ] {
            assert_eq!(Bench::new(&settings, &setup).map(drop), refused(key));
        }
        let rig = StereoRig::new(&CameraSettings::paper(), &bad, 1).map(drop);
        let error = SettingsError::Pose {
            key: "world_from_phantom",
        };
        assert_eq!(rig, Err(RigError::Settings(error)));
    }
}

#[test]
fn a_plant_refuses_poses_that_are_none() {
    let mut rig = Rig::new(&harsh(), 1);
    rig.insert(0.02);
    let before = rig.truth().needle.clone();
    let later = Stamp::from_secs(rig.seconds + 0.1);
    for bad in nonsense() {
        rig.plant.advance(&Transform::assume(bad), later);
        assert_eq!(rig.truth().events, [Event::Refused]);
        assert_eq!(rig.truth().needle, before);
        rig.plant.reset(&Transform::assume(bad));
        assert_eq!(rig.truth().events, [Event::Refused]);
        assert_eq!(rig.truth().needle, before);
    }
    rig.insert(0.01);
    assert!(finite(rig.truth()));
}

#[test]
fn a_bench_forgets_poses_and_times_that_are_none() {
    let settings = harsh();
    let setup = default_setup(&settings, 3);
    let start = *setup.world_from_base.isometry();
    let run = |disturbed: bool| {
        let mut bench = Bench::new(&settings, &setup).unwrap();
        for i in 1..=300u32 {
            let seconds = f64::from(i) * 0.016;
            let pose = start * Isometry3::translation(0.0, 0.0, 3e-3 * seconds);
            if disturbed {
                let bad = nonsense()[i as usize % 6];
                bench.advance_to(Stamp::from_secs(seconds), &Transform::assume(bad));
                assert!(bench.refused());
                if i > 1 {
                    let back = Stamp::from_secs(seconds - 0.02);
                    bench.advance_to(back, &Transform::assume(pose));
                    assert!(bench.refused());
                }
                bench.advance_to(Stamp::from_nanos(u64::MAX), &Transform::assume(pose));
                assert!(bench.refused());
                bench.attach_marker(&Vector3::repeat(f64::NAN));
                assert_eq!(bench.marker(), None);
            }
            bench.advance_to(Stamp::from_secs(seconds), &Transform::assume(pose));
            assert!(!bench.refused());
        }
        bench.truth().clone()
    };
    // The servo's lag would keep a NaN for ever.
    assert!(run(true) == run(false));
}

#[test]
fn standing_still_is_rest() {
    let mut rig = Rig::new(
        &ideal("friction.shaft_n_m = 10\ntissue.slit_gap_um = 20"),
        1,
    );
    rig.insert(0.04);
    let pose = rig.pose;
    // No way in no time.
    let moved = [0; 6].map(|_| {
        let tip = rig.tip();
        rig.go(pose, 0.0, 100);
        (rig.tip() - tip).norm()
    });
    println!("a hundred steps of nothing move the tip by {moved:?} m");
    // The shaft's compression by friction, micrometres, comes to rest step by step, and stays
    // there: a thousandth of the sensor's noise in a hundred steps.
    assert!(moved[0] < 3e-6, "{moved:?}");
    assert!(moved[5] < 1e-7, "{moved:?}");
    rig.go(pose, 1e-9, 1);
    assert!(rig.truth().events.is_empty(), "{:?}", rig.truth().events);
}

#[test]
fn ages_may_pass_in_one_step() {
    for name in ["paper", "harsh"] {
        for seconds in [1e3, 1e6, 1e9] {
            let mut rig = Rig::new(&Settings::preset(name).unwrap(), 2);
            rig.insert(0.03);
            // Tissue drifts away for kilometres.
            rig.go(rig.pose, seconds, 1);
            assert!(finite(rig.truth()), "{name} {seconds}");
            let out = rig.pose * Isometry3::translation(0.0, 0.0, -0.05);
            rig.go(out, 1.0, 10);
            assert!(finite(rig.truth()), "{name} {seconds}");
        }
    }
}

#[test]
fn leaps_of_fifty_millimetres_are_simulated() {
    for (name, leap) in [
        ("aside", Vector3::x() * 0.05),
        ("on", Vector3::z() * 0.05),
        ("back", Vector3::z() * -0.05),
        ("down to the holder", Vector3::z() * 0.15),
    ] {
        for preset in ["ideal", "paper", "harsh"] {
            let mut rig = Rig::new(&Settings::preset(preset).unwrap(), 4);
            rig.insert(0.04);
            let home = rig.pose;
            let there = home * Isometry3::from(leap);
            let mut iterations = 0;
            for pose in [there, home, there, home] {
                rig.go(pose, 0.033, 1);
                let work = rig.plant.iterations() - iterations;
                iterations = rig.plant.iterations();
                assert!(finite(rig.truth()), "{preset} {name}");
                // 1500 steps of 0.1 mm and their halvings, seven Newton steps each at the worst.
                assert!(work < 60_000, "{preset} {name}: {work}");
                let refused = rig.truth().events.contains(&Event::Refused);
                assert!(!refused, "{preset} {name}");
            }
            rig.insert(0.01);
            assert!(finite(rig.truth()), "{preset} {name}");
        }
    }
}

#[test]
fn a_hundred_turns_wind_up_no_more_than_one() {
    let friction = 10.0;
    let mut rig = Rig::new(&ideal("friction.shaft_n_m = 10\ntip.cut_angle_deg = 0"), 1);
    rig.insert(0.08);
    let length = rig.truth().needle.inserted_length();
    for _ in 0..1000 {
        let turned = rig.pose * Isometry3::rotation(Vector3::z() * 0.2 * core::f64::consts::PI);
        rig.go(turned, 0.1, 1);
    }
    let lag = -rig.truth().torsion;
    let free = 0.126 - length;
    let expected = friction * 0.35e-3 * length / GJ * (0.5 * length + free);
    println!(
        "lag {:.4} deg of {:.4}",
        lag.to_degrees(),
        expected.to_degrees()
    );
    assert!((lag / expected - 1.0).abs() < 0.01, "{lag} {expected}");
    assert!(rig.tip().xy().norm() < 1e-7, "{}", rig.tip());
}

#[test]
fn an_experiment_ends_whatever_is_asked() {
    let settings = ideal("");
    for speed in [0.0, -1e-3, f64::NAN, f64::INFINITY] {
        let error = uncontrolled(&settings, 1, speed, 0.1).unwrap_err();
        assert!(error.to_string().starts_with("speed = "), "{error}");
    }
    for period in [0.0, -0.1, f64::NAN, 1e9] {
        let error = uncontrolled(&settings, 1, 1e-3, period).unwrap_err();
        assert!(error.to_string().starts_with("sensor.rate_hz"), "{error}");
    }
    // A needle of 20 mm does not reach the target: that is infinitely far, not NaN.
    let short = ideal("needle = { length_mm = 20, elements = 40 }");
    let run = uncontrolled(&short, 1, 5e-3, 0.1).unwrap();
    assert!(!run.aligned.is_nan() && !run.shifted.is_nan() && run.max_stretch.is_finite());
}
