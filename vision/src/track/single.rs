//! Tracking in one image.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates of pixels, checked against the image"
)]

mod begin;
mod doubt;
mod flaw;

pub(super) use begin::Seen;
pub use flaw::Flaw;

use core::hint::black_box;

use hal::GrayImage;
use nalgebra::Vector2;

use super::background::Background;
use super::curve::{Curve2, Weights, normal, weights, weights_and_slopes};
use super::filter::{Change, CurveFilter, Offset, Solution};
use super::section::{Expected, Section, cross, samples};
use super::settings::{Hints, TrackSettings, TrackSettingsError};
use super::tip::{self, TipSearch};
use doubt::{between, doubts, residual};

/// Normals that must agree, as a share of all and at least.
const SURVIVORS: (f64, usize) = (0.35, 8);
/// Fewest normals, on the shortest shafts.
const LEAST: usize = 20;
/// Gate of an innovation, in standard deviations (99.9 %).
const GATE: f64 = 3.3;
/// Misfit of the tip's silhouette above which it is no tip.
const MISFIT: f64 = 0.14;
/// Sharpest bend of a needle relative to its width: twice the elastic limit of steel needles,
/// whose outer fibres strain by 0.35 %.
const BEND: f64 = 0.014;
/// Share of that knowledge which an image adds: the filter remembers it for about as many images.
const BEND_AGAIN: f64 = 1.0 / 30.0;
/// Shaft so short that it must be held straight in every image \[px\], in images 640 wide.
const SHORT: f64 = 60.0;
/// Images that are averaged to a background while no needle is in sight.
const LEARNED: u32 = 16;

/// How the needle appears in one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Width of the shaft \[px\].
    pub width: f64,
    /// Length of the bevel \[px\].
    pub bevel_px: f64,
    /// Sine of the angle between the bevel's direction and the line of sight: 1 when the bevel is
    /// seen from its side; positive where its point lies a quarter turn from the curve's tangent,
    /// from x towards y. Without, it is found in the image.
    pub side: Option<f64>,
    /// How far the rim of a flat end stands before its centre, where the axis is not square to
    /// the line of sight \[px\].
    pub rim_px: f64,
}

/// A line across the needle.
#[derive(Clone, Copy, Debug)]
struct Normal {
    /// Weights of its place on the curve.
    row: Weights,
    place: Vector2<f64>,
    direction: Vector2<f64>,
    expected: Expected,
}

/// Tracks the needle in the images of one camera, in pixels; [`super::StereoTracker`] joins two.
#[derive(Clone, Debug)]
pub struct ImageTracker {
    settings: TrackSettings,
    /// Pixels for one pixel of an image 640 wide.
    scale: f64,
    background: Background,
    filter: Option<CurveFilter>,
    noise: f64,
    contrast: f64,
    normals: Vec<Normal>,
    offsets: Vec<Offset>,
    shares: Vec<f64>,
    sorted: Vec<f64>,
    /// An innovation beyond the gate: the next image decides whether the tip jumped there.
    jumped: Option<Vector2<f64>>,
    /// Where the needle comes into sight, and its direction there.
    gate: (Vector2<f64>, Vector2<f64>),
    bad: u32,
    /// How far the bevel leans to one side in the newest image; see [`super::turn`].
    leaning: Option<f64>,
    /// Control points of the curve.
    points: usize,
    /// Blur of the image, as given or as found at the start \[px\].
    blur: f64,
    /// Width of the needle without blur, as found at the start, by that with it.
    sharp: f64,
    /// Whether the tip tapers in a way that is not known.
    tapers: bool,
    /// Misfit of the newest tip's silhouette.
    misfit: f64,
    /// Whether the newest tip was farther from the prediction than one looks for it.
    leapt: bool,
    hints: Hints,
}

