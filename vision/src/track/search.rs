//! Finding the needle anywhere in a pair, and again where it has moved too far.

use hal::GrayImage;
use nalgebra::{DMatrix, Vector2, Vector3};

use super::StereoTracker;
use super::answer::{Context, Loss};
use super::curve::{Curve2, MOST, weights};
use super::find::{Candidate, candidates};
use super::matching::{Pairing, matched, on_line, pairings};
use super::single::{ImageTracker, Seen};
use super::space::Curve3;

/// Share of the best pair's evidence from which on another may be the needle instead.
const RIVAL: f64 = 0.25;
/// Pairs of candidates that are tried.
const TRIED: usize = 8;
/// How far from a candidate's line the shaft is sought \[px\].
const AROUND: f64 = 3.0;
/// Ratios of the diameter found to the one given between which that is believed.
const DIAMETER: [f64; 2] = [0.75, 1.35];
/// How far four in five places of a line may be off a curve of few control points \[px\], in images 640 wide;
/// else it gets more of them.
const WANDER: f64 = 1.5;
/// Points by which a curve is matched.
const POINTS: usize = 25;
/// Places of a line at which it is compared with a curve.
const PLACES: usize = 41;
/// Shift of a start below which both images show the same \[shares\].
const SAME_START: f64 = 0.03;

impl ImageTracker {
    /// What may be a needle in an image, in its own levels and in what differs from the background.
    pub(super) fn candidates(&self, image: &GrayImage) -> Vec<Candidate> {
        let background = self.background();
        let mut found = candidates(image, None);
        if background.images() > 0 {
            found.extend(candidates(image, Some(background)));
        }
        if let Some(bright) = self.hints().bright {
            found.retain(|candidate| candidate.bright == bright);
        }
        found
    }
}

impl StereoTracker {
    /// Finds the needle anywhere in both images; with `before`, only where it goes on from there.
    pub(super) fn search(
        &mut self,
        images: [&GrayImage; 2],
        context: &Context<'_>,
        before: Option<&[Curve2; 2]>,
    ) -> Result<(), Loss> {
        let found = [0, 1].map(|k| self.images[k].candidates(images[k]));
        for (considered, found) in self.tracked.considered.iter_mut().zip(&found) {
            *considered = found.iter().map(|c| c.line.clone()).collect();
        }
        for (k, candidates) in found.iter().enumerate() {
            if candidates.is_empty() {
                self.images[k].learn(images[k]);
                return Err(Loss::NoBand { image: k });
            }
        }
        let pairings = pairings(&self.views, &found, self.needle.diameter);
        let mut loss = Loss::NoMatch {
            bands: [found[0].len(), found[1].len()],
        };
        let best = pairings.first().map_or(0.0, |p| p.evidence);
        let share = |p: &Pairing| p.candidates[0].plain().min(p.candidates[1].plain());
        let plain = |p: &Pairing| p.candidates.iter().all(Candidate::stands_out);
        if let (None, Some(first)) = (before, pairings.first())
            && !plain(first)
        {
            return Err(Loss::Faint {
                share: share(first),
            });
        }
        let goes_on = |pairing: &&Pairing| {
            (before.is_some() || plain(pairing))
                && pairing.evidence > RIVAL * best
                && before.is_none_or(|before| continues(before, pairing))
        };
        let kept = self.images.clone();
        for (tried, pairing) in pairings.iter().filter(goes_on).take(TRIED).enumerate() {
            match self.attempt(images, context, pairing) {
                Ok(curve) => {
                    self.curve = Some(curve);
                    self.losses = 0;
                    return Ok(());
                }
                Err(why) => {
                    if tried == 0 {
                        loss = why;
                    }
                    self.images.clone_from(&kept);
                }
            }
        }
        Err(loss)
    }

    /// A wide search after a needle that went farther than the prediction allows for.
    pub(super) fn far(
        &mut self,
        images: [&GrayImage; 2],
        context: &Context<'_>,
    ) -> Result<(), Loss> {
        // With odometry or a model the prediction is better than a search.
        if context.insertion.is_some() || context.guess.is_some() {
            return Err(Loss::NotFound);
        }
        let [Some(left), Some(right)] = [0, 1].map(|k| self.images[k].curve()) else {
            return Err(Loss::NotFound);
        };
        self.search(images, context, Some(&[left, right]))
    }

