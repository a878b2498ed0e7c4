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
const EVERY: f64 = 5.0;
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
    let every = ((EVERY * scale).round() as usize).max(1);
    let step = every as f64;
    let point = |at: f64, line: usize| {
        let there = line as f64 * step;
        if upright {
            Vector2::new(at, there)
        } else {
            Vector2::new(there, at)
        }
    };
    let scanned = if upright {
        rows(image, background, every)
    } else {
        columns(image, background, every)
    };
    let mut found: Vec<Vec<Band>> = Vec::with_capacity(scanned.lines());
    let mut scratch = Scratch::default();
    for (line, samples) in scanned.iter().enumerate() {
        let mut bands = bands(samples, width, &mut scratch);
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

/// Relative brightness along parallel lines of an image.
struct Scanned {
    samples: Vec<f32>,
    across: usize,
}

impl Scanned {
    fn lines(&self) -> usize {
        self.samples.len() / self.across.max(1)
    }

    fn iter(&self) -> impl Iterator<Item = &[f32]> {
        self.samples.chunks_exact(self.across.max(1))
    }
}

/// Every `every`th row.
fn rows(image: &GrayImage, background: &Background, every: usize) -> Scanned {
    let (width, lines) = (image.width(), image.height() / every);
    let mut samples = Vec::with_capacity(width * lines);
    for line in 0..lines {
        samples.extend(background.relative_row(image, line * every, 1));
    }
    Scanned {
        samples,
        across: width,
    }
}

/// Every `every`th column. Rows are gone through, as images lie in memory.
fn columns(image: &GrayImage, background: &Background, every: usize) -> Scanned {
    let (height, lines) = (image.height(), image.width() / every);
    let mut samples = vec![1.0; height * lines];
    for y in 0..height {
        let row = background.relative_row(image, y, every);
        let there = samples.get_mut(y..).unwrap_or_default();
        for (sample, brightness) in there.iter_mut().step_by(height).zip(row) {
            *sample = brightness;
        }
    }
    Scanned {
        samples,
        across: height,
    }
}

/// Working memory of [`bands`].
#[derive(Default)]
struct Scratch {
    sums: Vec<f32>,
    response: Vec<f32>,
}

/// Dark bands of about `width` in one line.
fn bands(samples: &[f32], width: f64, scratch: &mut Scratch) -> Vec<Band> {
    let inner = width.round().max(2.0) as usize;
    let side = inner.max(3);
    // Side, a gap of one, the band, a gap of one, side.
    let total = 2 * side + 2 + inner;
    let Some(last) = samples.len().checked_sub(total) else {
        return Vec::new();
    };
    scratch.respond(samples, inner, side, last + 1);
    let response = scratch.response.as_slice();
    let mut bands = Vec::new();
    let mut previous = 0.0;
    for (k, pair) in response.windows(2).enumerate() {
        let [here, next] = *pair else { continue };
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
        previous = here;
    }
    bands.sort_by(|a, b| b.darkness.total_cmp(&a.darkness));
    bands.truncate(BANDS);
    bands
}

impl Scratch {
    /// How much darker than both its sides, and these how uneven, each window is.
    fn respond(&mut self, samples: &[f32], inner: usize, side: usize, count: usize) {
        self.sums.clear();
        // Less one, so that sums stay small and exact enough.
        let mut sum = 0.0;
        self.sums.push(sum);
        self.sums.extend(samples.iter().map(|sample| {
            sum += sample - 1.0;
            sum
        }));
        let band = side + 1;
        let far = band + inner + 1;
        let from = |start: usize| self.sums.get(start..start + count).unwrap_or_default();
        let ends = [0, side, band, band + inner, far, far + side].map(from);
        let [l0, l1, b0, b1, r0, r1] = ends;
        let (per_side, per_band) = (1.0 / side as f32, 1.0 / inner as f32);
        self.response.clear();
        let left = l0.iter().zip(l1).map(|(a, b)| b - a);
        let middle = b0.iter().zip(b1).map(|(a, b)| b - a);
        let right = r0.iter().zip(r1).map(|(a, b)| b - a);
        self.response
            .extend(left.zip(middle).zip(right).map(|((left, middle), right)| {
                let even = 0.5 * (left + right) - (left - right).abs();
                even * per_side - middle * per_band
            }));
    }
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