impl ImageTracker {
    /// A tracker for images of `width` x `height` pixels.
    ///
    /// # Errors
    /// A setting outside its range.
    pub fn new(
        width: usize,
        height: usize,
        settings: &TrackSettings,
    ) -> Result<Self, TrackSettingsError> {
        settings.validate()?;
        let capacity = settings.normals;
        Ok(Self {
            settings: settings.clone(),
            scale: width as f64 / 640.0,
            background: Background::new(width, height),
            filter: None,
            noise: 0.01,
            contrast: 0.0,
            normals: Vec::with_capacity(capacity),
            offsets: Vec::with_capacity(capacity),
            shares: Vec::with_capacity(capacity),
            sorted: Vec::with_capacity(capacity),
            jumped: None,
            gate: (Vector2::zeros(), Vector2::x()),
            bad: 0,
            leaning: None,
            points: settings.control_points,
            blur: settings.blur_px * width as f64 / 640.0,
            sharp: 1.0,
            tapers: false,
            misfit: 0.0,
            leapt: false,
            hints: Hints::default(),
        })
    }

    /// Tells what is known of the images beforehand.
    pub fn set_hints(&mut self, hints: Hints) {
        self.hints = hints;
        self.blur = self.given_blur();
    }

    pub(super) const fn hints(&self) -> Hints {
        self.hints
    }

    /// \[px\]
    fn given_blur(&self) -> f64 {
        let usual = self.settings.blur_px * self.scale;
        self.hints.blur_px.unwrap_or(usual)
    }

    /// The curve as last estimated; nothing before the start.
    pub fn curve(&self) -> Option<Curve2> {
        self.filter.as_ref().map(CurveFilter::curve)
    }

    /// Forgets the needle; the background stays.
    pub(super) fn drop_needle(&mut self) {
        self.filter = None;
        self.jumped = None;
        self.bad = 0;
    }

    /// Forgets everything.
    pub(super) fn reset(&mut self) {
        self.drop_needle();
        self.background.clear();
        self.contrast = 0.0;
        self.noise = 0.01;
        self.points = self.settings.control_points;
        self.blur = self.given_blur();
        self.sharp = 1.0;
    }

    pub(super) fn filter(&self) -> Option<&CurveFilter> {
        self.filter.as_ref()
    }

    /// How far the bevel leans to one side in the newest image, where it was measured.
    pub(super) const fn leaning(&self) -> Option<f64> {
        self.leaning
    }

    pub(super) fn background(&self) -> &Background {
        &self.background
    }

    /// Whether the tip tapers in a way that is not known.
    pub(super) const fn tapers(&self) -> bool {
        self.tapers
    }

    /// Whether the newest tip was far from the prediction: what is between was not looked at.
    pub(super) const fn leapt(&self) -> bool {
        self.leapt
    }

    /// Pixels for one pixel of an image 640 wide.
    pub(super) const fn scale(&self) -> f64 {
        self.scale
    }

    /// An image in which no needle is: part of the background.
    pub(super) fn learn(&mut self, image: &GrayImage) {
        if self.background.images() < LEARNED {
            self.background.learn(image);
        }
    }

    /// Carries the curve on without an image.
    pub(super) fn coast(&mut self, change: &Change) {
        let start = self.start_parameter();
        if let Some(filter) = &mut self.filter {
            filter.predict(&Change { start, ..*change });
        }
        self.bad += 1;
    }

    /// Where the curve passes the place at which the needle comes into sight.
    fn start_parameter(&self) -> f64 {
        let Some(curve) = self.filter.as_ref().map(CurveFilter::curve) else {
            return 0.0;
        };
        let (place, direction) = self.gate;
        let speed = curve.derivative(0.0).dot(&direction);
        if speed < 1.0 {
            return 0.0;
        }
        ((place - curve.at(0.0)).dot(&direction) / speed).clamp(-0.2, 0.2)
    }

    /// Takes one image in: predicts by `change`, then measures shaft and tip.
    ///
    /// # Errors
    /// The needle was not measured; the prediction stays. Images of another size show none.
    pub fn follow(&mut self, image: &GrayImage, change: &Change, look: &Look) -> Result<(), Flaw> {
        self.leaning = None;
        let start = self.start_parameter();
        let Some(mut filter) = self.filter.take() else {
            return Err(Flaw::NOTHING);
        };
        filter.predict(&Change { start, ..*change });
        let found = if self.background.fits(image) {
            let short = SHORT * self.scale / filter.curve().length().max(1.0);
            self.shaft(
                image,
                &mut filter,
                look,
                short.powi(4).clamp(BEND_AGAIN, 1.0),
                self.settings.normals,
            )
            .and_then(|()| self.tip(image, &mut filter, look, true).map(drop))
        } else {
            Err(Flaw::NOTHING)
        };
        if found.is_ok() {
            self.refresh(image, &filter.curve(), look);
            self.bad = 0;
        } else {
            self.bad += 1;
        }
        self.filter = Some(filter);
        found
    }

