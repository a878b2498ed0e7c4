//! Grey levels along evenly spaced rows or columns of an image.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates of pixels, checked against the image"
)]

use hal::GrayImage;

use super::super::background::Background;

/// Spacing of the scanned lines in images 640 wide, and its limits \[px\].
const SPACING: f64 = 4.0;
const SPACINGS: [f64; 2] = [3.0, 8.0];
/// Adjacent rows (or columns) averaged to one line, against noise.
const AVERAGED: usize = 3;
/// Standard deviation of noise that even a noiseless image is taken to have \[grey\].
const QUIET: f32 = 0.3;

/// Parallel lines across an image.
pub(super) struct Scan {
    samples: Vec<f32>,
    across: usize,
    /// Distance of the lines \[px\].
    pub step: f64,
    /// Lines are rows: for needles that are rather upright.
    pub rows: bool,
}

impl Scan {
    pub(super) fn lines(&self) -> usize {
        self.samples.len() / self.across.max(1)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &[f32]> {
        self.samples.chunks_exact(self.across.max(1))
    }

    /// Place of the middle of line `line` across the lines \[px\].
    pub(super) fn place(&self, line: usize) -> f64 {
        line as f64 * self.step + (AVERAGED / 2) as f64
    }

    /// Rows or columns of `image`; with a `background`, what is brighter than it.
    pub(super) fn new(image: &GrayImage, background: Option<&Background>, rows: bool) -> Self {
        let scale = image.width() as f64 / 640.0;
        let step = (SPACING * scale).round().clamp(SPACINGS[0], SPACINGS[1]);
        let every = step as usize;
        let (across, along) = if rows {
            (image.width(), image.height())
        } else {
            (image.height(), image.width())
        };
        let lines = (along.saturating_sub(AVERAGED) / every + 1).min(along / AVERAGED);
        let mut samples = vec![0.0; across * lines];
        let mut row = vec![0.0; image.width()];
        for y in 0..image.height() {
            for (level, grey) in row.iter_mut().zip(image.row(y)) {
                *level = f32::from(*grey);
            }
            if let Some(means) = background.and_then(|b| b.row(y)) {
                for (level, mean) in row.iter_mut().zip(means) {
                    *level -= mean;
                }
            }
            if rows {
                let (line, part) = (y / every, y % every);
                if part < AVERAGED && line < lines {
                    let sums = samples.get_mut(line * across..).unwrap_or_default();
                    for (sum, level) in sums.iter_mut().zip(&row) {
                        *sum += level;
                    }
                }
            } else {
                let there = samples.get_mut(y..).unwrap_or_default();
                let sums = there.iter_mut().step_by(across);
                for (sum, levels) in sums.zip(row.chunks(every)) {
                    *sum += levels.iter().take(AVERAGED).sum::<f32>();
                }
            }
        }
        for sample in &mut samples {
            *sample /= AVERAGED as f32;
        }
        Self {
            samples,
            across,
            step,
            rows,
        }
    }

    /// Standard deviation of the samples' noise, from second differences \[grey\].
    pub(super) fn noise(&self) -> f32 {
        /// A second difference has six times the variance; the median of its size is 0.6745 sigma.
        const SIGMA: f32 = 0.6745 * 2.449_49;
        let stride = (self.samples.len() / 20_000).max(1);
        let mut bends: Vec<f32> = self
            .samples
            .windows(3)
            .step_by(stride)
            .map(|w| (w[0] - 2.0 * w[1] + w[2]).abs())
            .collect();
        if bends.is_empty() {
            return QUIET;
        }
        let middle = bends.len() / 2;
        let (_, median, _) = bends.select_nth_unstable_by(middle, f32::total_cmp);
        (*median / SIGMA).max(QUIET)
    }
}
