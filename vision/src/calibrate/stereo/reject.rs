//! Corners and views that the rest contradicts.

use std::collections::BTreeSet;

use super::super::normal::{Observed, residuals};
use super::joint::Joint;
use super::{BoardPair, RejectReason, Rejected, StereoOptions};

/// What one round found.
pub(super) struct Found {
    pub rejected: Vec<Rejected>,
    /// Indices of rejected pairs.
    pub views: BTreeSet<usize>,
}

/// Rejects the views that stand out, or else the corners: the worst spoil the others' residuals,
/// so that the rest is judged only after the next fit. Rejected corners leave `observed`.
pub(super) fn reject(
    joint: &Joint<'_>,
    used: &[usize],
    pairs: &[BoardPair],
    observed: &mut [Vec<Observed>; 2],
    options: &StereoOptions,
) -> Found {
    let mut found = Found {
        rejected: Vec::new(),
        views: BTreeSet::new(),
    };
    let misses: Vec<[Vec<Option<f64>>; 2]> = used
        .iter()
        .zip(&joint.left_from_board)
        .map(|(&k, pose)| {
            let right = joint.right_from_left * pose;
            let miss = |camera, pose, corners, seen: &Observed| {
                residuals(camera, pose, joint.board, corners)
                    .iter()
                    .zip(seen)
                    .map(|(r, s)| s.map(|_| r.norm()))
                    .collect()
            };
            [
                miss(&joint.left, pose, &pairs[k].left, &observed[0][k]),
                miss(&joint.right, &right, &pairs[k].right, &observed[1][k]),
            ]
        })
        .collect();
    let all: Vec<f64> = misses
        .iter()
        .flatten()
        .flatten()
        .flatten()
        .copied()
        .collect();
    // The median length of a plane's Gaussian is 1.177 sigma.
    let corner_limit = options.corner_limit_px.max(8.0 * median(&all) / 1.177);
    // A view is as good as the worse of its images; the few corners that go by themselves do not
    // count against it.
    let view_rms: Vec<f64> = misses
        .iter()
        .map(|view| {
            let of = |side: usize| rms(plain(&view[side], corner_limit));
            of(0).max(of(1))
        })
        .collect();
    let limit = options.view_limit_px.max(3.0 * median(&view_rms));
    let many = |view: &[Vec<Option<f64>>; 2]| view.iter().any(|v| too_many(v, corner_limit));
    let of_pair = |k: usize, reason| Rejected {
        left: pairs[k].left_name.clone(),
        right: pairs[k].right_name.clone(),
        reason,
    };
    for ((&k, &kept_rms), view) in used.iter().zip(&view_rms).zip(&misses) {
        if kept_rms > limit || many(view) {
            found.views.insert(k);
            let of = |side: usize| rms(view[side].iter().flatten());
            let rms_px = of(0).max(of(1));
            found.rejected.push(of_pair(
                k,
                RejectReason::View {
                    rms_px,
                    limit_px: limit,
                },
            ));
        }
    }
    if !found.views.is_empty() {
        return found;
    }
    for (&k, view) in used.iter().zip(&misses) {
        for (side, lengths) in view.iter().enumerate() {
            for (corner, length) in lengths.iter().enumerate() {
                let Some(distance_px) = length.filter(|&l| l > corner_limit) else {
                    continue;
                };
                observed[side][k][corner] = None;
                let pair = &pairs[k];
                let image = [&pair.left_name, &pair.right_name][side].clone();
                found.rejected.push(of_pair(
                    k,
                    RejectReason::Corner {
                        image,
                        corner,
                        distance_px,
                        limit_px: corner_limit,
                    },
                ));
            }
        }
    }
    found
}

/// Part of an image's corners that may be false, each rejected by itself: a board bent into the
/// border of a strong lens, a reflection. With more of them it shows no plain board.
const FALSE_SHARE: f64 = 0.1;
/// As many may always be.
const FALSE_COUNT: f64 = 2.0;

/// Whether more corners of an image miss the fit by more than `limit` than can be set aside.
pub(in crate::calibrate) fn too_many(lengths: &[Option<f64>], limit: f64) -> bool {
    let beyond = lengths.iter().flatten().filter(|&&l| l > limit).count();
    beyond as f64 > FALSE_COUNT.max(FALSE_SHARE * lengths.len() as f64)
}

/// What an image's corners within `limit` miss the fit by.
pub(in crate::calibrate) fn plain(
    lengths: &[Option<f64>],
    limit: f64,
) -> impl Iterator<Item = &f64> {
    lengths.iter().flatten().filter(move |&&l| l <= limit)
}

pub(super) fn rms<'a>(values: impl Iterator<Item = &'a f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for v in values {
        sum += v * v;
        count += 1.0;
    }
    if count > 0.0 {
        (sum / count).sqrt()
    } else {
        0.0
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}