    /// Measures the shaft along its normals and updates the filter robustly; `straight` is the
    /// share of what is known of its bending that is not known to the filter yet, `most` the
    /// largest number of normals.
    fn shaft(
        &mut self,
        image: &GrayImage,
        filter: &mut CurveFilter,
        look: &Look,
        straight: f64,
        most: usize,
    ) -> Result<(), Flaw> {
        let curve = filter.curve();
        let search = self.settings.search_px * self.scale;
        let (mut contrast, mut noise) = (0.0, 0.0);
        self.offsets.clear();
        // Normals closer than a pixel see the same noise.
        let length = curve.length();
        let wanted = most.min(length as usize).max(LEAST);
        // What no noise explains does not average out over more normals.
        let crowd = (wanted as f64 / self.settings.normals as f64).max(1.0);
        let count = self.points;
        let ends = look.width / curve.derivative(1.0).norm().max(1.0);
        let doubts = doubts(filter, &curve, count);
        self.normals.clear();
        for k in 0..wanted {
            let t = (k as f64 + 0.5) / wanted as f64 * (1.0 - ends);
            let (row, slopes) = weights_and_slopes(count, t);
            let expected = Expected {
                width: look.width,
                reach: (4.0 * between(&doubts, t) + 2.0 * self.scale).clamp(3.0, search.max(3.0)),
                contrast: self.contrast,
                noise: self.noise,
            };
            self.normals.push(Normal {
                row,
                place: curve.sum(&row),
                direction: normal(&curve.sum(&slopes).normalize()),
                expected,
            });
        }
        let mut read = 0.0;
        for n in &self.normals {
            let reach = samples(&n.expected) as f64;
            let from = n.place - n.direction * reach;
            read += self.background.touch(image, from, n.direction, 2.0 * reach);
        }
        black_box(read);
        for n in &self.normals {
            let section = cross(image, &self.background, n.place, n.direction, &n.expected);
            let Some(Section {
                offset,
                sigma,
                contrast: dark,
                noise: scatter,
                ..
            }) = section
            else {
                continue;
            };
            contrast += dark;
            noise += scatter;
            let floor = self.settings.normal_floor_px;
            let variance = sigma * sigma + floor * floor;
            self.offsets
                .push(Offset::new(n.row, n.direction, offset, variance));
        }
        let enough = ((SURVIVORS.0 * wanted as f64) as usize).max(SURVIVORS.1);
        let flaw = |agree| Flaw::Shaft { agree, of: wanted };
        if self.offsets.len() < enough {
            return Err(flaw(self.offsets.len()));
        }
        let contrast = contrast / self.offsets.len() as f64;
        let solution = self
            .robust(filter, look, straight, crowd.sqrt())
            .ok_or(flaw(0))?;
        let survivors = self.shares.iter().filter(|share| **share > 0.2).count();
        if survivors < enough {
            return Err(flaw(survivors));
        }
        filter.accept(&solution);
        let noise = noise / self.offsets.len() as f64;
        self.noise = (self.noise + 0.1 * (noise - self.noise)).clamp(0.002, 0.1);
        self.contrast += (contrast - self.contrast) * if self.contrast > 0.0 { 0.1 } else { 1.0 };
        Ok(())
    }

