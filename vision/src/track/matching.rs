//! Which candidates of the two images are of one needle.
//!
//! A pixel of the left image lies on a line of sight, which is a curve in the right image: where
//! that meets a candidate there, a point in space follows. So no scene is assumed, and the two
//! candidates need not begin at the same place of the needle.

use nalgebra::{Matrix2, Vector2, Vector3};

use super::find::Candidate;
use crate::camera::{DistortedPx, View, triangulate};

/// Places along a candidate that are matched.
const PLACES: usize = 13;
/// Points of a line of sight.
const SIGHTS: usize = 24;
/// Nearest and farthest point of a line of sight, in baselines; with a window from its inner
/// face on, in metres.
const IN_AIR: [f64; 2] = [0.3, 60.0];
const IN_GEL: [f64; 2] = [5e-4, 1.0];
/// Share of its length by which a candidate may go on beyond its ends.
const BEYOND: f64 = 0.2;
/// Sine of the angle between needle and line of sight in an image below which they are one line.
const ALONG: f64 = 0.1;
/// Shares of the left candidate that must be matched.
const OVERLAP: f64 = 0.35;
/// Ratios by which widths and contrasts of one needle differ in two images (1 sigma), as
/// logarithms.
const WIDTHS: f64 = 0.35;
const CONTRASTS: f64 = 0.9;
/// The same of a diameter given by hand; the factor by which it is never off, and how much wider
/// than it blur makes a needle \[px\].
const DIAMETERS: f64 = 0.7;
const WRONG: f64 = 2.6;
const BLURRED: f64 = 8.0;

/// A tip is not so many times nearer to the border than where the needle comes in; so near to the
/// border distances do not matter \[px\].
const INWARDS: f64 = 3.0;
const NEAR: f64 = 20.0;

/// Two lines, tips last, and the points in space that they make.
#[derive(Clone, Debug)]
pub(super) struct Match {
    /// Of the lines' lengths, where what both show begins.
    pub starts: [f64; 2],
    /// From there on, evenly along the left line; the tip last \[m\].
    pub points: Vec<Vector3<f64>>,
    /// Disagreement of the tips along the right line \[px\].
    pub tips_apart: f64,
    /// Share of both lines that is matched.
    pub overlap: f64,
}

/// Candidates that may be one needle.
#[derive(Clone, Debug)]
pub(super) struct Pairing {
    /// Left and right, the tip last.
    pub candidates: [Candidate; 2],
    /// In space.
    pub place: Match,
    /// Diameter that the widths make in either image \[m\].
    pub diameters: [f64; 2],
    /// How much speaks for it \[grey px\].
    pub evidence: f64,
}

/// Lines of sight of a line's places, as curves in the other image.
struct Sights {
    length: f64,
    /// Place \[px\] and curve of each.
    curves: Vec<(Vector2<f64>, Vec<Vector2<f64>>)>,
}

/// All pairs that geometry and looks allow, the best first; each in both directions. The needle's
/// `diameter` \[m\] may be off by a factor of 2.
pub(super) fn pairings(
    views: &[View; 2],
    candidates: &[Vec<Candidate>; 2],
    diameter: f64,
) -> Vec<Pairing> {
    let mut all = Vec::new();
    for left in &candidates[0] {
        let sights = sights(views, &left.line);
        for right in &candidates[1] {
            if left.bright != right.bright {
                continue;
            }
            let flipped = right.reversed();
            for right in [right, &flipped] {
                let Some(place) = meet(views, &sights, &right.line) else {
                    continue;
                };
                all.extend(pairing(views, [left, right], place, diameter));
                // The other end may be the tip.
                let turned = [left.reversed(), right.reversed()];
                let sights = self::sights(views, &turned[0].line);
                if let Some(place) = meet(views, &sights, &turned[1].line) {
                    all.extend(pairing(views, [&turned[0], &turned[1]], place, diameter));
                }
            }
        }
    }
    all.retain(|pairing| pairing.evidence > 0.0);
    all.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    all
}

/// Matches two lines whose tips are last.
pub(super) fn matched(views: &[View; 2], lines: [&[Vector2<f64>]; 2]) -> Option<Match> {
    meet(views, &sights(views, lines[0]), lines[1])
}

