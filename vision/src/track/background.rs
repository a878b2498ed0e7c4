//! What a camera sees without the needle.
//!
//! Cameras and gel stand still, so bubbles, dirt and uneven light are learned and divided out.
//! Where nothing was learned the background is even, and profiles bring their own base line.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates of pixels, checked against the image"
)]

use hal::GrayImage;
use nalgebra::Vector2;

/// Grey level of a background that was never seen.
const UNSEEN: f32 = 200.0;
/// Darker than this the background shows nothing \[grey\].
const DARK: f32 = 24.0;
/// Darker than this, relative to the background, may be a needle.
const NO_NEEDLE: f32 = 0.8;
/// A background darker than this, relative to its surroundings, hides a needle.
const HIDDEN: f32 = 0.6;
/// Images after which a pixel's mean changes no more quickly.
const MEMORY: u32 = 32;

/// Distance of painted points \[px\]: of a square grid of them, however turned, one lies in every
/// pixel as long as half its diagonal is shorter than half a pixel.
pub(super) const PAINTED: f64 = 0.66;

/// Mean image without the needle.
///
/// A needle brighter than what is behind it is taken as a dark one in the negative: all levels
/// here are those of the negative then.
#[derive(Clone, Debug)]
pub(super) struct Background {
    width: usize,
    height: usize,
    grey: Vec<f32>,
    images: u32,
    /// Factor and summand that make levels of an image's: of it, or of its negative.
    level: [f32; 2],
}

/// Cell and fractions of a bilinear interpolation.
#[derive(Clone, Copy)]
struct Cell {
    index: usize,
    x: f32,
    y: f32,
}

/// Bits after the point of a coordinate in fixed point.
const POINT: u32 = 32;

fn fixed(coordinate: f64) -> i64 {
    (coordinate * (1_u64 << POINT) as f64) as i64
}

/// Part of a coordinate after its point, to 16 bits.
fn fraction(coordinate: i64) -> f32 {
    let bits = (coordinate >> (POINT - 16)) & 0xffff;
    bits as f32 / 65536.0
}

