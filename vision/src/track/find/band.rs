//! Bands in one line across an image: darker or brighter than both their sides.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates of pixels, checked against the line"
)]

/// Widths at half height that are sought \[px\]; needles 3 to 20 px wide, blurred and slanting.
const WIDTHS: [f64; 9] = [2.5, 3.5, 5.0, 7.0, 10.0, 14.0, 19.0, 25.0, 32.0];
/// Ratios of a band's measured width to the one that it answers to.
const LIKE: [f64; 2] = [0.45, 1.7];
/// Widest band \[px\].
const WIDEST: f64 = 34.0;
/// Bands kept in a line, of either polarity.
const KEPT: usize = 14;

/// A band in a scanned line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Band {
    /// Its middle \[px\].
    pub at: f64,
    /// Its width at half height, along the line \[px\].
    pub width: f64,
    /// How far it stands out from both sides \[grey\].
    pub contrast: f32,
    /// Level of its sides \[grey\].
    pub level: f32,
    /// How much they differ \[grey\].
    pub step: f32,
    /// Brighter than its sides.
    pub bright: bool,
}

/// Sums over windows of one line.
#[derive(Default)]
pub(super) struct Finder {
    sums: Vec<f32>,
    found: Vec<(Band, [f32; 2])>,
}

/// Lengths of the windows for one width: the band, the gaps beside it, its sides.
#[derive(Clone, Copy)]
struct Windows {
    inner: usize,
    gap: usize,
    side: usize,
}

impl Windows {
    fn of(width: f64) -> Self {
        let pixels = |share: f64, least: f64| (share * width).round().max(least) as usize;
        Self {
            inner: pixels(0.6, 1.0),
            gap: pixels(0.45, 1.0),
            side: pixels(0.5, 2.0),
        }
    }

    const fn total(&self) -> usize {
        self.inner + 2 * (self.gap + self.side)
    }
}

impl Finder {
    /// The most distinct bands of `samples` that stand out by more than `least` \[grey\].
    pub(super) fn bands(&mut self, samples: &[f32], least: f32) -> Vec<Band> {
        self.found.clear();
        self.sums.clear();
        let mean = samples.iter().sum::<f32>() / samples.len().max(1) as f32;
        let mut sum = 0.0;
        self.sums.push(sum);
        // Less the mean, so that sums stay small and exact enough.
        self.sums.extend(samples.iter().map(|sample| {
            sum += sample - mean;
            sum
        }));
        for width in WIDTHS {
            self.respond(width, least, mean);
        }
        self.found
            .sort_by(|a, b| b.0.contrast.total_cmp(&a.0.contrast));
        let mut bands: Vec<Band> = Vec::with_capacity(2 * KEPT);
        let mut kept = [0; 2];
        for (band, sides) in &self.found {
            let count = &mut kept[usize::from(band.bright)];
            let taken = bands.iter().any(|b| {
                b.bright == band.bright && (b.at - band.at).abs() < 0.5 * (b.width + band.width)
            });
            if *count == KEPT || taken {
                continue;
            }
            if let Some(band) = measured(samples, band, *sides) {
                *count += 1;
                bands.push(band);
            }
        }
        bands
    }

    /// Local maxima of the response to bands of `width`, with the levels beside them.
    fn respond(&mut self, width: f64, least: f32, mean: f32) {
        let w = Windows::of(width);
        let Some(count) = self.sums.len().checked_sub(w.total()).filter(|n| *n > 2) else {
            return;
        };
        let starts = [
            0,
            w.side,
            w.side + w.gap,
            w.side + w.gap + w.inner,
            w.side + 2 * w.gap + w.inner,
            w.total(),
        ];
        let sums = &self.sums;
        let from = |start: usize| sums.get(start..start + count).unwrap_or_default();
        let [l0, l1, b0, b1, r0, r1] = starts.map(from);
        let (per_side, per_band) = (1.0 / w.side as f32, 1.0 / w.inner as f32);
        let middle = (w.side + w.gap) as f64 + 0.5 * (w.inner as f64 - 1.0);
        // Response before, and the one before that, for dark and bright.
        let mut last = [[0.0_f32; 2]; 2];
        let mut levels = [0.0; 2];
        for k in 0..count {
            let left = (l1[k] - l0[k]) * per_side;
            let band = (b1[k] - b0[k]) * per_band;
            let right = (r1[k] - r0[k]) * per_side;
            let here = [left.min(right) - band, band - left.max(right)];
            for (bright, (last, here)) in last.iter_mut().zip(here).enumerate() {
                if last[0] > least && last[0] >= last[1] && last[0] > here {
                    let band = Band {
                        at: (k - 1) as f64 + middle,
                        width,
                        contrast: last[0],
                        level: 0.5 * (levels[0] + levels[1]),
                        step: (levels[0] - levels[1]).abs(),
                        bright: bright == 1,
                    };
                    self.found.push((band, levels));
                }
                *last = [here, last[0]];
            }
            levels = [left + mean, right + mean];
        }
    }
}

/// The band with its middle and width measured at half height.
fn measured(samples: &[f32], band: &Band, sides: [f32; 2]) -> Option<Band> {
    let sign = if band.bright { -1.0 } else { 1.0 };
    let reach = (1.5 * band.width).ceil() + 2.0;
    let base = 0.5 * (sides[0] + sides[1]);
    let slope = (sides[1] - sides[0]) / (2.0 * band.width) as f32;
    let height = |k: usize| {
        let level = base + slope * (k as f64 - band.at) as f32;
        samples.get(k).map(|sample| sign * (level - sample))
    };
    let first = (band.at - 0.3 * band.width).ceil().max(0.0) as usize;
    let last = (band.at + 0.3 * band.width).floor().max(0.0) as usize;
    let (peak, top) = (first..=last.max(first))
        .filter_map(|k| height(k).map(|h| (k, h)))
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    let half = 0.5 * top.min(1.2 * band.contrast.max(0.8 * top));
    let edge = |step: isize| {
        let mut k = peak;
        let mut here = height(k)?;
        while (k as f64 - band.at).abs() <= reach {
            let next = k.checked_add_signed(step)?;
            let there = height(next)?;
            if there < half {
                return Some(k as f64 + step as f64 * f64::from((here - half) / (here - there)));
            }
            (k, here) = (next, there);
        }
        None
    };
    let (left, right) = (edge(-1)?, edge(1)?);
    let ratio = (right - left) / band.width;
    let like = ratio > LIKE[0] && ratio < LIKE[1] && right - left < WIDEST;
    like.then_some(Band {
        at: 0.5 * (left + right),
        width: right - left,
        ..*band
    })
}
