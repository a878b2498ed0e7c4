//! The tip of a needle whose end tapers, or fades, in a way that is not known: where its darkness
//! falls to half of the shaft's for good.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "widths in pixels are small and positive"
)]

use hal::GrayImage;
use nalgebra::Vector2;

use super::background::Background;
use super::curve::{Curve2, normal};
use super::section::{beside, mass};
use super::tip::TipFix;

/// Places along the shaft at which its darkness is measured.
const PLACES: usize = 24;
/// Where the shaft's darkness is measured, before the end of the line and then before the tip found
/// so, in widths: nearer the needle may taper already, farther it may be seen in another light.
const BEFORE_LINE: [f64; 2] = [12.0, 4.0];
const BEFORE_TIP: [f64; 2] = [8.0, 2.5];
/// It is measured on the curve, within this share of it.
const WITHIN: f64 = 0.9;
/// A needle this much fainter over so many widths has ended; over less it may be a highlight.
const HALF: f64 = 0.5;
const FOR_GOOD: f64 = 4.0;
/// Least darkness of a shaft, as a share of a black one's: an empty run fits anything.
const LEAST: f64 = 0.1;
/// How far before the reach the shaft is sought, in widths, and at most this share of the curve.
const BACK: (f64, f64) = (10.0, 0.6);
/// How far beyond the curve's end the needle may go on, as a share of the curve.
const FARTHEST: f64 = 0.6;
/// Sections to either side by which the fall is placed, and how far they reach, in widths.
const AROUND: usize = 4;
const ROUND: f64 = 0.6;
/// Standard deviation of the place found, in widths: what changes from image to image. What stays is
/// [`LASTING`].
const SIGMA: f64 = 0.05;
/// Standard deviation of where the needle ends about where it is half as dark, in widths: how it tapers is
/// not known.
pub(super) const LASTING: f64 = 0.25;

struct Sections<'a> {
    image: &'a GrayImage,
    background: &'a Background,
    curve: &'a Curve2,
    /// \[px\]
    across: f64,
    /// Of the curve \[px\], and its speed at its end.
    length: f64,
    speed: f64,
}

impl Sections<'_> {
    /// Darkness across the needle, `ahead` of the curve's end \[px\]; nothing outside the image.
    fn darkness(&self, ahead: f64) -> Option<f64> {
        let t = 1.0 + ahead.min(0.0) / self.speed;
        let tangent = self.curve.derivative(t).try_normalize(1e-9)?;
        let centre = self.curve.at(t) + tangent * ahead.max(0.0);
        self.at(centre, normal(&tangent))
    }

    /// Mean of two sections a pixel apart, from `ahead` on.
    fn smooth(&self, ahead: f64) -> Option<f64> {
        Some(0.5 * (self.darkness(ahead)? + self.darkness(ahead + 1.0)?))
    }

    fn at(&self, centre: Vector2<f64>, aside: Vector2<f64>) -> Option<f64> {
        let (image, background) = (self.image, self.background);
        let even = beside(image, background, centre, aside, self.across + 1.5)?;
        let [dark, _] = mass(image, background, centre, aside, self.across as usize, even)?;
        Some(dark / even)
    }

    /// Where the darkness falls through `half` near `place`, by the line through the sections around.
    fn fall(&self, place: f64, half: f64, width: f64) -> Option<f64> {
        let spacing = ROUND * width / AROUND as f64;
        let (mut dark, mut slope, mut squares) = (0.0, 0.0, 0.0);
        for k in 0..=2 * AROUND {
            let u = (k as f64 - AROUND as f64) * spacing;
            let here = self.darkness(place + u)?;
            dark += here / (2 * AROUND + 1) as f64;
            slope += u * here;
            squares += u * u;
        }
        let moved = if slope < 0.0 {
            (half - dark) * squares / slope
        } else {
            0.0
        };
        Some(place + moved.clamp(-0.5 * width, 0.5 * width))
    }

    /// Median darkness of the shaft between two distances `before` the place `end` \[px\].
    fn shaft(&self, end: f64, before: [f64; 2]) -> Option<f64> {
        let [from, to] = before.map(|d| (end - d).clamp(-WITHIN * self.length, 0.0));
        let mut found = [0.0; PLACES];
        let mut count = 0;
        for k in 0..PLACES {
            let ahead = from + (to - from) * (k as f64 + 0.5) / PLACES as f64;
            if let Some(dark) = self.darkness(ahead) {
                *found.get_mut(count)? = dark;
                count += 1;
            }
        }
        let found = found.get_mut(..count)?;
        found.sort_unstable_by(f64::total_cmp);
        found.get(count / 2).copied()
    }

    /// Where the darkness falls below `half` for good, sought from `reach` \[px\] before the end
    /// of the line on.
    fn end(&self, half: f64, width: f64, reach: f64) -> Option<f64> {
        // Sections this far apart tell where the needle is and where not.
        let step = (width / 6.0).max(1.0);
        let mut ahead = -reach.min(BACK.1 * self.length);
        // The line may go on far into the taper, or into what looks like a needle.
        let back = (reach + BACK.0 * width).min(BACK.1 * self.length);
        while self.smooth(ahead)? < half {
            ahead -= step;
            if ahead < -back {
                return None;
            }
        }
        // Where the needle ended, and the first section without it.
        let mut end: Option<(f64, f64)> = None;
        let mut before: Option<f64> = None;
        while ahead <= FARTHEST * self.length {
            let Some(dark) = self.smooth(ahead) else {
                // Beyond the border nothing is seen of it.
                break;
            };
            if dark >= half {
                end = None;
            } else if let (None, Some(before)) = (end, before) {
                let share = (before - half) / (before - dark).max(1e-9);
                end = Some((ahead - step + 0.5 + share * step, ahead));
            }
            if let Some((_, from)) = end
                && ahead - from >= FOR_GOOD * width
            {
                break;
            }
            before = (dark >= half).then_some(dark);
            ahead += step;
        }
        self.fall(end?.0, half, width)
    }
}

/// Finds the end of the needle along `curve`, up to `reach` \[px\] before its end and as far beyond
/// it as the needle goes on. Nothing where it does not end in the image, or where there is none.
pub(super) fn find(
    image: &GrayImage,
    background: &Background,
    curve: &Curve2,
    width: f64,
    reach: f64,
) -> Option<TipFix> {
    let sections = Sections {
        image,
        background,
        curve,
        across: (0.5 * width + 1.5).round(),
        length: curve.length(),
        speed: curve.derivative(1.0).norm().max(1.0),
    };
    let mut place = 0.0;
    for before in [BEFORE_LINE, BEFORE_TIP] {
        let dark = sections.shaft(place, before.map(|widths| widths * width))?;
        if dark < LEAST * width {
            return None;
        }
        place = sections.end(HALF * dark, width, reach)?;
    }
    Some(TipFix {
        shift: place,
        sigma: SIGMA * width,
        misfit: 0.0,
        side: 1.0,
        leaning: None,
    })
}
