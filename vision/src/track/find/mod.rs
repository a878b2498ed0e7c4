//! What may be a needle in one image, without a prediction.
//!
//! Bands of any width, dark or bright, are found in rows and columns and linked to smooth chains of
//! even width and contrast. Each chain is a candidate; what it is of is decided by both images.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates of pixels, checked against the image"
)]

mod band;
mod chain;
mod scan;

use hal::GrayImage;
use nalgebra::Vector2;

use super::background::Background;
use super::curve::Curve2;
use super::matching::on_line;
use band::Band;
use chain::Chains;
use scan::Scan;

/// Chains taken in either direction.
const CHAINS: usize = 8;
/// Candidates kept.
const KEPT: usize = 10;
/// Bands are of interest that stand out by so many standard deviations of the noise, and by so
/// many grey levels.
const NOISE: f32 = 4.0;
const FAINT: f32 = 3.0;
/// Shortest chain \[lines\].
const SHORTEST: usize = 4;
/// The brightest level, and the least difference to it or to black that is told from noise \[grey\].
const WHITE: f32 = 255.0;
const DIM: f32 = 40.0;
/// Least length, in widths.
const SLENDER: f64 = 6.0;
/// A level as dark as this beyond the end of a dark band is where a picture was cut or turned
/// \[grey\].
const CUT: u8 = 1;
/// Least share of what the surroundings allow by which a needle stands out, steps between its sides
/// taken off: grid lines and tracks of earlier insertions have 0.1.
const PLAIN: f64 = 0.11;
/// By how much a step between its sides counts against a band. Needles in photographs before grid paper
/// have steps of up to 0.12 of their contrast (99 %), rims and reflections 0.1 to 0.4.
const EDGE: f64 = 2.5;
/// Share of the typical contrast below which a chain's end is something else.
const ENDS: f32 = 0.4;

/// A smooth band in an image: perhaps the needle, perhaps a grid line or a container's edge.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    /// Points on its middle \[px\].
    pub line: Vec<Vector2<f64>>,
    /// Width at half height, across it \[px\].
    pub width: f64,
    /// How far it stands out from its surroundings \[grey\].
    pub contrast: f64,
    /// Brighter than its surroundings.
    pub bright: bool,
    /// Contrast relative to the most that its surroundings allow: to black, or to white.
    pub share: f64,
    /// How far the image goes on beyond either end, as far as that was looked \[px\].
    pub room: [f64; 2],
    /// How much its surroundings differ from one side to the other, by its contrast.
    pub step: f64,
    /// Contrast summed over the length \[grey px\].
    pub evidence: f64,
}

impl Candidate {
    /// Finds how far the image goes on beyond the ends.
    fn look_beyond(&mut self, image: &GrayImage) {
        let most = self.beyond() + 1.0;
        let end = |from: Option<Vector2<f64>>, to: Option<Vector2<f64>>| {
            let (Some(from), Some(to)) = (from, to) else {
                return 0.0;
            };
            let Some(ahead) = (to - from).try_normalize(1e-9) else {
                return 0.0;
            };
            let mut room = 0.0;
            while room < most {
                let p = to + ahead * (room + 1.0);
                let (x, y) = (p.x.round(), p.y.round());
                let inside = x >= 0.0 && y >= 0.0;
                let grey = inside.then(|| {
                    let row = image.pixels().chunks_exact(image.width()).nth(y as usize)?;
                    row.get(x as usize).copied()
                });
                match grey.flatten() {
                    Some(grey) if self.bright || grey > CUT => room += 1.0,
                    _ => break,
                }
            }
            room
        };
        let at = |share: f64| on_line(&self.line, share);
        self.room = [end(at(0.15), at(0.0)), end(at(0.85), at(1.0))];
    }

    /// [`Self::share`] less what the step between its sides makes: a needle has the same on both sides,
    /// a rim or a reflection along an edge has not.
    pub(super) fn plain(&self) -> f64 {
        self.share * (1.0 - EDGE * self.step)
    }

    /// Whether it stands out as a needle does.
    pub(super) fn stands_out(&self) -> bool {
        self.plain() >= PLAIN
    }

    /// Length of the polygon \[px\].
    pub(super) fn length(&self) -> f64 {
        self.line.windows(2).map(|w| (w[1] - w[0]).norm()).sum()
    }

    /// Distances of the first and the last point from the border of an image of `size` \[px\].
    pub(super) fn borders(&self, size: (f64, f64)) -> [f64; 2] {
        let border = |p: Option<&Vector2<f64>>| {
            p.map_or(0.0, |p| {
                let x = p.x.min(size.0 - 1.0 - p.x);
                x.min(p.y).min(size.1 - 1.0 - p.y)
            })
        };
        [border(self.line.first()), border(self.line.last())]
    }

    /// Whether the image goes on beyond the last point: else it is cut off there, and is no tip.
    pub(super) fn ends(&self) -> bool {
        self.room[1] >= self.beyond()
    }

