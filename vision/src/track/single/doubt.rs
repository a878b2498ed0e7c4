//! How far a predicted curve may be off, along it, and how far a measurement lies from it.

use super::super::curve::{Curve2, normal, weights_and_slopes};
use super::super::filter::{CurveFilter, Offset, State};

/// Places along the curve at which its doubt is computed; in between it hardly differs.
const DOUBTS: usize = 7;

/// Standard deviation of a predicted curve across itself, at equal parameters \[px\].
pub(super) fn doubts(filter: &CurveFilter, curve: &Curve2, count: usize) -> [f64; DOUBTS] {
    core::array::from_fn(|k| {
        let (row, slopes) = weights_and_slopes(count, k as f64 / (DOUBTS - 1) as f64);
        let across = normal(&curve.sum(&slopes).normalize());
        filter.variance(&row, &across).sqrt()
    })
}

/// The larger of the two values around `t`.
pub(super) fn between(values: &[f64; DOUBTS], t: f64) -> f64 {
    let k = (t * (DOUBTS - 1) as f64) as usize;
    let at = |k: usize| values[k.min(DOUBTS - 1)];
    at(k).max(at(k + 1))
}

/// Residual of a measurement after a change of the state, in standard deviations.
pub(super) fn residual(offset: &Offset, change: &State) -> f64 {
    let moved = offset
        .weights
        .iter()
        .enumerate()
        .fold(0.0, |sum, (i, weight)| {
            sum + weight
                * (offset.direction.x * change[2 * i] + offset.direction.y * change[2 * i + 1])
        });
    (offset.value - moved) / offset.variance.sqrt()
}
