//! A needle anywhere in an image, without a prediction.
//!
//! Dark bands of the needle's width are found in every few rows and columns and linked to the
//! chain that is darkest and smooth; the chain's free end is the tip.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates of pixels, checked against the image"
)]

use hal::GrayImage;
use nalgebra::Vector2;

use super::background::Background;

/// Pixels between scanned lines, in images 640 wide.
const EVERY: f64 = 4.0;
/// Lines that a chain may skip.
const SKIP: usize = 4;
/// Bands kept in a line.
const BANDS: usize = 12;
/// Least darkness of a band relative to its surroundings.
const FAINT: f32 = 0.12;

/// A dark band in a scanned line.
#[derive(Clone, Copy, Debug)]
struct Band {
    at: f64,
    darkness: f32,
    /// Score of the best chain that ends here, and the band before this one in it.
    score: f32,
    slope: f64,
    before: Option<(usize, usize)>,
}

/// The longest dark, smooth chain of bands of about `width` \[px\], its tip last.
pub(super) fn find(
    image: &GrayImage,
    background: &Background,
    width: f64,
    scale: f64,
) -> Option<Vec<Vector2<f64>>> {
    let chains = [false, true].map(|upright| chain(image, background, width, scale, upright));
    let (_, mut line) = chains
        .into_iter()
        .flatten()
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    let border = |p: &Vector2<f64>| {
        (p.x.min(image.width() as f64 - 1.0 - p.x)).min(p.y.min(image.height() as f64 - 1.0 - p.y))
    };
    // The end that is farther from the border is the free one.
    if border(line.first()?) > border(line.last()?) {
        line.reverse();
    }
    Some(line)
}

/// The best chain over rows (`upright`) or columns, with its score.
fn chain(
    image: &GrayImage,
    background: &Background,
    width: f64,
    scale: f64,
    upright: bool,
) -> Option<(f32, Vec<Vector2<f64>>)> {
    let step = EVERY * scale;
    let (across, along) = if upright {
        (image.width(), image.height())
    } else {
        (image.height(), image.width())
    };
    let point = |at: f64, line: usize| {
        let there = line as f64 * step;
        if upright {
            Vector2::new(at, there)
        } else {
            Vector2::new(there, at)
        }
    };
    let lines = (along as f64 / step) as usize;
    let mut found: Vec<Vec<Band>> = Vec::with_capacity(lines);
    let mut samples = vec![1.0; across];
    for line in 0..lines {
        for (k, sample) in samples.iter_mut().enumerate() {
            *sample = background
                .brightness(image, point(k as f64, line))
                .unwrap_or(1.0);
        }
        let mut bands = bands(&samples, width);
        for band in &mut bands {
            link(band, line, &found, step);
        }
        found.push(bands);
    }
    let best = found
        .iter()
        .enumerate()
        .flat_map(|(line, bands)| (0..bands.len()).map(move |k| (line, k)))
        .max_by(|a, b| {
            let score = |(line, k): (usize, usize)| found[line][k].score;
            score(*a).total_cmp(&score(*b))
        })?;
    let score = found.get(best.0)?.get(best.1)?.score;
    let mut points = Vec::new();
    let mut next = Some(best);
    while let Some((line, k)) = next {
        let band = found.get(line)?.get(k)?;
        points.push(point(band.at, line));
        next = band.before;
    }
    (points.len() >= 4).then_some((score, points))
}

/// Dark bands of about `width` in one line.
fn bands(samples: &[f32], width: f64) -> Vec<Band> {
    let inner = width.round().max(2.0) as usize;
    let side = inner.max(3);
    let sum = |from: usize, to: usize| samples.get(from..to).map_or(0.0, |s| s.iter().sum::<f32>());
    let response = |k: usize| -> f32 {
        // Side, a gap of one, the band, a gap of one, side.
        let band = k + side + 1;
        let far = band + inner + 1;
        let even = (sum(k, k + side) + sum(far, far + side)) / (2 * side) as f32;
        let uneven = (sum(k, k + side) - sum(far, far + side)).abs() / side as f32;
        let dark = even - sum(band, band + inner) / inner as f32;
        dark - uneven
    };
    let total = 2 * side + 2 + inner;
    let Some(last) = samples.len().checked_sub(total) else {
        return Vec::new();
    };
    let mut bands = Vec::new();
    let mut previous = 0.0;
    let mut here = response(0);
    for k in 0..last {
        let next = response(k + 1);
        if here > FAINT && here >= previous && here > next {
            let middle = (k + side + 1) as f64 + 0.5 * (inner - 1) as f64;
            bands.push(Band {
                at: middle,
                darkness: here,
                score: here,
                slope: 0.0,
                before: None,
            });
        }
        (previous, here) = (here, next);
    }
    bands.sort_by(|a, b| b.darkness.total_cmp(&a.darkness));
    bands.truncate(BANDS);
    bands
}

/// Joins a band to the best chain in the lines before.
fn link(band: &mut Band, line: usize, found: &[Vec<Band>], step: f64) {
    for skipped in 1..=SKIP.min(line) {
        let Some(earlier) = found.get(line - skipped) else {
            continue;
        };
        for (k, before) in earlier.iter().enumerate() {
            let distance = skipped as f64 * step;
            let slope = (band.at - before.at) / distance;
            let bent = (slope - before.slope).abs();
            let fresh = before.before.is_none();
            if slope.abs() > 1.2 || (!fresh && bent > 0.5) {
                continue;
            }
            let penalty = 0.3 * (skipped - 1) as f32 + if fresh { 0.0 } else { bent as f32 };
            let score = before.score + band.darkness - 0.5 * penalty * band.darkness;
            if score > band.score {
                band.score = score;
                band.slope = if fresh {
                    slope
                } else {
                    0.5 * (slope + before.slope)
                };
                band.before = Some((line - skipped, k));
            }
        }
    }
}
