//! Finding the needle along a line, to begin with.

use hal::GrayImage;
use nalgebra::Vector2;

use super::{Flaw, ImageTracker, Look, SURVIVORS};
use crate::track::background::PAINTED;
use crate::track::curve::{Curve2, MOST, normal, weights};
use crate::track::filter::{CurveFilter, Offset};
use crate::track::section::{Expected, cross};

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
        if !self.background.fits(image) {
            return Err(Flaw::Shaft);
        }
        let first = self.along(image, line, reach, look).ok_or(Flaw::Shaft)?;
        let curve = self.extent(image, &first, look).ok_or(Flaw::Tip)?;
        if curve.length() < self.settings.visible_px * self.scale {
            return Err(Flaw::Shaft);
        }
        if self.background.images() == 0 {
            self.background.learn(image);
        }
        self.paint_out(&curve, look);
        let mut filter = CurveFilter::new(&curve, 3.0 * self.scale);
        self.bad = 1;
        self.jumped = None;
        self.shaft(image, &mut filter, look, 1.0)?;
        filter.free_tip(self.settings.search_px * self.scale);
        if !self.tip(image, &mut filter, look)? {
            // Where a bubble ends is not where the needle does.
            return Err(Flaw::Tip);
        }
        if filter.curve().length() < self.settings.visible_px * self.scale {
            return Err(Flaw::Shaft);
        }
        let curve = filter.curve();
        self.gate = (curve.at(0.0), curve.derivative(0.0).normalize());
        self.bad = 0;
        self.filter = Some(filter);
        Ok(())
    }

    /// A smooth curve through the shaft near `line`.
    fn along(
        &mut self,
        image: &GrayImage,
        line: &[Vector2<f64>],
        reach: f64,
        look: &Look,
    ) -> Option<Curve2> {
        let count = self.settings.control_points;
        let mut points = [Vector2::zeros(); MOST];
        for (i, point) in points.iter_mut().enumerate().take(count) {
            *point = on_line(line, i as f64 / (count - 1) as f64)?;
        }
        let guess = Curve2::new(count, points);
        let mut filter = CurveFilter::new(&guess, reach);
        self.offsets.clear();
        for k in 0..self.settings.normals {
            let t = (k as f64 + 0.5) / self.settings.normals as f64;
            let tangent = guess.derivative(t).try_normalize(1e-6)?;
            let direction = normal(&tangent);
            let expected = Expected {
                width: look.width,
                reach,
                contrast: self.contrast,
                noise: self.noise,
            };
            let section = cross(image, &self.background, guess.at(t), direction, &expected);
            if let Some(section) = section {
                // Loose, so that smooth misfits of the guess are no outliers.
                let variance = self.scale * self.scale;
                let row = weights(count, t);
                self.offsets
                    .push(Offset::new(row, direction, section.offset, variance));
            }
        }
        if self.offsets.len() < SURVIVORS.1 {
            return None;
        }
        let solution = self.robust(&mut filter, look, 1.0)?;
        filter.accept(&solution);
        Some(filter.curve())
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
        let first = loop {
            if t > 1.0 {
                return None;
            }
            if seen(t) && seen(t + 2.0 * step) && seen(t + 4.0 * step) {
                break t;
            }
            t += step;
        };
        let most = 1.0 + 40.0 * self.scale * step;
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
        let count = self.settings.control_points;
        let mut points = [Vector2::zeros(); MOST];
        for (i, point) in points.iter_mut().enumerate().take(count) {
            *point = curve.at(first + (last - first) * i as f64 / (count - 1) as f64);
        }
        Some(Curve2::new(count, points))
    }

    /// Takes the needle out of a background that was learned with it.
    fn paint_out(&mut self, curve: &Curve2, look: &Look) {
        let half = 0.5 * look.width + 2.5 * self.scale;
        let steps = (curve.length() / PAINTED).ceil();
        let margin = (look.bevel_px + 8.0 * self.scale) / curve.length().max(1.0);
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

/// Point at a share of a polygon's length.
fn on_line(line: &[Vector2<f64>], share: f64) -> Option<Vector2<f64>> {
    let pieces = || {
        line.windows(2)
            .filter_map(|w| Some((*w.first()?, *w.last()?)))
    };
    let total: f64 = pieces().map(|(a, b)| (b - a).norm()).sum();
    let mut left = share * total;
    for (a, b) in pieces() {
        let piece = (b - a).norm();
        if left <= piece && piece > 0.0 {
            return Some(a + (b - a) * (left / piece));
        }
        left -= piece;
    }
    line.last().copied()
}
