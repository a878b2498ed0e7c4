//! One camera's picture: cached background, the needle's pixels, noise.
//!
//! A frame costs one pass of 16-bit arithmetic over the image (background plus noise) and the
//! work on the few columns per row that the needle covers.

use std::sync::Arc;

use hal::GrayImage;
use rand_chacha::ChaCha8Rng;

use super::blur::Blur;
use super::board::BoardView;
use super::coverage::SparsePlane;
use super::noise::{GREY, GREY_BITS, Noise};
use super::settings::CameraSettings;
use super::silhouette::Silhouette;
use super::view::View;
use crate::NeedleView;

/// Where the highlight lies across the shaft, from -1 to 1 between its sides.
const HIGHLIGHT: [f64; 2] = [0.25, 0.6];
/// Grey levels of a calibration's scene.
const ROOM_GREY: f32 = 95.0;
const PAPER_GREY: f32 = 205.0;
const INK_GREY: f32 = 28.0;

#[derive(Clone, Debug)]
pub(super) struct Renderer {
    width: usize,
    contrast: f32,
    needle_grey: f32,
    specular_grey: f64,
    background: Vec<i16>,
    amplitude: Vec<i16>,
    noise: Option<Arc<Noise>>,
    cover: SparsePlane,
    shine: SparsePlane,
    spare: SparsePlane,
    blur: Option<Blur>,
    silhouette: Silhouette,
    row: Vec<i16>,
    row_amplitude: Vec<i16>,
}

impl Renderer {
    /// `background` in grey levels, not yet blurred.
    pub(super) fn new(
        settings: &CameraSettings,
        mut background: Vec<f32>,
        noise: Option<Arc<Noise>>,
    ) -> Self {
        let (width, height) = (settings.width_px, settings.height_px);
        let blur = Blur::new(settings.optics.blur_sigma_px);
        if let Some(blur) = &blur {
            blur.dense(&mut background, width, height);
        }
        let background: Vec<i16> = background.iter().map(|&v| quantised(v)).collect();
        let amplitude = noise.as_ref().map_or_else(Vec::new, |noise| {
            background.iter().map(|&b| noise.amplitude(b)).collect()
        });
        let plane = || SparsePlane::new(width, height);
        Self {
            width,
            contrast: narrow(1.0 - settings.optics.haze),
            needle_grey: narrow(settings.optics.needle_grey),
            specular_grey: settings.optics.specular_grey,
            background,
            amplitude,
            noise,
            cover: plane(),
            shine: plane(),
            spare: plane(),
            blur,
            silhouette: Silhouette::default(),
            row: vec![0; width],
            row_amplitude: vec![0; width],
        }
    }

    /// Draws one exposure.
    pub(super) fn draw(
        &mut self,
        view: &View,
        needle: Option<&NeedleView>,
        generator: &mut ChaCha8Rng,
        image: &mut GrayImage,
    ) {
        self.cover.clear();
        self.shine.clear();
        if let Some(needle) = needle {
            self.cover_needle(view, needle);
        }
        let noise = self.noise.clone();
        for (y, out) in image.pixels_mut().chunks_exact_mut(self.width).enumerate() {
            let place = y * self.width..(y + 1) * self.width;
            let samples = noise.as_ref().map(|n| n.row(generator, self.width));
            let levels = &self.background[place.clone()];
            let drawn = self.cover.span(y);
            let (left, right) = if drawn.is_empty() {
                (self.width, self.width)
            } else {
                (drawn.start, drawn.end)
            };
            if let Some(samples) = samples {
                let amplitude = &self.amplitude[place];
                noisy(&mut out[..left], levels, amplitude, samples);
                noisy(
                    &mut out[right..],
                    &levels[right..],
                    &amplitude[right..],
                    &samples[right..],
                );
            } else {
                clean(&mut out[..left], levels);
                clean(&mut out[right..], &levels[right..]);
            }
            if left < right {
                self.mix_needle(y, left, right);
                let out = &mut out[left..right];
                match (samples, &noise) {
                    (Some(samples), Some(noise)) => {
                        for (a, level) in
                            self.row_amplitude.iter_mut().zip(&self.row[..right - left])
                        {
                            *a = noise.amplitude(*level);
                        }
                        noisy(out, &self.row, &self.row_amplitude, &samples[left..]);
                    }
                    _ => clean(out, &self.row),
                }
            }
        }
    }