    fn attempt(
        &mut self,
        images: [&GrayImage; 2],
        context: &Context<'_>,
        pairing: &Pairing,
    ) -> Result<Curve3, Loss> {
        let points = &pairing.place.points;
        let (Some(tip), Some(start)) = (points.last(), points.first()) else {
            return Err(Loss::NoCurve);
        };
        let axis = (tip - start).normalize();
        let found = (pairing.diameters[0] * pairing.diameters[1]).sqrt();
        let ratio = found / self.needle.diameter;
        self.diameter = if ratio > DIAMETER[0] && ratio < DIAMETER[1] {
            self.needle.diameter
        } else {
            found
        };
        let lines = pairing.candidates.each_ref().map(|c| c.line.as_slice());
        let limit = WANDER * self.images[0].scale().max(1.0);
        let needed = lines.map(|line| points_along(line, self.settings.control_points, limit));
        let count = needed[0].max(needed[1]);
        for k in 0..2 {
            let (look, _) = self.look(k, tip, Some(&axis), context);
            let seen = Seen {
                bright: pairing.candidates[k].bright,
                contrast: pairing.candidates[k].contrast,
                points: count,
            };
            let reach = AROUND * self.images[k].scale().max(1.0);
            let begun = self.images[k].begin(images[k], lines[k], reach, &look, Some(&seen));
            begun.map_err(|flaw| Loss::Start { image: k, flaw })?;
        }
        if self.images[0].tapers() != self.images[1].tapers() {
            self.end_again(images, context, [tip, &axis], true)?;
        }
        let mut curve = self.common_curve(count)?;
        self.fuse(&mut curve, 12)?;
        // A flat end's rim is seen as the tip is turned, not as the line is on the whole.
        let (tip, axis) = (curve.at(1.0), curve.derivative(1.0).normalize());
        let kept = self.images.clone();
        let flat = self.end_again(images, context, [&tip, &axis], false);
        if flat.is_err() || !self.images.iter().all(ImageTracker::fits_flat) {
            self.images = kept;
        }
        self.fuse(&mut curve, 12)?;
        Ok(curve)
    }

    /// Measures the tip once more, tapering or flat as `tapers` says, now that it is known to be
    /// about at `tip` and to point along `axis`.
    fn end_again(
        &mut self,
        images: [&GrayImage; 2],
        context: &Context<'_>,
        [tip, axis]: [&Vector3<f64>; 2],
        tapers: bool,
    ) -> Result<(), Loss> {
        for k in 0..2 {
            let (look, _) = self.look(k, tip, Some(axis), context);
            let again = self.images[k].end_again(images[k], &look, tapers);
            again.map_err(|flaw| Loss::Start { image: k, flaw })?;
        }
        Ok(())
    }

    /// The curve in space that both images' curves make, these cut to what both show.
    fn common_curve(&mut self, count: usize) -> Result<Curve3, Loss> {
        let mut place = None;
        // Once more where one was cut.
        for _ in 0..2 {
            let [Some(left), Some(right)] = [0, 1].map(|k| self.images[k].curve()) else {
                return Err(Loss::NotFound);
            };
            let lines = [left, right].map(|curve| polygon(&curve));
            let found = matched(&self.views, [&lines[0], &lines[1]]).ok_or(Loss::NoCurve)?;
            let mut cut = false;
            for (image, start) in self.images.iter_mut().zip(found.starts) {
                if start > SAME_START {
                    image.cut(start);
                    cut = true;
                }
            }
            place = Some(found);
            if !cut {
                break;
            }
        }
        let found = place.ok_or(Loss::NoCurve)?.points;
        let mut points = [Vector3::zeros(); MOST];
        for (i, point) in points.iter_mut().enumerate().take(count) {
            // Evenly along, between the places matched.
            let at = i * (found.len() - 1);
            let (k, rest) = (at / (count - 1), at % (count - 1));
            let [Some(a), Some(b)] = [found.get(k), found.get((k + 1).min(found.len() - 1))] else {
                return Err(Loss::NoCurve);
            };
            *point = a + (b - a) * (rest as f64 / (count - 1) as f64);
        }
        Ok(Curve3::through(count, points))
    }
}

/// Control points, `least` and more, of the first curve that follows `line` within `limit` \[px\].
fn points_along(line: &[Vector2<f64>], least: usize, limit: f64) -> usize {
    let places = |k: usize| k as f64 / (PLACES - 1) as f64;
    let seen: Option<Vec<_>> = (0..PLACES).map(|k| on_line(line, places(k))).collect();
    let Some(seen) = seen else { return least };
    let far = |count: usize| {
        let rows = DMatrix::from_fn(PLACES, count, |k, i| weights(count, places(k))[i]);
        let there = DMatrix::from_fn(PLACES, 2, |k, axis| seen[k][axis]);
        let points = rows.clone().svd(true, true).solve(&there, 1e-9).ok()?;
        let mut off: Vec<f64> = (rows * points - there)
            .row_iter()
            .map(|row| row.norm())
            .collect();
        off.sort_by(f64::total_cmp);
        off.get(4 * PLACES / 5).copied()
    };
    let enough = |count: &usize| far(*count).is_none_or(|far| far <= limit);
    (least..MOST).find(enough).unwrap_or(MOST)
}

fn polygon(curve: &Curve2) -> Vec<Vector2<f64>> {
    let share = |k: usize| k as f64 / (POINTS - 1) as f64;
    (0..POINTS).map(|k| curve.at(share(k))).collect()
}

/// Whether a pair of candidates is the needle that was seen before.
fn continues(before: &[Curve2; 2], pairing: &Pairing) -> bool {
    let mut both = before.iter().zip(&pairing.candidates);
    both.all(|(curve, candidate)| candidate.continues(curve))
}
