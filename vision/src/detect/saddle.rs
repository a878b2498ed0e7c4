//! The crossing under a peak: its four edge rays and which of its sectors are dark.

use core::f64::consts::{PI, TAU};

use hal::GrayImage;
use nalgebra::{Point2, Vector2};

/// A crossing of two edges.
#[derive(Clone, Copy, Debug)]
pub(super) struct Saddle {
    /// Where it is \[px\].
    pub at: Point2<f64>,
    /// Directions of the four edges, by growing angle (from x towards y).
    pub rays: [Vector2<f64>; 4],
    /// Whether the sector from `rays[0]` to `rays[1]` is dark; sectors alternate.
    pub first_dark: bool,
}

impl Saddle {
    /// Whether the sector that follows ray `k` is dark.
    pub(super) fn dark_after(&self, k: usize) -> bool {
        self.first_dark == k.is_multiple_of(2)
    }

    /// The ray nearest to a direction, and the cosine of the angle to it.
    pub(super) fn ray_towards(&self, direction: &Vector2<f64>) -> (usize, f64) {
        let mut best = (0, -1.0);
        for (k, ray) in self.rays.iter().enumerate() {
            let cos = ray.dot(direction);
            if cos > best.1 {
                best = (k, cos);
            }
        }
        best
    }
}

const SAMPLES: usize = 32;
/// Radius of the ring on which a crossing is read, where its squares are large enough \[px\].
pub(super) const RADIUS: f64 = 5.0;

/// Distance of a ring from the image's border, for the interpolation \[px\].
pub(super) const BORDER: f64 = 1.0;

/// Reads the ring of `radius` around `at`: a crossing shows exactly four changes between dark and
/// bright, opposite in pairs. `None` if this is no crossing, or too near to the border.
pub(super) fn saddle_at(image: &GrayImage, at: Point2<f64>, radius: f64) -> Option<Saddle> {
    let margin = radius + BORDER;
    let (w, h) = (image.width() as f64, image.height() as f64);
    if !(at.x >= margin && at.y >= margin && at.x < w - margin && at.y < h - margin) {
        return None;
    }
    let mut ring = [0.0; SAMPLES];
    for (value, (c, s)) in ring.iter_mut().zip(circle()) {
        *value = bilinear(image, at.x + radius * c, at.y + radius * s);
    }
    let mut smooth = [0.0; SAMPLES];
    for k in 0..SAMPLES {
        let (before, after) = (ring[(k + SAMPLES - 1) % SAMPLES], ring[(k + 1) % SAMPLES]);
        smooth[k] = (before + 2.0 * ring[k] + after) / 4.0;
    }
    let low = smooth.iter().copied().fold(f64::INFINITY, f64::min);
    let high = smooth.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    // Eight grey levels: four sigma of a poor camera's noise.
    if high - low < 8.0 {
        return None;
    }
    let (angles, first_dark) = changes(&smooth, f64::midpoint(low, high))?;
    let opposite = |a: f64, b: f64| ((b - a).rem_euclid(TAU) - PI).abs() < 0.5;
    let wide = |a: f64, b: f64| (b - a).rem_euclid(TAU) > 0.35;
    let regular = opposite(angles[0], angles[2])
        && opposite(angles[1], angles[3])
        && (0..4).all(|k| wide(angles[k], angles[(k + 1) % 4]));
    regular.then(|| Saddle {
        at,
        rays: angles.map(|a| Vector2::new(a.cos(), a.sin())),
        first_dark,
    })
}

/// Angles of the four changes, by growing angle, and whether it is dark after the first.
fn changes(ring: &[f64; SAMPLES], middle: f64) -> Option<([f64; 4], bool)> {
    let mut angles = [0.0; 4];
    let mut count = 0;
    let mut first_dark = false;
    for k in 0..SAMPLES {
        let (a, b) = (ring[k] - middle, ring[(k + 1) % SAMPLES] - middle);
        if (a < 0.0) == (b < 0.0) {
            continue;
        }
        if count == 4 {
            return None;
        }
        if count == 0 {
            first_dark = b < 0.0;
        }
        angles[count] = TAU / SAMPLES as f64 * (k as f64 + a / (a - b));
        count += 1;
    }
    (count == 4).then_some((angles, first_dark))
}

fn circle() -> impl Iterator<Item = (f64, f64)> {
    // A rotation recurrence: no trigonometry per sample.
    let (sin, cos) = (TAU / SAMPLES as f64).sin_cos();
    let mut at = (1.0, 0.0);
    (0..SAMPLES).map(move |_| {
        let here = at;
        at = (cos * here.0 - sin * here.1, sin * here.0 + cos * here.1);
        here
    })
}

/// Grey value between pixels; the caller keeps inside the image.
pub(super) fn bilinear(image: &GrayImage, x: f64, y: f64) -> f64 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the caller keeps inside the image"
    )]
    let (xi, yi) = (x as usize, y as usize);
    let (fx, fy) = (x - xi as f64, y - yi as f64);
    let (top, bottom) = (&image.row(yi)[xi..xi + 2], &image.row(yi + 1)[xi..xi + 2]);
    let mix = |r: &[u8]| f64::from(r[0]) * (1.0 - fx) + f64::from(r[1]) * fx;
    mix(top) * (1.0 - fy) + mix(bottom) * fy
}