    /// Draws a board in open air, in diffuse light, before a grey room.
    pub(super) fn draw_board(
        &mut self,
        view: &View,
        board: &BoardView,
        generator: &mut ChaCha8Rng,
        image: &mut GrayImage,
    ) {
        self.cover.clear();
        self.shine.clear();
        board.paint(view, &mut self.cover, &mut self.shine);
        self.cover.resolve();
        self.shine.resolve();
        let mut levels = Vec::with_capacity(image.pixels().len());
        for y in 0..image.height() {
            let (paper, ink) = (self.cover.row(y), self.shine.row(y));
            for x in 0..self.width {
                let light = 1.0 + 0.1 * (x + y) as f32 / (image.width() + image.height()) as f32;
                let (p, i) = (paper[x].abs(), ink[x].abs());
                levels.push(light * (ROOM_GREY * (1.0 - p) + PAPER_GREY * (p - i) + INK_GREY * i));
            }
        }
        if let Some(blur) = &self.blur {
            blur.dense(&mut levels, self.width, image.height());
        }
        for (out, levels) in image
            .pixels_mut()
            .chunks_exact_mut(self.width)
            .zip(levels.chunks_exact(self.width))
        {
            for (out, level) in self.row.iter_mut().zip(levels) {
                *out = quantised(*level);
            }
            if let Some(noise) = &self.noise {
                for (a, level) in self.row_amplitude.iter_mut().zip(&self.row) {
                    *a = noise.amplitude(*level);
                }
                noisy(
                    out,
                    &self.row,
                    &self.row_amplitude,
                    noise.row(generator, self.width),
                );
            } else {
                clean(out, &self.row);
            }
        }
    }

    /// Fills `self.cover` with what the needle changes of the background.
    fn cover_needle(&mut self, view: &View, needle: &NeedleView) {
        let (cover, shine) = (&mut self.cover, &mut self.shine);
        let specular = self.specular_grey;
        self.silhouette.trace(
            view,
            needle,
            |outline| cover.outline(outline),
            |left0, right0, left1, right1, place| {
                if specular > 0.0 {
                    let at = |l: [f64; 2], r: [f64; 2], u: f64| {
                        let t = 0.5 * (1.0 + u);
                        [l[0] + t * (r[0] - l[0]), l[1] + t * (r[1] - l[1])]
                    };
                    let [a, b] = HIGHLIGHT;
                    let strip = [
                        at(left0, right0, a),
                        at(left0, right0, b),
                        at(left1, right1, b),
                        at(left1, right1, a),
                    ];
                    // The ground surface glitters: fixed to the needle, not to the image.
                    let glitter = 0.65 + 0.2 * (1.9 * place).sin() + 0.15 * (7.3 * place).sin();
                    shine.polygon(strip.into_iter(), specular * glitter);
                }
            },
        );
        self.cover.resolve();
        self.shine.resolve();
        self.take_light();
        if let Some(blur) = &self.blur {
            blur.sparse(&mut self.cover, &mut self.spare);
        }
    }

    /// Turns the plane of coverage into grey levels to add to the background.
    fn take_light(&mut self) {
        for y in self.cover.rows() {
            let span = self.cover.span(y);
            if span.is_empty() {
                continue;
            }
            let background = &self.background[y * self.width..][span.clone()];
            let shine = &self.shine.row(y)[span.clone()];
            let cover = self.cover.open(y, span);
            for ((c, &b), &s) in cover.iter_mut().zip(background).zip(shine) {
                let b = f32::from(b) / narrow(GREY);
                let dark = c.abs().min(1.0) * (b - self.needle_grey);
                *c = self.contrast * (s.abs() - dark);
            }
        }
    }

    /// Levels of the drawn columns into `self.row`.
    fn mix_needle(&mut self, y: usize, left: usize, right: usize) {
        let background = &self.background[y * self.width + left..y * self.width + right];
        let change = &self.cover.row(y)[left..right];
        for ((out, &b), &c) in self.row.iter_mut().zip(background).zip(change) {
            *out = quantised(f32::from(b) / narrow(GREY) + c);
        }
    }
}

/// Grey level to the renderer's 16-bit units.
#[expect(
    clippy::cast_possible_truncation,
    reason = "clamped to the range of an image"
)]
pub(super) fn quantised(grey: f32) -> i16 {
    (grey.clamp(0.0, 255.0) * narrow(GREY)).round() as i16
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "grey levels need no double precision"
)]
pub(super) const fn narrow(x: f64) -> f32 {
    x as f32
}

/// Background plus noise to pixels; plain enough for the compiler to vectorise.
#[expect(
    clippy::cast_sign_loss,
    reason = "a product of 16-bit numbers shifted by 16 fits; the sum is clamped"
)]
fn noisy(out: &mut [u8], levels: &[i16], amplitude: &[i16], samples: &[i16]) {
    const HALF: i16 = 1 << (GREY_BITS - 1);
    for (((out, &b), &a), &s) in out.iter_mut().zip(levels).zip(amplitude).zip(samples) {
        let noise = ((i32::from(a) * i32::from(s)) >> 16) as i16;
        *out = ((b + HALF).saturating_add(noise) >> GREY_BITS).clamp(0, 255) as u8;
    }
}

/// Background to pixels.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "levels are within 0..=255 grey"
)]
fn clean(out: &mut [u8], levels: &[i16]) {
    const HALF: i16 = 1 << (GREY_BITS - 1);
    for (out, &b) in out.iter_mut().zip(levels) {
        *out = ((b + HALF) >> GREY_BITS) as u8;
    }
}