    /// How far the image must go on beyond a tip \[px\].
    fn beyond(&self) -> f64 {
        6.0 + self.width
    }

    /// Whether this is the needle that was seen before, longer or shorter.
    pub(super) fn continues(&self, before: &Curve2) -> bool {
        let reach = 2.0 * self.width + 0.05 * before.length();
        let near = |p: Vector2<f64>| {
            let places = (0..=60).filter_map(|k| on_line(&self.line, f64::from(k) / 60.0));
            places.map(|q| (p - q).norm()).fold(f64::INFINITY, f64::min) < reach
        };
        let shared = (0..=20).filter(|k| near(before.at(f64::from(*k) / 20.0)));
        shared.count() > 10
    }

    /// The same line from its other end.
    pub(super) fn reversed(&self) -> Self {
        let mut other = self.clone();
        other.line.reverse();
        other.room.reverse();
        other
    }
}

/// Candidates in `image`, the most evident first; with a `background`, in what differs from it.
pub(super) fn candidates(image: &GrayImage, background: Option<&Background>) -> Vec<Candidate> {
    let mut all = Vec::new();
    for rows in [true, false] {
        let scan = Scan::new(image, background, rows);
        search(&scan, &mut all);
    }
    for candidate in &mut all {
        candidate.look_beyond(image);
    }
    // A short piece of anything is like a needle.
    all.retain(|c| c.length() > SLENDER * c.width);
    all.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in all {
        if kept.len() == KEPT {
            break;
        }
        if !kept.iter().any(|better| same(better, &candidate)) {
            kept.push(candidate);
        }
    }
    kept
}

/// Chains of one direction.
fn search(scan: &Scan, all: &mut Vec<Candidate>) {
    let least = FAINT.max(NOISE * scan.noise());
    let mut chains = Chains::new(scan.lines());
    let mut finder = band::Finder::default();
    for samples in scan.iter() {
        let bands = finder.bands(samples, least);
        chains.push(&bands, scan.step);
    }
    for _ in 0..CHAINS {
        let Some(chain) = chains.take() else { return };
        all.extend(candidate(scan, &chain));
    }
}

fn candidate(scan: &Scan, chain: &[(usize, Band)]) -> Option<Candidate> {
    let mut contrasts: Vec<f32> = chain.iter().map(|(_, b)| b.contrast).collect();
    let contrast = median(&mut contrasts)?;
    let typical = |(_, band): &&(usize, Band)| band.contrast >= ENDS * contrast;
    let first = chain.iter().position(|b| typical(&b))?;
    let last = chain.iter().rposition(|b| typical(&b))?;
    let chain = chain.get(first..=last)?;
    if chain.len() < SHORTEST {
        return None;
    }
    let line: Vec<_> = chain
        .iter()
        .map(|(line, band)| {
            let there = scan.place(*line);
            if scan.rows {
                Vector2::new(band.at, there)
            } else {
                Vector2::new(there, band.at)
            }
        })
        .collect();
    let mut widths: Vec<f32> = chain
        .windows(2)
        .map(|w| {
            // Across the needle a band is narrower than along the line.
            let slope = (w[1].1.at - w[0].1.at) / ((w[1].0 - w[0].0) as f64 * scan.step);
            w[1].1.width as f32 / slope.hypot(1.0) as f32
        })
        .collect();
    let width = f64::from(median(&mut widths)?);
    let sum: f32 = chain.iter().map(|(_, b)| b.contrast).sum();
    let mean = f64::from(sum) / chain.len() as f64;
    let bright = chain.first()?.1.bright;
    let mut levels: Vec<f32> = chain.iter().map(|(_, b)| b.level).collect();
    let level = median(&mut levels)?;
    let mut steps: Vec<f32> = chain.iter().map(|(_, b)| b.step).collect();
    let room = if bright { WHITE - level } else { level };
    let mut candidate = Candidate {
        line,
        width,
        contrast: f64::from(contrast),
        bright,
        share: f64::from(contrast / room.max(DIM)),
        room: [0.0; 2],
        step: f64::from(median(&mut steps)? / contrast),
        evidence: 0.0,
    };
    let cover = chain.len() as f64 / (chain.last()?.0 - chain.first()?.0 + 1) as f64;
    candidate.evidence = mean * candidate.length() * cover;
    Some(candidate)
}

/// Whether most of `other` lies on `better`.
fn same(better: &Candidate, other: &Candidate) -> bool {
    let near = |p: &Vector2<f64>| {
        let apart = better.line.iter().map(|q| (p - q).norm());
        apart.fold(f64::INFINITY, f64::min) < better.width.max(8.0)
    };
    let shared = other.line.iter().filter(|p| near(p)).count();
    better.bright == other.bright && 2 * shared > other.line.len()
}

fn median(values: &mut [f32]) -> Option<f32> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}
