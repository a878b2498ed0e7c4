//! Finding the needle along a line, to begin with.

use hal::GrayImage;
use nalgebra::Vector2;

use super::{Flaw, ImageTracker, Look, SURVIVORS};
use crate::track::background::PAINTED;
use crate::track::blur;
use crate::track::curve::{Curve2, MOST, normal, weights};
use crate::track::filter::{Change, CurveFilter, Offset};
use crate::track::matching::on_line;
use crate::track::profile;
use crate::track::section::{Expected, cross};

/// Ratios of the blur found to the one given between which that is believed: a needle's rounding
/// and highlights look like blur.
const BLUR: [f64; 2] = [0.5, 1.8];
/// Limits of a blur found \[px\].
const LEAST_BLUR: f64 = 0.4;
const MOST_BLUR: f64 = 8.0;

/// How far beside a needle its profile is looked at, at least and at most \[px\].
const BESIDE: [f64; 2] = [4.0, 10.0];

/// Blurs beyond its edge at which a needle has faded.
const FADED: f64 = 2.0;
/// Misfit up to which a tip of unknown form is flat.
const FLAT: f64 = 0.08;

/// How a needle stands out from an image.
#[derive(Clone, Copy, Debug)]
pub(in crate::track) struct Seen {
    /// Brighter than the background.
    pub bright: bool,
    /// Difference of the grey levels.
    pub contrast: f64,
    /// Control points that its curve takes.
    pub points: usize,
}

impl ImageTracker {
    /// Begins along `line`, from where the needle comes into sight to about its tip \[px\]; the
    /// needle is sought up to `reach` from it, and beyond its end.
    ///
    /// # Errors
    /// No needle was found there.
    pub fn start(
        &mut self,
        image: &GrayImage,
        line: &[Vector2<f64>],
        reach: f64,
        look: &Look,
    ) -> Result<(), Flaw> {
        self.begin(image, line, reach, look, None)
    }

    /// [`Self::start`] with a dark needle, and where there is none, with a bright one.
    pub(in crate::track) fn start_dark_or_bright(
        &mut self,
        image: &GrayImage,
        line: &[Vector2<f64>],
        reach: f64,
        look: &Look,
    ) -> Result<(), Flaw> {
        let bright = self.hints.bright.unwrap_or(false);
        self.background.set_bright(bright);
        self.start(image, line, reach, look).or_else(|flaw| {
            if self.hints.bright.is_some() {
                return Err(flaw);
            }
            self.background.set_bright(true);
            let begun = self.start(image, line, reach, look);
            self.background.set_bright(begun.is_ok());
            begun.map_err(|_| flaw)
        })
    }

    /// [`Self::start`], where it is known how the needle stands out from the image.
    pub(in crate::track) fn begin(
        &mut self,
        image: &GrayImage,
        line: &[Vector2<f64>],
        reach: f64,
        look: &Look,
        seen: Option<&Seen>,
    ) -> Result<(), Flaw> {
        if !self.background.fits(image) {
            return Err(Flaw::NOTHING);
        }
        if let Some(seen) = seen {
            self.background.set_bright(seen.bright);
            self.contrast = seen.contrast / self.level(line).max(1.0);
            self.points = seen.points;
        }
        let first = self.along(image, line, reach, look, seen.is_some())?;
        let curve = self.extent(image, &first, look).ok_or(Flaw::Tip)?;
        let shortest = self.settings.visible_px * self.scale;
        if curve.length() < shortest {
            return Err(Flaw::Short);
        }
        if self.background.images() == 0 {
            self.background.learn(image);
        }
        self.paint_out(&curve, look);
        let mut filter = CurveFilter::new(&curve, 3.0 * self.scale);
        self.bad = 1;
        self.jumped = None;
        self.tapers = false;
        // Once a normal a pixel: what is found now is what the search hands on.
        self.shaft(image, &mut filter, look, 1.0, usize::MAX)?;
        filter.free_tip(self.settings.search_px * self.scale);
        let shaft = filter.clone();
        let mut found = self.tip(image, &mut filter, look, false);
        let flat = found.is_ok() && self.fits_flat();
        if !flat && seen.is_some() && look.bevel_px < 1.0 {
            // No flat end: a bevel of unknown length, or one that light and blur wash out.
            filter = shaft;
            self.tapers = true;
            self.jumped = None;
            found = self.tip(image, &mut filter, look, false);
        }
        if !found? {
            // Where a bubble ends is not where the needle does.
            return Err(Flaw::Tip);
        }
        if filter.curve().length() < shortest {
            return Err(Flaw::Short);
        }
        let curve = filter.curve();
        self.gate = (curve.at(0.0), curve.derivative(0.0).normalize());
        self.bad = 0;
        self.filter = Some(filter);
        Ok(())
    }

