use hal::Stamp;
use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion};

use super::super::bed::Place;
use super::super::recording::Seen;
use super::super::validate::validate;
use super::*;

/// Draws from a fixed seed (SplitMix64), about normal with standard deviation 1.
struct Draws(u64);

impl Draws {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

const WAVE: f64 = 24e-3;
const GAP: f64 = 30e-3;

fn config() -> Config {
    let mut config = Config::default();
    config.needle.length_mm = 200.0;
    config.needle.outer_diameter_mm = 1.5;
    config.needle.guide_gap_sigma_mm = 8.0;
    config.tissue.entry_mm = [0.0, 0.0, 0.0];
    config
}

/// An insertion along -z of World through a guide that wanders, in a bed of wave length `WAVE`; the
/// pose says a gap of 25 mm, it is `GAP`.
fn recording(draws: &mut Draws, noise: f64) -> Recording {
    let mut support = Vector2::zeros();
    let places: Vec<Place> = (0..21)
        .map(|k| {
            if k > 1 {
                support += Vector2::new(draws.normal(), draws.normal()) * 2e-3;
            }
            Place {
                depth: 5e-3 * f64::from(k),
                gap: GAP,
                support,
                tilt: Vector2::zeros(),
            }
        })
        .collect();
    let bed = Bed {
        wave_length: WAVE,
        farther: 0.0,
        setback: 3e-3,
    };
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let seen = places
        .iter()
        .zip(bed.follow(&places))
        .enumerate()
        .map(|(k, (place, answer))| {
            // Drift of the sensor: 0.8 rad/m along x.
            let x = answer.slope.x + 0.8 * place.depth + noise * draws.normal();
            let y = answer.slope.y + noise * draws.normal();
            let guide = Point3::new(place.support.x, place.support.y, -25e-3);
            let tip = Point3::new(answer.position.x, answer.position.y, place.depth);
            Seen {
                stamp: Stamp::from_secs(k as f64),
                world_from_support: Isometry3::from_parts((turn * guide).into(), turn),
                tip: turn * tip,
                tip_sigma: 0.1e-3,
                direction: Unit::new_normalize(turn * Vector3::new(x, y, 1.0)),
                direction_sigma: 2e-3,
                shaft: Vec::new(),
                inserted: None,
                roll: None,
            }
        })
        .collect();
    Recording {
        name: "made.csv".into(),
        config: config(),
        support: Support::Guide,
        seen,
    }
}

#[test]
fn wave_length_gap_and_drift_are_found_and_predict_other_insertions() {
    let mut draws = Draws(1000);
    let all: Vec<Recording> = (0..4).map(|_| recording(&mut draws, 2e-3)).collect();
    let found = identify_tip(&all[..2]).unwrap();
    let wave = found.wave_length_mm.unwrap();
    assert!((wave.low..=wave.high).contains(&(WAVE * 1e3)), "{wave:?}");
    assert!((wave.value / (WAVE * 1e3)).ln().abs() < 0.1, "{wave:?}");
    let gap = found.guide_gap_mm.unwrap();
    assert!((gap.low..=gap.high).contains(&(GAP * 1e3)), "{gap:?}");
    let [drift, none] = found.axis_drift_rad_per_m;
    assert!((drift - 0.8).abs() < 0.4 && none.abs() < 0.4, "{found:?}");
    let k = found.stiffness_n_m2.as_ref().unwrap();
    assert!(k.low < k.value && k.value < k.high);
    assert_eq!(found.left_out, Vec::new());
    assert!(
        found
            .not_identified
            .iter()
            .any(|n| n.starts_with("natural_curvature"))
    );
    let mine = found.apply(&config());
    // The stiffness of a thick needle is beyond what the laws take: the configuration is valid still.
    assert_eq!(mine.validate(), Ok(()));
    let score = validate(&all[2..], &mine).unwrap();
    assert!(score.axis.r2 > 0.9, "{:?}", score.axis);
    assert!((0.9..1.1).contains(&score.axis.slope), "{:?}", score.axis);
    assert!(score.changes > 60);
    // Another needle's wave length explains less.
    let mut other = mine;
    other.estimator.wave_length_mm *= 2.0;
    assert!(validate(&all[2..], &other).unwrap().axis.r2 < score.axis.r2);
}

#[test]
fn intervals_cover_the_truth_in_most_pairs() {
    let mut draws = Draws(2000);
    let covered = (0..40)
        .filter(|_| {
            let pair = [recording(&mut draws, 8e-3), recording(&mut draws, 8e-3)];
            let wave = identify_tip(&pair).unwrap().wave_length_mm.unwrap();
            (wave.low..=wave.high).contains(&(WAVE * 1e3))
        })
        .count();
    assert!(covered >= 36, "{covered} of 40");
}

#[test]
fn a_tip_that_goes_back_or_stops_counts_as_far_as_it_went() {
    let mut draws = Draws(3000);
    let mut back = recording(&mut draws, 1e-3);
    for seen in &mut back.seen[18..] {
        seen.tip.z += 40e-3;
    }
    let mut rest = recording(&mut draws, 1e-3);
    let stop = rest.seen[17].tip;
    for seen in &mut rest.seen[18..] {
        seen.tip = stop;
    }
    let found = identify_tip(&[back, rest]).unwrap();
    assert_eq!(found.measurements, 36);
    let reasons: Vec<(usize, usize, &str)> = found
        .left_out
        .iter()
        .map(|part| (part.from_row, part.rows, part.reason.as_str()))
        .collect();
    assert_eq!(reasons.len(), 2, "{reasons:?}");
    assert_eq!((reasons[0].0, reasons[0].1), (19, 3));
    assert!(reasons[0].2.contains("goes back by"), "{reasons:?}");
    assert_eq!(reasons[1], (19, 3, "the tip stops"));
}

#[test]
fn what_identifies_nothing_is_refused_with_what_would() {
    let mut draws = Draws(4000);
    let mut still = recording(&mut draws, 1e-3);
    let pose = still.seen[0].world_from_support;
    for seen in &mut still.seen {
        seen.world_from_support = pose;
    }
    let message = identify_tip(&[still]).unwrap_err().to_string();
    assert!(message.contains("move the support while"), "{message}");
    let mut blind = recording(&mut draws, 1e-3);
    blind.seen[3].direction_sigma = f64::INFINITY;
    let message = identify_tip(&[blind]).unwrap_err().to_string();
    assert!(
        message.contains("made.csv") && message.contains("axis_x"),
        "{message}"
    );
}
