//! The needle on one line across it: background removed, matched filter of its width, centroid.

use hal::GrayImage;
use nalgebra::{Point2, Vector2};

/// Longest profile.
const SAMPLES: usize = 192;

/// Where the needle crosses a line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    /// From the line's centre along it \[px\].
    pub offset: f64,
    /// Standard deviation \[px\].
    pub sigma: f64,
    /// Darkness of the needle's core against its surroundings \[grey\].
    pub contrast: f64,
}

/// Grey value between pixels (bilinear); `None` outside the image.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates are checked against the image"
)]
#[inline]
pub(super) fn sample(image: &GrayImage, x: f64, y: f64) -> Option<f32> {
    let (w, h) = (image.width(), image.height());
    if !(x >= 0.0 && y >= 0.0) {
        return None;
    }
    let (i, j) = (x as usize, y as usize);
    if i + 1 >= w || j + 1 >= h {
        return None;
    }
    let (a, b) = ((x - i as f64) as f32, (y - j as f64) as f32);
    let k = j * w + i;
    let p = image.pixels();
    let (top, low) = (p.get(k..k + 2)?, p.get(k + w..k + w + 2)?);
    let t = f32::from(top[0]) + a * (f32::from(top[1]) - f32::from(top[0]));
    let l = f32::from(low[0]) + a * (f32::from(low[1]) - f32::from(low[0]));
    Some(t + b * (l - t))
}

/// Half widths of the matched filter \[px\].
#[derive(Clone, Copy, Debug)]
struct Filter {
    core: usize,
    gap: usize,
    flank: usize,
}

impl Filter {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "widths are small and positive"
    )]
    fn new(width: f64, blur: f64) -> Self {
        let core = ((0.5 * width - 0.5).round().max(0.0) as usize).min(12);
        // The edge's blur, from the core's end to where it has faded.
        let gap = (0.5 * width + 2.0 * blur - core as f64 - 0.5)
            .ceil()
            .clamp(1.0, 9.0) as usize;
        Self {
            core,
            gap,
            flank: 3,
        }
    }

    fn reach(self) -> usize {
        self.core + self.gap + self.flank
    }
}

/// The needle of `width` on the line through `centre` along the unit vector `along`, within
/// `search` of the centre. `expected` is the contrast it had elsewhere, if known.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "profile lengths are small and positive"
)]
pub(super) fn crossing(
    image: &GrayImage,
    centre: Point2<f64>,
    along: Vector2<f64>,
    (width, blur): (f64, f64),
    search: f64,
    expected: Option<f64>,
) -> Option<Crossing> {
    let filter = Filter::new(width, blur);
    let half = (search.ceil() as usize + filter.reach() + 1).min(SAMPLES / 2 - 1);
    let n = 2 * half + 1;
    let mut grey = [0.0_f32; SAMPLES];
    let mut sums = [0.0_f32; SAMPLES + 1];
    let start = centre - along * half as f64;
    for (k, g) in grey[..n].iter_mut().enumerate() {
        let p = start + along * k as f64;
        *g = sample(image, p.x, p.y)?;
    }
    for k in 0..n {
        sums[k + 1] = sums[k] + grey[k];
    }
    let mean = |from: usize, len: usize| (sums[from + len] - sums[from]) / len as f32;
    let flanks = |u: usize| {
        let edge = filter.core + filter.gap;
        (
            mean(u - filter.reach(), filter.flank),
            mean(u + edge + 1, filter.flank),
        )
    };
    let response = |u: usize| {
        let (l, r) = flanks(u);
        l.min(r) - mean(u - filter.core, 2 * filter.core + 1)
    };
    let least = expected.map_or(5.0, |e| 0.35 * e).max(4.0) as f32;
    let mut best: Option<(usize, f32)> = None;
    let mut best_score = 0.0;
    for u in filter.reach()..n - filter.reach() {
        let r = response(u);
        if r < least {
            continue;
        }
        // The darkest, unless it is far: a bubble is as dark as the needle.
        let far = (u as f32 - half as f32).abs() / half as f32;
        let score = expected.map_or(r, |e| r.min(1.1 * e as f32)) * (1.0 - 0.4 * far);
        if score > best_score {
            best = Some((u, r));
            best_score = score;
        }
    }
    let (peak, contrast) = best?;
    if expected.is_some_and(|e| f64::from(contrast) > 1.8 * e) {
        return None;
    }
    let (l, r) = flanks(peak);
    let lever = (2 * (filter.core + filter.gap) + filter.flank + 1) as f32;
    let tilt = (r - l) / lever;
    let level = 0.5 * (l + r);
    let centroid = centroid(&grey[..n], peak, (level, tilt), f64::from(contrast), filter)?;
    // Noise from the flanks about the background line.
    let mut square = 0.0;
    for k in 0..filter.flank {
        for u in [
            peak - filter.reach() + k,
            peak + filter.core + filter.gap + 1 + k,
        ] {
            let e = grey[u] - level - tilt * (u as f32 - peak as f32);
            square += e * e;
        }
    }
    let noise = f64::from(square / (2 * filter.flank) as f32)
        .sqrt()
        .max(0.7);
    let sigma = (noise * centroid.lever).hypot(0.04);
    Some(Crossing {
        offset: centroid.place - half as f64,
        sigma,
        contrast: f64::from(contrast),
    })
}

struct Centroid {
    place: f64,
    /// Its change per grey level of noise in each sample, root of the sum of squares \[px/grey\].
    lever: f64,
}

/// Centroid of the darkness cut off at half its height: a highlight on the shaft stays above the
/// cut, so that the two edges alone count.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "indices stay inside the profile"
)]
fn centroid(
    grey: &[f32],
    peak: usize,
    (level, tilt): (f32, f32),
    contrast: f64,
    filter: Filter,
) -> Option<Centroid> {
    let cut = 0.5 * contrast;
    let half = (filter.core + filter.gap) as f64 + 0.5;
    let mut place = peak as f64;
    let mut lever = 0.0;
    for _ in 0..3 {
        let first = (place - half).floor().max(0.0) as usize;
        let last = ((place + half).ceil() as usize).min(grey.len() - 1);
        let (mut sum, mut moment, mut square) = (0.0, 0.0, 0.0);
        for k in first..=last {
            let u = k as f64 - place;
            // Samples on the window's border count by what of them is inside.
            let weight = (half + 0.5 - u.abs()).clamp(0.0, 1.0);
            let dark = f64::from(level + tilt * (k as f32 - peak as f32) - grey[k]);
            sum += weight * dark.min(cut);
            moment += weight * dark.min(cut) * u;
            if dark < cut {
                square += weight * u * u;
            }
        }
        if sum <= 0.0 {
            return None;
        }
        let step = moment / sum;
        if step.abs() > half {
            return None;
        }
        place += step;
        lever = square.sqrt() / sum;
        if step.abs() < 1e-3 {
            break;
        }
    }
    (place - peak as f64)
        .abs()
        .le(&half)
        .then_some(Centroid { place, lever })
}
