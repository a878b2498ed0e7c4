//! A recording as steps of an insertion: support and tip across the insertion, depth by depth.

use nalgebra::{Vector2, Vector3};
use serde::Serialize;

use super::bed::Place;
use super::recording::{Recording, Seen};

/// How far the tip may come back before the insertion ends there \[m\]: more than a sensor's noise.
const BACK: f64 = 1e-3;
/// Advance that still is one \[m\].
const REST: f64 = 0.5e-3;
/// Rows nearer to each other than this in the median are samples, not steps \[m\]; steps are made of
/// them.
const DENSE: f64 = 1.5e-3;
/// Length of steps made of samples \[m\].
const STEP: f64 = 5e-3;
/// Steps that count: advance \[m\] and least motion of the support \[m\].
const ADVANCE: std::ops::RangeInclusive<f64> = 3e-3..=8e-3;
const MOTION: f64 = 0.3e-3;

/// A part of a recording that does not count.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LeftOut {
    /// The recording.
    pub file: String,
    /// First row left out, counted from 1 without the header.
    pub from_row: usize,
    /// Rows left out.
    pub rows: usize,
    /// Why.
    pub reason: String,
}

/// One row of an insertion.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    pub(super) place: Place,
    /// Measured position \[m\] and slope of the tip across the insertion.
    pub(super) tip: Vector2<f64>,
    pub(super) slope: Vector2<f64>,
}

/// Steps of one insertion, in the frame of the first row's support: z along the needle.
#[derive(Clone, Debug)]
pub(super) struct Steps {
    pub(super) rows: Vec<Row>,
    pub(super) left_out: Option<LeftOut>,
    /// Whether the tip's axis was measured in every row.
    pub(super) has_axis: bool,
}

impl Steps {
    pub(super) fn of(recording: &Recording) -> Self {
        let mut rows: Vec<Row> = Vec::with_capacity(recording.seen.len());
        if let Some(first) = recording.seen.first() {
            rows.extend(
                recording
                    .seen
                    .iter()
                    .map(|seen| row(recording, first, seen)),
            );
        }
        let (kept, reason) = forward(&rows);
        let left_out = reason.map(|reason| LeftOut {
            file: recording.name.clone(),
            from_row: kept + 1,
            rows: rows.len() - kept,
            reason,
        });
        rows.truncate(kept);
        condense(&mut rows);
        Self {
            has_axis: recording.seen[..kept]
                .iter()
                .all(|seen| seen.direction_sigma.is_finite()),
            rows,
            left_out,
        }
    }

    pub(super) fn places(&self) -> Vec<Place> {
        self.rows.iter().map(|row| row.place).collect()
    }

    pub(super) fn depth(&self) -> f64 {
        self.rows.last().map_or(0.0, |row| row.place.depth)
    }
}

/// Advance between two rows \[m\].
pub(super) fn advance(before: &Row, after: &Row) -> f64 {
    after.place.depth - before.place.depth
}

/// Whether the support moved between two rows.
pub(super) fn is_moved(before: &Row, after: &Row) -> bool {
    (after.place.support - before.place.support).norm() >= MOTION
}

/// Whether a step counts: 3 to 8 mm of advance and a motion of the support of 0.3 mm.
pub(super) fn counts(before: &Row, after: &Row) -> bool {
    ADVANCE.contains(&advance(before, after)) && is_moved(before, after)
}

fn row(recording: &Recording, first: &Seen, seen: &Seen) -> Row {
    let frame = first.world_from_support;
    let entry = recording.config.entry();
    let inward = recording.config.inward();
    // Depths count along the needle's first direction.
    let along = (frame.rotation * Vector3::z()).dot(&inward).max(0.1);
    let local = |v: Vector3<f64>| frame.inverse_transform_vector(&v);
    let support = frame.inverse_transform_point(&seen.world_from_support.translation.vector.into());
    let axis = local(seen.world_from_support.rotation * Vector3::z());
    let tip = frame.inverse_transform_point(&seen.tip);
    let direction = local(seen.direction.into_inner());
    Row {
        place: Place {
            depth: (seen.tip - entry).dot(&inward) / along,
            gap: -(seen.world_from_support.translation.vector - entry.coords).dot(&inward) / along,
            support: support.coords.xy(),
            tilt: axis.xy() / axis.z.max(0.1),
        },
        tip: tip.coords.xy(),
        slope: direction.xy() / direction.z.max(0.1),
    }
}

/// How many rows the insertion goes forward, and why it ends there if rows are left.
fn forward(rows: &[Row]) -> (usize, Option<String>) {
    let (mut deepest, mut reached) = (f64::NEG_INFINITY, 0);
    let mut advanced = 0;
    for (k, row) in rows.iter().enumerate() {
        if row.place.depth < deepest - BACK {
            let back = (deepest - row.place.depth) * 1e3;
            let reason = format!("the tip goes back by {back:.1} mm");
            return (reached + 1, Some(reason));
        }
        if k == 0 || row.place.depth > rows[advanced].place.depth + REST {
            advanced = k;
        }
        if row.place.depth > deepest {
            (deepest, reached) = (row.place.depth, k);
        }
    }
    if advanced + 1 < rows.len() {
        return (advanced + 1, Some("the tip stops".to_owned()));
    }
    (rows.len(), None)
}

/// Makes steps of samples.
fn condense(rows: &mut Vec<Row>) {
    let mut advances: Vec<f64> = rows.windows(2).map(|w| advance(&w[0], &w[1])).collect();
    advances.sort_by(f64::total_cmp);
    if advances
        .get(advances.len() / 2)
        .is_none_or(|middle| *middle > DENSE)
    {
        return;
    }
    let mut last: Option<Row> = None;
    rows.retain(|row| {
        let keep = last.is_none_or(|last| advance(&last, row) >= STEP);
        if keep {
            last = Some(*row);
        }
        keep
    });
}