    /// Tukey's weights, from a scale found in the residuals themselves; what is left deviates by
    /// `least` times what it states at least.
    fn robust(
        &mut self,
        filter: &mut CurveFilter,
        look: &Look,
        straight: f64,
        least: f64,
    ) -> Option<Solution> {
        /// Tukey's constant, for 95 % efficiency on Gaussian noise.
        const TUKEY: f64 = 4.685;
        /// Change by another round that is none \[px\].
        const SETTLED: f64 = 5e-4;
        if !filter.begin(BEND / look.width, straight) {
            return None;
        }
        self.shares.clear();
        self.shares.resize(self.offsets.len(), 1.0);
        let mut solution = filter.solve(&self.offsets, &self.shares, least)?;
        for _ in 0..3 {
            // First the residuals, then what they are worth.
            for (share, offset) in self.shares.iter_mut().zip(&self.offsets) {
                *share = residual(offset, &solution.change).abs();
            }
            self.sorted.clear();
            self.sorted.extend_from_slice(&self.shares);
            let middle = self.sorted.len() / 2;
            let (_, median, _) = self.sorted.select_nth_unstable_by(middle, f64::total_cmp);
            let scale = (1.4826 * *median).max(1.0);
            let limit = 1.0 / (TUKEY * scale);
            for share in &mut self.shares {
                let x = *share * limit;
                *share = (1.0 - x * x).max(0.0).powi(2);
            }
            // Residuals larger than their stated noise say that it is larger.
            let next = filter.solve(&self.offsets, &self.shares, scale * least)?;
            let points = 2 * self.points;
            let moved = (next.change - solution.change).rows(0, points).amax();
            solution = next;
            if moved < SETTLED * self.scale {
                break;
            }
        }
        Some(solution)
    }

    /// Finds the tip and updates the filter; false where the background hides it. A tip that jumps
    /// is `gated`, except where there was none before.
    fn tip(
        &mut self,
        image: &GrayImage,
        filter: &mut CurveFilter,
        look: &Look,
        gated: bool,
    ) -> Result<bool, Flaw> {
        let curve = filter.curve();
        let end = weights(self.points, 1.0);
        let tangent = curve.derivative(1.0).normalize();
        let doubt = filter.variance(&end, &tangent);
        let near =
            (4.0 * doubt.sqrt() + 1.5 * self.scale).min(self.settings.search_px * self.scale);
        if self.hidden(&curve, &tangent, near, look) {
            // Odometry carries the tip on, and its variance says how far that can be trusted.
            return Ok(false);
        }
        let wide = self.settings.search_px * self.scale;
        let seek = |reach: f64| {
            let search = TipSearch {
                width: look.width,
                reach,
                bevel_px: look.bevel_px,
                side: look.side,
                rim_px: look.rim_px * self.sharp,
                blur: self.blur,
                tapers: self.tapers,
            };
            tip::find(image, &self.background, &curve, &search).filter(|fix| fix.misfit < MISFIT)
        };
        let fix = if self.bad == 0 { seek(near) } else { None };
        let fix = fix.or_else(|| seek(wide)).ok_or(Flaw::Tip)?;
        let floor = self.settings.tip_floor_px * self.scale.max(1.0);
        let variance = fix.sigma * fix.sigma + floor * floor;
        let offset = Offset::new(end, tangent, fix.shift, variance);
        let place = curve.tip() + tangent * fix.shift;
        if fix.shift.abs() > GATE * (doubt + offset.variance).sqrt() {
            // Where two images agree the tip has jumped, or stopped.
            let again = self
                .jumped
                .is_some_and(|before| (before - place).norm() < 2.0 * self.scale);
            self.jumped = Some(place);
            if gated && !again {
                return Err(Flaw::Tip);
            }
            filter.free_tip(fix.shift.abs());
        }
        filter.update(&offset);
        self.jumped = None;
        self.leaning = fix.leaning;
        self.misfit = fix.misfit;
        self.leapt = fix.shift.abs() > wide;
        Ok(true)
    }

    /// Whether the tip, or the shaft just behind it, is before a bubble as dark as the needle.
    fn hidden(&self, curve: &Curve2, tangent: &Vector2<f64>, reach: f64, look: &Look) -> bool {
        let margin = 3.0 * self.scale;
        let aside = normal(tangent) * (12.0 * self.scale);
        // So far behind the tip the shaft is compared with it, if there is as much of it.
        let mut ahead = -tip::behind(reach, curve);
        while ahead <= look.bevel_px + margin {
            let place = curve.tip() + tangent * ahead;
            if self.background.hides(place, aside) {
                return true;
            }
            ahead += 0.5 * margin;
        }
        false
    }

    /// Learns the background ahead of the tip, where the needle will be.
    fn refresh(&mut self, image: &GrayImage, curve: &Curve2, look: &Look) {
        let half = 10.0 * self.scale;
        let ahead = look.bevel_px + 2.0 * look.width + half;
        let tangent = curve.derivative(1.0).normalize();
        self.background
            .refresh(image, curve.tip() + tangent * ahead, half);
    }
}
