//! Bands linked from line to line.

use super::band::Band;

/// Lines that a chain may skip, so that a bar or a bubble across the needle does not end it.
const SKIP: usize = 6;
/// Steepest slope against the lines' normal; what lies flatter is found in the other direction.
const STEEPEST: f64 = 1.3;
/// Largest change of the slope between links, beyond what rounding makes of a short step.
const BENT: f64 = 0.3;
/// Largest ratios of widths and of contrasts of linked bands.
const WIDER: f64 = 1.7;
const FAINTER: f32 = 2.5;
/// Difference of widths that noise and blur make, whatever the ratio \[px\].
const WIDER_BY: f64 = 1.2;

/// A band in its best chain.
#[derive(Clone, Copy, Debug)]
struct Link {
    band: Band,
    score: f32,
    slope: f64,
    /// Running means along the chain.
    contrast: f32,
    width: f64,
    before: Option<(usize, usize)>,
    used: bool,
}

/// Chains over all lines.
pub(super) struct Chains {
    lines: Vec<Vec<Link>>,
}

impl Chains {
    pub(super) fn new(capacity: usize) -> Self {
        Self {
            lines: Vec::with_capacity(capacity),
        }
    }

    /// Adds the bands of the next line, `step` \[px\] after the last.
    pub(super) fn push(&mut self, bands: &[Band], step: f64) {
        let mut links = Vec::with_capacity(bands.len());
        for band in bands {
            let mut link = Link {
                band: *band,
                score: band.contrast,
                slope: 0.0,
                contrast: band.contrast,
                width: band.width,
                before: None,
                used: false,
            };
            let line = self.lines.len();
            for skipped in 1..=SKIP.min(line) {
                for (k, before) in self.lines[line - skipped].iter().enumerate() {
                    link.join(before, (line - skipped, k), skipped, step);
                }
            }
            links.push(link);
        }
        self.lines.push(links);
    }

    /// The best chain of bands not yet taken: line and band, first line first.
    pub(super) fn take(&mut self) -> Option<Vec<(usize, Band)>> {
        let all = self.lines.iter().enumerate();
        let all =
            all.flat_map(|(line, links)| links.iter().enumerate().map(move |(k, l)| (line, k, l)));
        let (line, k, _) = all
            .filter(|(_, _, link)| !link.used)
            .max_by(|a, b| a.2.score.total_cmp(&b.2.score))?;
        let mut chain = Vec::new();
        let mut next = Some((line, k));
        while let Some((line, k)) = next {
            let link = self.lines.get_mut(line)?.get_mut(k)?;
            if link.used {
                break;
            }
            link.used = true;
            chain.push((line, link.band));
            next = link.before;
        }
        chain.reverse();
        Some(chain)
    }
}

impl Link {
    /// Joins the chain that ends at `before` if that makes a better one.
    fn join(&mut self, before: &Self, place: (usize, usize), skipped: usize, step: f64) {
        let band = &self.band;
        if band.bright != before.band.bright {
            return;
        }
        let distance = skipped as f64 * step;
        let slope = (band.at - before.band.at) / distance;
        let fresh = before.before.is_none();
        let bent = if fresh {
            0.0
        } else {
            (slope - before.slope).abs()
        };
        if slope.abs() > STEEPEST || bent > BENT + 1.0 / distance {
            return;
        }
        let (narrow, wide) = (band.width.min(before.width), band.width.max(before.width));
        if wide > (WIDER * narrow).max(narrow + WIDER_BY) {
            return;
        }
        let ratio = band.contrast.max(before.contrast) / band.contrast.min(before.contrast);
        if ratio > FAINTER {
            return;
        }
        let uneven = bent as f32 + 0.2 * (ratio - 1.0) + 0.15 * (skipped - 1) as f32;
        // A chain is worth what it stands out by over its length; what is skipped counts nothing.
        let score = before.score + band.contrast * (1.0 - 0.5 * uneven);
        if score > self.score {
            self.score = score;
            self.slope = if fresh {
                slope
            } else {
                0.6 * before.slope + 0.4 * slope
            };
            self.contrast = 0.8 * before.contrast + 0.2 * band.contrast;
            self.width = 0.8 * before.width + 0.2 * band.width;
            self.before = Some(place);
        }
    }
}
