//! What the law decided on the way and why, in words along the time line.

use std::collections::BTreeMap;
use std::fmt::Write;

use hal::telemetry::SteeringMode;

use super::course::{Course, Sample};

/// Speed from which the base is said to tilt \[deg/s\]: what noise does is slower.
const TILTING: f64 = 0.15;
/// Time over which that speed is taken, and a pause that does not end a motion \[s\].
const SPAN: f64 = 1.5;
/// Least tilt that is told \[deg\].
const TOLD: f64 = 0.3;
/// Least time without motion, or at a limit, that is told \[s\].
const HELD: f64 = 0.3;
/// Turns of the bevel that are told one by one.
const TURNS: usize = 15;

/// Moments of a run: when \[s from its start\], and what.
pub(super) fn story(course: &Course) -> Vec<(String, String)> {
    let Some(first) = course.samples.first() else {
        return Vec::new();
    };
    let mut told: Vec<(f64, String)> = Vec::new();
    told.extend(beginning(&course.samples));
    told.extend(tilts(&course.samples));
    told.extend(turns(&course.samples));
    told.extend(holds(&course.samples));
    told.extend(limits(&course.samples));
    told.sort_by(|a, b| a.0.total_cmp(&b.0));
    told.into_iter()
        .map(|(time, words)| (format!("{:.1} s", time - first.row.t_s), words))
        .collect()
}

/// Why the law acts: the prediction at a step.
fn because(sample: &Sample) -> String {
    let miss = sample.row.predicted_miss_mm;
    if !miss.is_finite() {
        return String::new();
    }
    let mut words = format!(": predicted miss {miss:.1} mm");
    if sample.bevel_authority_mm.is_finite() {
        let _ = write!(
            words,
            ", the bevel alone gives {:.1}",
            sample.bevel_authority_mm
        );
    }
    words
}

fn beginning(samples: &[Sample]) -> Option<(f64, String)> {
    let steering = samples
        .iter()
        .find(|s| s.row.mode != SteeringMode::Straight)?;
    let depth = steering.row.depth_mm;
    let words = format!("steering begins {depth:.1} mm deep{}", because(steering));
    Some((steering.row.t_s, words))
}

/// Motions of the base that tilt it.
fn tilts(samples: &[Sample]) -> Vec<(f64, String)> {
    let mut told = Vec::new();
    let mut motion: Option<(usize, usize)> = None;
    let mut before = 0;
    for (k, sample) in samples.iter().enumerate() {
        while sample.row.t_s - samples[before].row.t_s > SPAN {
            before += 1;
        }
        let span = sample.row.t_s - samples[before].row.t_s;
        let turned = sample.row.tilt_deg - samples[before].row.tilt_deg;
        let moves = turned.abs() > TILTING * span && span > 0.5 * SPAN;
        motion = match motion {
            None if moves => Some((before.midpoint(k), k)),
            Some((from, _)) if moves => Some((from, k)),
            Some((from, last)) if sample.row.t_s - samples[last].row.t_s > SPAN => {
                told.extend(tilt(&samples[from..=last]));
                None
            }
            other => other,
        };
    }
    if let Some((from, last)) = motion {
        told.extend(tilt(&samples[from..=last]));
    }
    told
}

fn tilt(motion: &[Sample]) -> Option<(f64, String)> {
    let (from, to) = (motion.first()?, motion.last()?);
    let predicted = motion.iter().find(|s| s.row.predicted_miss_mm.is_finite());
    let by = to.row.tilt_deg - from.row.tilt_deg;
    (by.abs() >= TOLD).then(|| {
        let words = format!(
            "the base tilts by {by:+.1} deg, to {:.1}, in {:.1} s{}",
            to.row.tilt_deg,
            to.row.t_s - from.row.t_s,
            predicted.map(because).unwrap_or_default()
        );
        (from.row.t_s, words)
    })
}

/// Turns of the bevel, or how many where they are many.
fn turns(samples: &[Sample]) -> Vec<(f64, String)> {
    let turns: Vec<&[Sample]> = stretches(samples, |s| s.row.mode == SteeringMode::BevelTurn);
    if turns.len() > TURNS {
        let words = format!("the first of {} turns of the bevel", turns.len());
        return turns
            .first()
            .map(|turn| (turn[0].row.t_s, words))
            .into_iter()
            .collect();
    }
    let told = |turn: &&[Sample]| {
        let by = turn[turn.len() - 1].row.roll_deg - turn[0].row.roll_deg;
        let words = format!("the bevel turns by {by:+.0} deg{}", because(&turn[0]));
        (turn[0].row.t_s, words)
    };
    turns.iter().map(told).collect()
}

/// Times in which the law waited for a measurement or a plan.
fn holds(samples: &[Sample]) -> Vec<(f64, String)> {
    stretches(samples, |s| s.row.mode == SteeringMode::Hold)
        .into_iter()
        .filter_map(|hold| {
            let lasts = hold[hold.len() - 1].row.t_s - hold[0].row.t_s;
            let words = format!("held for {lasts:.1} s: no measurement or no plan to go by");
            (lasts >= HELD).then_some((hold[0].row.t_s, words))
        })
        .collect()
}

/// Each limit where it acted first, and how long in all.
fn limits(samples: &[Sample]) -> Vec<(f64, String)> {
    let mut acted: BTreeMap<String, (f64, f64)> = BTreeMap::new();
    for pair in samples.windows(2) {
        for limit in &pair[0].row.limits {
            let (at, step) = (pair[0].row.t_s, pair[1].row.t_s - pair[0].row.t_s);
            acted.entry(format!("{limit:?}")).or_insert((at, 0.0)).1 += step;
        }
    }
    acted
        .into_iter()
        .filter(|(_, (_, lasts))| *lasts >= HELD)
        .map(|(limit, (at, lasts))| (at, format!("{limit} limits, {lasts:.1} s in all")))
        .collect()
}

/// Unbroken rows of samples of one kind.
fn stretches(samples: &[Sample], kind: impl Fn(&Sample) -> bool) -> Vec<&[Sample]> {
    samples
        .chunk_by(|a, b| kind(a) == kind(b))
        .filter(|stretch| kind(&stretch[0]))
        .collect()
}