fn sights(views: &[View; 2], line: &[Vector2<f64>]) -> Sights {
    let [left, right] = views;
    let baseline = (left.camera_from_left.inverse() * right.camera_from_left)
        .translation
        .vector
        .norm();
    let [near, far] = if left.window.is_some() {
        IN_GEL
    } else {
        IN_AIR.map(|share| share * baseline)
    };
    let ratio = (far / near).ln();
    let length = length(line);
    let curve = |at: Vector2<f64>| {
        let Some(ray) = left.ray(DistortedPx(at.into())) else {
            return Vec::new();
        };
        (0..SIGHTS)
            .filter_map(|k| {
                let share = k as f64 / (SIGHTS - 1) as f64;
                let point = ray.origin + ray.direction * (near * (ratio * share).exp());
                right.project(&point).map(|px| px.0.coords)
            })
            .collect()
    };
    let curves = (0..PLACES).filter_map(|i| {
        let at = on_line(line, i as f64 / (PLACES - 1) as f64)?;
        Some((at, curve(at)))
    });
    Sights {
        length,
        curves: curves.collect(),
    }
}

fn meet(views: &[View; 2], sights: &Sights, right: &[Vector2<f64>]) -> Option<Match> {
    let reach = length(right);
    let (first, last) = (right.first()?, right.last()?);
    let span = (last - first).norm();
    // A little beyond both ends, straight on.
    let ahead = (on_line(right, 1.0)? - on_line(right, 0.8)?).try_normalize(1e-9)?;
    let back = (on_line(right, 0.0)? - on_line(right, 0.2)?).try_normalize(1e-9)?;
    let mut long = vec![first + back * (BEYOND * reach)];
    long.extend((0..=PLACES).filter_map(|k| on_line(right, k as f64 / PLACES as f64)));
    long.push(last + ahead * (BEYOND * reach));
    let mut hits: Vec<(usize, f64, Vector2<f64>)> = Vec::new();
    let mut sines = Vec::new();
    for (i, (_, curve)) in sights.curves.iter().enumerate() {
        let wanted = hits.last().map_or(-BEYOND, |hit| hit.1);
        let crossings = crossings(curve, &long);
        // Of several the next one on: a needle does not go back.
        let next = crossings
            .into_iter()
            .filter(|c| c.share >= wanted - 0.02)
            .min_by(|a, b| a.share.total_cmp(&b.share));
        if let Some(c) = next {
            hits.push((i, c.share, c.at));
            sines.push(c.sine);
        }
    }
    sines.sort_by(f64::total_cmp);
    let across = sines.get(sines.len() / 2).copied().unwrap_or(0.0);
    if span < 1.0 || hits.len() < PLACES / 3 || across < ALONG {
        // Along the lines of sight nothing is known of the depth.
        return None;
    }
    let within = |share: f64| (-0.06..=1.06).contains(&share);
    let inside: Vec<_> = hits.iter().filter(|hit| within(hit.1)).collect();
    let (start, end) = (inside.first()?, inside.last()?);
    let part = |i: usize| i as f64 / (PLACES - 1) as f64;
    let left_share = part(end.0) - part(start.0);
    let right_share = (end.1 - start.1).clamp(0.0, 1.0);
    if left_share < OVERLAP || right_share < OVERLAP {
        return None;
    }
    let points: Option<Vec<_>> = inside
        .iter()
        .map(|(i, _, at)| point(views, sights.curves[*i].0, *at))
        .collect();
    // How far the right line's end is from where the left tip is seen.
    let tips_apart = match hits.last()? {
        (i, share, _) if *i + 1 == PLACES => (share - 1.0).abs() * reach,
        (i, share, _) => ((1.0 - part(*i)) * sights.length).max((share - 1.0).abs() * reach),
    };
    Some(Match {
        starts: [part(start.0), start.1.clamp(0.0, 1.0)],
        points: points?,
        tips_apart,
        overlap: (left_share * right_share).sqrt(),
    })
}

fn point(views: &[View; 2], left: Vector2<f64>, right: Vector2<f64>) -> Option<Vector3<f64>> {
    let pixels = [left, right].map(|p| DistortedPx(p.into()));
    let found = triangulate(views, &pixels, &[Matrix2::identity(); 2]).ok()?;
    Some(found.position.coords())
}