    /// Measures the tip once more, as it is seen from where it is now known to be; `tapers` as it
    /// does in the other image.
    ///
    /// # Errors
    /// The needle ends nowhere.
    pub(in crate::track) fn end_again(
        &mut self,
        image: &GrayImage,
        look: &Look,
        tapers: bool,
    ) -> Result<(), Flaw> {
        let Some(mut filter) = self.filter.take() else {
            return Err(Flaw::Tip);
        };
        self.tapers = tapers;
        filter.free_tip(self.settings.search_px * self.scale);
        // Sought as far as to begin with.
        self.bad = 1;
        let found = self.tip(image, &mut filter, look, false);
        self.bad = 0;
        self.filter = Some(filter);
        if found? { Ok(()) } else { Err(Flaw::Tip) }
    }

    /// Whether the newest tip looks like a flat end.
    pub(in crate::track) fn fits_flat(&self) -> bool {
        self.misfit < FLAT
    }

    /// Grey level of the background in the middle of a line.
    fn level(&self, line: &[Vector2<f64>]) -> f64 {
        on_line(line, 0.5).map_or(1.0, |middle| self.background.mean_at(middle))
    }

    /// Lets the curve begin at the share `start` of it: both images must show what is joined.
    pub(in crate::track) fn cut(&mut self, start: f64) {
        if let Some(filter) = &mut self.filter {
            filter.predict(&Change {
                start,
                ..Change::default()
            });
            let curve = filter.curve();
            self.gate = (curve.at(0.0), curve.derivative(0.0).normalize());
        }
    }

    /// A smooth curve through the shaft near `line`; width and blur by its profile where it was `sought`.
    fn along(
        &mut self,
        image: &GrayImage,
        line: &[Vector2<f64>],
        reach: f64,
        look: &Look,
        sought: bool,
    ) -> Result<Curve2, Flaw> {
        let count = self.points;
        let mut points = [Vector2::zeros(); MOST];
        for (i, point) in points.iter_mut().enumerate().take(count) {
            *point = on_line(line, i as f64 / (count - 1) as f64).ok_or(Flaw::NOTHING)?;
        }
        let guess = Curve2::new(count, points);
        let mut filter = CurveFilter::new(&guess, reach);
        self.offsets.clear();
        let (mut width, mut steepness) = (0.0, 0.0);
        let mut middles = Vec::with_capacity(self.settings.normals);
        for k in 0..self.settings.normals {
            let t = (k as f64 + 0.5) / self.settings.normals as f64;
            let tangent = guess.derivative(t).try_normalize(1e-6);
            let direction = normal(&tangent.ok_or(Flaw::NOTHING)?);
            let expected = Expected {
                width: look.width,
                reach,
                contrast: self.contrast,
                noise: self.noise,
            };
            let section = cross(image, &self.background, guess.at(t), direction, &expected);
            if let Some(section) = section {
                width += section.width;
                steepness += section.steepness;
                middles.push((guess.at(t) + direction * section.offset, direction));
                // Loose, so that smooth misfits of the guess are no outliers.
                let variance = self.scale * self.scale;
                let row = weights(count, t);
                self.offsets
                    .push(Offset::new(row, direction, section.offset, variance));
            }
        }
        let agree = self.offsets.len();
        let flaw = Flaw::Shaft {
            agree,
            of: self.settings.normals,
        };
        if agree < SURVIVORS.1 {
            return Err(flaw);
        }
        let width = width / agree as f64;
        let found = if sought {
            profile::fitted(&self.profile(image, &middles, width), width)
        } else {
            blur::estimate(width, steepness / agree as f64)
        };
        let given = self.given_blur();
        let ratio = found.blur / given;
        self.sharp = found.width / look.width;
        self.blur = if self.hints.blur_px.is_some() || (ratio > BLUR[0] && ratio < BLUR[1]) {
            given
        } else {
            found.blur.clamp(LEAST_BLUR, MOST_BLUR)
        };
        let solution = self.robust(&mut filter, look, 1.0, 1.0).ok_or(flaw)?;
        filter.accept(&solution);
        Ok(filter.curve())
    }