impl Background {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            grey: vec![UNSEEN; width * height],
            images: 0,
            level: [1.0, 0.0],
        }
    }

    /// Whether the needle is brighter than the background.
    pub(super) fn bright(&self) -> bool {
        self.level[0] < 0.0
    }

    /// Takes the needle as brighter than the background, or as darker.
    pub(super) fn set_bright(&mut self, bright: bool) {
        if bright == self.bright() {
            return;
        }
        self.level = if bright { [-1.0, 255.0] } else { [1.0, 0.0] };
        if self.images > 0 {
            for mean in &mut self.grey {
                *mean = 255.0 - *mean;
            }
        }
    }

    fn level(&self, grey: u8) -> f32 {
        self.level[0] * f32::from(grey) + self.level[1]
    }

    pub(super) fn clear(&mut self) {
        self.grey.fill(UNSEEN);
        self.images = 0;
    }

    /// Whether the background at `p` is so much darker than `aside` of it that a needle would
    /// not show.
    pub(super) fn hides(&self, p: Vector2<f64>, aside: Vector2<f64>) -> bool {
        let at = |p| self.at(p).unwrap_or(UNSEEN);
        at(p) < HIDDEN * 0.5 * (at(p + aside) + at(p - aside))
    }

    /// Grey level at `p`, of the negative if the needle is bright.
    pub(super) fn mean_at(&self, p: Vector2<f64>) -> f64 {
        self.at(p).unwrap_or(UNSEEN).into()
    }

    /// Whether `image` is of the size of the background.
    pub(super) fn fits(&self, image: &GrayImage) -> bool {
        (image.width(), image.height()) == (self.width, self.height)
    }

    pub(super) const fn images(&self) -> u32 {
        self.images
    }

    /// Takes in a whole image without a needle.
    pub(super) fn learn(&mut self, image: &GrayImage) {
        let share = 1.0 / (self.images.min(MEMORY) + 1) as f32;
        let [factor, summand] = self.level;
        for (mean, grey) in self.grey.iter_mut().zip(image.pixels()) {
            *mean += (factor * f32::from(*grey) + summand - *mean) * share;
        }
        self.images = self.images.saturating_add(1);
    }

    /// Takes in the pixels around `centre`, up to `half` away, where no needle is.
    pub(super) fn refresh(&mut self, image: &GrayImage, centre: Vector2<f64>, half: f64) {
        let clamp = |value: f64, most: usize| value.clamp(0.0, most as f64) as usize;
        let (left, right) = (
            clamp(centre.x - half, self.width),
            clamp(centre.x + half, self.width),
        );
        let [factor, summand] = self.level;
        for y in clamp(centre.y - half, self.height)..clamp(centre.y + half, self.height) {
            let row = y * self.width;
            let mean = self.grey.get_mut(row + left..row + right);
            let seen = image.pixels().get(row + left..row + right);
            let (mean, seen) = (mean.unwrap_or_default(), seen.unwrap_or_default());
            for (mean, grey) in mean.iter_mut().zip(seen) {
                // Should the needle be there after all, it is not learned.
                let grey = factor * f32::from(*grey) + summand;
                let share = if grey > NO_NEEDLE * *mean {
                    1.0 / 12.0
                } else {
                    0.0
                };
                *mean += (grey - *mean) * share;
            }
        }
    }

    /// Paints the needle out of what was learned: on the line from `from` to `to`, grey levels
    /// run evenly from one end to the other.
    pub(super) fn paint_out(&mut self, from: Vector2<f64>, to: Vector2<f64>) {
        let outwards = (to - from).try_normalize(1e-9).unwrap_or_default();
        let (Some(a), Some(b)) = (self.level_at(from, -outwards), self.level_at(to, outwards))
        else {
            return;
        };
        let steps = ((to - from).norm() / PAINTED).ceil().max(1.0);
        let mut step = 0.0;
        while step <= steps {
            let share = step / steps;
            let p = from + (to - from) * share;
            // Its nearest pixel.
            let (x, y) = (p.x + 0.5, p.y + 0.5);
            if x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64 {
                let index = y as usize * self.width + x as usize;
                if let Some(grey) = self.grey.get_mut(index) {
                    *grey = a + (b - a) * share as f32;
                }
            }
            step += 1.0;
        }
    }

    /// Mean of some pixels from `from` on, that one pixel's noise is not painted over many.
    fn level_at(&self, from: Vector2<f64>, direction: Vector2<f64>) -> Option<f32> {
        const PIXELS: u32 = 3;
        let mut sum = self.at(from)?;
        let mut count = 1.0;
        for k in 1..PIXELS {
            if let Some(grey) = self.at(from + direction * f64::from(k)) {
                sum += grey;
                count += 1.0;
            }
        }
        Some(sum / count)
    }

    /// Row `y` of the mean image, in the levels of images; nothing before one was learned.
    pub(super) fn row(&self, y: usize) -> Option<impl Iterator<Item = f32>> {
        let row = self.grey.get(y * self.width..(y + 1) * self.width)?;
        let [factor, summand] = self.level;
        let levels = row.iter().map(move |mean| (mean - summand) * factor);
        (self.images > 0).then_some(levels)
    }

    fn cell(&self, p: Vector2<f64>) -> Option<Cell> {
        let inside = p.x >= 0.0
            && p.y >= 0.0
            && p.x < (self.width - 1) as f64
            && p.y < (self.height - 1) as f64;
        if !inside {
            return None;
        }
        let (x, y) = (p.x as usize, p.y as usize);
        Some(Cell {
            index: y * self.width + x,
            x: (p.x - x as f64) as f32,
            y: (p.y - y as f64) as f32,
        })
    }

    fn at(&self, p: Vector2<f64>) -> Option<f32> {
        let cell = self.cell(p)?;
        self.mean(cell)
    }

    #[inline]
    fn mean(&self, cell: Cell) -> Option<f32> {
        let top = self.grey.get(cell.index..cell.index + 2)?;
        let below = self
            .grey
            .get(cell.index + self.width..cell.index + self.width + 2)?;
        Some(cell.blend(top[0], top[1], below[0], below[1]))
    }

    /// Brightness of the image at `p` relative to the background; `None` outside the image and
    /// where the background is dark.
    #[inline]
    pub(super) fn brightness(&self, image: &GrayImage, p: Vector2<f64>) -> Option<f32> {
        let cell = self.cell(p)?;
        let pixels = image.pixels();
        let top = pixels.get(cell.index..cell.index + 2)?;
        let below = pixels.get(cell.index + self.width..cell.index + self.width + 2)?;
        let grey = cell.blend(
            self.level(top[0]),
            self.level(top[1]),
            self.level(below[0]),
            self.level(below[1]),
        );
        let mean = self.mean(cell)?;
        (mean > DARK).then_some(grey / mean)
    }
}