/// A line of sight that crosses a line.
struct Crossing {
    /// Of the line's length.
    share: f64,
    at: Vector2<f64>,
    /// Of the angle between them.
    sine: f64,
}

/// Where `curve` crosses `long`: a line prolonged at both ends.
fn crossings(curve: &[Vector2<f64>], long: &[Vector2<f64>]) -> Vec<Crossing> {
    let mut found = Vec::new();
    let pieces = long.len().saturating_sub(3).max(1) as f64;
    for sight in curve.windows(2) {
        let along = sight[1] - sight[0];
        for (k, piece) in long.windows(2).enumerate() {
            let step = piece[1] - piece[0];
            let area = along.perp(&step);
            let gap = piece[0] - sight[0];
            let (s, t) = (gap.perp(&step) / area, gap.perp(&along) / area);
            if !((0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t)) {
                continue;
            }
            let share = if k == 0 {
                (t - 1.0) * BEYOND
            } else if k + 2 == long.len() {
                1.0 + t * BEYOND
            } else {
                (k as f64 - 1.0 + t) / pieces
            };
            found.push(Crossing {
                share,
                at: piece[0] + step * t,
                sine: (area / (along.norm() * step.norm())).abs(),
            });
        }
    }
    found
}

fn pairing(
    views: &[View; 2],
    candidates: [&Candidate; 2],
    place: Match,
    diameter: f64,
) -> Option<Pairing> {
    let [left, right] = candidates;
    let middle = place.points.get(place.points.len() / 2)?;
    let axis = (place.points.last()? - place.points.first()?).try_normalize(1e-9)?;
    let mut diameters = [0.0; 2];
    for k in 0..2 {
        let (px, jacobian) = views[k].project_with_derivative(middle)?;
        let sight = views[k].ray(px)?.direction;
        let across = axis.cross(&sight).try_normalize(1e-6)?;
        let metre = (jacobian * across).norm();
        let (width, given) = (candidates[k].width, metre * diameter);
        if width < given / WRONG || width > WRONG * given + BLURRED {
            return None;
        }
        diameters[k] = width / metre;
    }
    let unlike = |a: f64, b: f64, sigma: f64| (-0.5 * ((a / b).ln() / sigma).powi(2)).exp();
    let alike = unlike(diameters[0], diameters[1], WIDTHS)
        * unlike(left.contrast, right.contrast, CONTRASTS);
    let apart = place.tips_apart / (8.0 + 0.08 * right.length());
    let tips = 0.1 + 0.9 * (-0.5 * apart * apart).exp();
    let known = unlike((diameters[0] * diameters[1]).sqrt(), diameter, DIAMETERS);
    let evidence = known
        * (left.evidence * right.evidence).sqrt()
        * alike
        * tips
        * place.overlap
        * free(views, candidates);
    Some(Pairing {
        candidates: [left.clone(), right.clone()],
        place,
        diameters,
        evidence,
    })
}

/// What speaks for the last points being those of a tip: a needle comes in from a border, and its
/// tip is away from it.
fn free(views: &[View; 2], candidates: [&Candidate; 2]) -> f64 {
    if !candidates.iter().all(|c| c.ends()) {
        return 0.0;
    }
    let mut ends = [f64::INFINITY; 2];
    for (view, candidate) in views.iter().zip(candidates) {
        let size = (view.camera.width as f64, view.camera.height as f64);
        for (end, border) in ends.iter_mut().zip(candidate.borders(size)) {
            *end = end.min(border);
        }
    }
    if ends[0] <= ends[1] {
        1.0
    } else if ends[0] < INWARDS * ends[1].max(NEAR) {
        0.5
    } else {
        0.0
    }
}

/// Length of a polygon \[px\].
fn length(line: &[Vector2<f64>]) -> f64 {
    line.windows(2).map(|w| (w[1] - w[0]).norm()).sum()
}

/// Point at a share of a polygon's length.
pub(super) fn on_line(line: &[Vector2<f64>], share: f64) -> Option<Vector2<f64>> {
    let mut left = share * length(line);
    for w in line.windows(2) {
        let piece = (w[1] - w[0]).norm();
        if left <= piece && piece > 0.0 {
            return Some(w[0] + (w[1] - w[0]) * (left / piece));
        }
        left -= piece;
    }
    line.last().copied()
}
