//! Markers: material points of moving tissue.

use hal::Stamp;
use nalgebra::Vector3;
use phantom::experiment::{Passing, default_setup};
use phantom::{Bench, SensedMarker, Settings};

use crate::support::ideal;

/// Lateral affine breathing: 1 mm at the entry, 5 mm at 80 mm.
const BREATHING: &str = "[motion]\nbreathing_mm = 1\nbreathing_hz = 0.2\nbreathing_fade_1_m = -50";

/// True places and measurements of a marker at `depth` \[m\], the needle at rest.
fn watch(settings: &Settings, depth: f64) -> (Vec<(Stamp, Vector3<f64>)>, Vec<SensedMarker>) {
    let setup = default_setup(settings, 3);
    let mut bench = Bench::new(settings, &setup).unwrap();
    let place = Vector3::new(0.4, 0.0, 0.25 - depth);
    bench.attach_marker(&place);
    let (mut truths, mut sensed) = (Vec::new(), Vec::new());
    for step in 1..=600u32 {
        bench.advance_to(
            Stamp::from_secs(f64::from(step) / 30.0),
            &setup.world_from_base,
        );
        truths.push((bench.truth().stamp, bench.marker().unwrap()));
        sensed.extend(bench.poll_marker());
    }
    (truths, sensed)
}

#[test]
fn a_marker_breathes_with_its_depth() {
    for (depth, expected) in [(0.0, 1e-3), (0.04, 3e-3), (0.08, 5e-3)] {
        let (truths, sensed) = watch(&ideal(BREATHING), depth);
        let start = Vector3::new(0.4, 0.0, 0.25 - depth);
        let mut largest: f64 = 0.0;
        for (stamp, place) in &truths {
            let seconds = stamp.secs_since(Stamp::ZERO);
            let phase = core::f64::consts::PI * (0.2 * seconds + 0.5);
            // Lujan's cos^4, towards -x while inhaling.
            let motion = -expected * phase.cos().powi(4);
            assert!((place - start - Vector3::x() * motion).norm() < 1e-9);
            largest = largest.max((place - start).norm());
        }
        // Thirty states a second of a peak that is flat there.
        assert!((largest / expected - 1.0).abs() < 1e-3, "{largest}");
        // Without flaws the sensor tells the truth at once.
        assert_eq!(sensed.len(), truths.len());
        let left = default_setup(&ideal(""), 3).left_from_world;
        for (one, (stamp, place)) in sensed.iter().zip(&truths) {
            assert_eq!(one.stamp, *stamp);
            let back = left.inverse() * one.position;
            assert!((back.coords() - place).norm() < 1e-12);
        }
    }
}

#[test]
fn a_marker_is_sensed_with_the_flaws_of_the_sensor() {
    let flaws =
        "sensor = { latency_ms = 100, drop_fraction = 0.3, noise_mm = 0.25, bias_mm = 0.15 }";
    let (truths, sensed) = watch(&ideal(&format!("{flaws}\n{BREATHING}")), 0.08);
    let left = default_setup(&ideal(""), 3).left_from_world;
    let errors: Vec<_> = sensed
        .iter()
        .map(|one| {
            let (_, place) = truths
                .iter()
                .find(|(stamp, _)| *stamp == one.stamp)
                .unwrap();
            (left.inverse() * one.position).coords() - place
        })
        .collect();
    let count = errors.len() as f64;
    let bias = errors.iter().sum::<Vector3<f64>>() / count;
    let spread = errors
        .iter()
        .map(|e| (e - bias).norm_squared())
        .sum::<f64>()
        / (3.0 * count);
    // 400 of 600 arrive (600 * 0.7 less the last three); sigma to 5 %, three standard errors.
    assert!((count - 418.0).abs() < 40.0, "{count}");
    assert!((spread.sqrt() / 0.25e-3 - 1.0).abs() < 0.1, "{spread}");
    assert!(bias.norm() > 0.02e-3 && bias.norm() < 0.8e-3, "{bias}");
}

#[test]
fn a_moving_target_is_scored_where_it_is_when_passed() {
    let settings = ideal(&format!("tip.cut_angle_deg = 0\n{BREATHING}"));
    let setup = default_setup(&settings, 1);
    let mut bench = Bench::new(&settings, &setup).unwrap();
    bench.attach_marker(&Vector3::new(0.4, 0.0, 0.21));
    let mut passing = Passing::new(bench.marker().unwrap());
    let mut score = None;
    let mut at = Vector3::zeros();
    for step in 1..=1500u32 {
        let seconds = f64::from(step) / 30.0;
        let base = setup.world_from_base.isometry()
            * nalgebra::Isometry3::translation(0.0, 0.0, 1e-3 * seconds);
        bench.advance_to(Stamp::from_secs(seconds), &hal::Transform::assume(base));
        passing.follow(bench.marker().unwrap());
        score = passing.observe(bench.truth());
        if score.is_some() {
            at = bench.marker().unwrap();
            break;
        }
    }
    let miss = bench.truth().miss(&at).lateral;
    // Between two states 33 ms apart a marker at 6 mm/s moves by up to 0.2 mm.
    assert!((score.unwrap() - miss).abs() < 0.2e-3, "{score:?} {miss}");
}

#[test]
fn tissue_drifts_and_turns_steadily() {
    let motion = "[motion]\ndrift_mm_min = [3.0, 0.0, 1.5]\nrotation_deg_min = 6";
    let (truths, _) = watch(&ideal(motion), 0.05);
    for (stamp, place) in truths {
        let seconds = stamp.secs_since(Stamp::ZERO);
        // About the phantom's x axis through the entry; z is down there, y along World's -y.
        let turned = (0.1 * seconds).to_radians();
        let drift = Vector3::new(3.0, 0.0, 1.5) * (1e-3 / 60.0 * seconds);
        let inside = Vector3::new(0.0, -turned.sin(), turned.cos()) * 0.05 + drift;
        let expected = Vector3::new(0.4 + inside.x, -inside.y, 0.25 - inside.z);
        assert!((place - expected).norm() < 1e-9, "{place} {expected}");
    }
}