    /// Mean darkness across the needle at every pixel from its `middles` on outwards, each with the
    /// direction across; both sides averaged.
    fn profile(
        &self,
        image: &GrayImage,
        middles: &[(Vector2<f64>, Vector2<f64>)],
        width: f64,
    ) -> Vec<f64> {
        let beside = (0.75 * width).clamp(BESIDE[0], BESIDE[1]);
        let reach = (0.5 * width + beside).ceil() as usize;
        let (mut sums, mut count) = (vec![0.0; reach + 1], 0.0);
        let mut samples = vec![0.0; 2 * reach + 1];
        for (middle, direction) in middles {
            let start = middle - direction * reach as f64;
            let line = self.background.line(image, start, *direction, &mut samples);
            if line.is_none() {
                continue;
            }
            count += 1.0;
            for (k, sum) in sums.iter_mut().enumerate() {
                let pair = samples[reach + k] + samples[reach - k];
                *sum -= 0.5 * f64::from(pair);
            }
        }
        for sum in &mut sums {
            *sum /= f64::max(count, 1.0);
        }
        sums
    }

    /// The part of `curve`, prolonged, that shows a needle.
    fn extent(&self, image: &GrayImage, curve: &Curve2, look: &Look) -> Option<Curve2> {
        let length = curve.length();
        let step = 1.0 / length;
        let expected = Expected {
            width: look.width,
            reach: 2.0 * self.scale,
            contrast: self.contrast,
            noise: self.noise,
        };
        let seen = |t: f64| {
            let tangent = curve.derivative(t).normalize();
            let direction = normal(&tangent);
            cross(image, &self.background, curve.at(t), direction, &expected).is_some()
        };
        let patience = (8.0 * self.scale) as u32;
        // A little before the line, too: a model may have the needle too short.
        let mut t = -6.0 * self.scale * step;
        let most = 1.0 + 40.0 * self.scale * step;
        // Of what is seen of it the longest: where needle and surface cross it may be seen, too.
        let mut longest: Option<(f64, f64)> = None;
        while t <= 1.0 {
            if !(seen(t) && seen(t + 2.0 * step) && seen(t + 4.0 * step)) {
                t += step;
                continue;
            }
            let first = t;
            let (mut last, mut missed, mut run) = (first, 0, 0);
            // Within the line more may be hidden, by a bar or a bubble; but a stretch must follow.
            while t < most && missed < if t < 1.0 { 4 * patience } else { patience } {
                t += step;
                if seen(t) {
                    run += 1;
                    if missed < patience || run >= patience {
                        (last, missed) = (t, 0);
                    }
                } else {
                    run = 0;
                    missed += 1;
                }
            }
            if longest.is_none_or(|(from, to)| last - first > to - from) {
                longest = Some((first, last));
            }
        }
        let (first, last) = longest?;
        let count = self.points;
        let mut points = [Vector2::zeros(); MOST];
        for (i, point) in points.iter_mut().enumerate().take(count) {
            *point = curve.at(first + (last - first) * i as f64 / (count - 1) as f64);
        }
        Some(Curve2::new(count, points))
    }

    /// Takes the needle out of a background that was learned with it.
    fn paint_out(&mut self, curve: &Curve2, look: &Look) {
        let half = 0.5 * look.width + (2.5 * self.scale).max(FADED * self.blur);
        let steps = (curve.length() / PAINTED).ceil();
        // The tip may be a good deal farther on than the shaft's even part.
        let ahead = (8.0 * self.scale).max(3.0 * look.width);
        let margin = (look.bevel_px + ahead) / curve.length().max(1.0);
        let mut step = 0.0;
        while step <= steps {
            let t = (1.0 + margin) * step / steps;
            let tangent = curve.derivative(t).normalize();
            let aside = normal(&tangent) * half;
            let centre = curve.at(t);
            self.background.paint_out(centre - aside, centre + aside);
            step += 1.0;
        }
    }
}