impl Background {
    /// Brightness relative to the background at each pixel's distance from `origin` along
    /// `direction` (unit); `None` where [`Self::brightness`] has one.
    #[inline]
    pub(super) fn line(
        &self,
        image: &GrayImage,
        origin: Vector2<f64>,
        direction: Vector2<f64>,
        samples: &mut [f32],
    ) -> Option<()> {
        // The image is convex: with both ends all of the line lies in it.
        let end = origin + direction * samples.len().saturating_sub(1) as f64;
        self.cell(origin)?;
        self.cell(end)?;
        let below = self.width;
        // Fixed point is quicker than converting every coordinate; steps are exact to 2^-32 px.
        let (mut x, mut y) = (fixed(origin.x), fixed(origin.y));
        let (step_x, step_y) = (fixed(direction.x), fixed(direction.y));
        let mut darkest = f32::INFINITY;
        let [factor, summand] = self.level;
        for sample in samples {
            // Rounding may lead a hair outside, where the nearest cell does.
            let (right, down) = (x.max(0), y.max(0));
            let cell = Cell {
                index: (down >> POINT) as usize * below + (right >> POINT) as usize,
                x: fraction(right),
                y: fraction(down),
            };
            let seen = image.pixels().get(cell.index..cell.index + below + 2)?;
            let mean = self.grey.get(cell.index..cell.index + below + 2)?;
            let grey = |i: usize| f32::from(seen[i]);
            let mean = cell.blend(mean[0], mean[1], mean[below], mean[below + 1]);
            let seen = cell.blend(grey(0), grey(1), grey(below), grey(below + 1));
            *sample = (factor * seen + summand) / mean;
            darkest = darkest.min(mean);
            x += step_x;
            y += step_y;
        }
        (darkest > DARK).then_some(())
    }
}

impl Background {
    /// Reads around the line that [`Self::line`] is to read: the waits for memory of many lines
    /// overlap when they are touched first. Answers something that depends on what was read.
    #[inline]
    pub(super) fn touch(
        &self,
        image: &GrayImage,
        origin: Vector2<f64>,
        direction: Vector2<f64>,
        length: f64,
    ) -> f32 {
        // One row, or fewer pixels than a line of the cache holds.
        let step = (1.0 / direction.y.abs().max(0.01)).min(12.0);
        let (mut sum, mut k) = (0.0, 0.0);
        while k < length + step {
            let p = origin + direction * k.min(length);
            let index = p.y.max(0.0) as usize * self.width + p.x.max(0.0) as usize;
            let pixels = image.pixels();
            for index in [index, index + self.width] {
                sum += self.grey.get(index).copied().unwrap_or(0.0)
                    + f32::from(pixels.get(index).copied().unwrap_or(0));
            }
            k += step;
        }
        sum
    }
}

impl Cell {
    #[inline]
    fn blend(self, a: f32, b: f32, c: f32, d: f32) -> f32 {
        let top = a + (b - a) * self.x;
        let below = c + (d - c) * self.x;
        top + (below - top) * self.y
    }
}
