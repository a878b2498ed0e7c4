//! The needle in one line across it: where its middle is and how well that is known.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates of pixels, checked against the image"
)]

use hal::GrayImage;
use nalgebra::Vector2;

use super::background::Background;

/// Samples on either side of a line's middle, at most.
const REACH: usize = 40;
/// Samples at both ends that show the background.
const ENDS: usize = 3;
/// Least relative darkness of a needle.
const FAINT: f32 = 0.06;

/// Where a line across the needle meets it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Section {
    /// Middle of the needle along the line \[px\].
    pub offset: f64,
    /// Standard deviation of the middle by noise \[px\].
    pub sigma: f64,
    /// Darkness of the needle relative to the background.
    pub contrast: f64,
    /// Scatter of the brightness beside the needle.
    pub noise: f64,
    /// Width at half the contrast \[px\].
    pub width: f64,
    /// Slope of its flanks there, by width and contrast: what blur does to them.
    pub steepness: f64,
}

/// What a line across the needle is expected to meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Expected {
    /// Width of the needle \[px\].
    pub width: f64,
    /// How far from the prediction it may be \[px\].
    pub reach: f64,
    /// Usual contrast; 0 while unknown.
    pub contrast: f64,
    /// Noise of the relative brightness.
    pub noise: f64,
}

/// Relative darkness along the line from `start`, its own ends being the background; answers the
/// scatter of the samples that show it.
fn profile(
    image: &GrayImage,
    background: &Background,
    start: Vector2<f64>,
    direction: Vector2<f64>,
    samples: &mut [f32],
) -> Option<f32> {
    let count = samples.len();
    background.line(image, start, direction, samples)?;
    let mean = |part: &[f32]| part.iter().sum::<f32>() / part.len() as f32;
    let (first, last) = (mean(&samples[..ENDS]), mean(&samples[count - ENDS..]));
    // The ends' own middles are ENDS - 1 samples inside the line.
    let slope = (last - first) / (count - ENDS) as f32;
    let start = first - slope * 0.5 * (ENDS - 1) as f32;
    let mut squares = 0.0;
    for (k, sample) in samples.iter_mut().enumerate() {
        *sample = start + slope * k as f32 - *sample;
        if k < ENDS || k >= count - ENDS {
            squares += *sample * *sample;
        }
    }
    // Two of the six are used up by the line through the ends.
    Some((squares / (2 * ENDS - 2) as f32).sqrt())
}

/// Samples on either side of a line's middle.
pub(super) fn samples(expected: &Expected) -> usize {
    ((expected.reach + 0.5 * expected.width).ceil() as usize + 1 + ENDS).min(REACH)
}

/// Finds the needle on the line through `origin` along `direction` (unit).
pub(super) fn cross(
    image: &GrayImage,
    background: &Background,
    origin: Vector2<f64>,
    direction: Vector2<f64>,
    expected: &Expected,
) -> Option<Section> {
    let half = 0.5 * expected.width;
    let reach = samples(expected);
    let mut darkness = [0.0; 2 * REACH + 1];
    let darkness = darkness.get_mut(..=2 * reach)?;
    let start = origin - direction * reach as f64;
    let scatter = profile(image, background, start, direction, darkness)?;
    let middle = peak(darkness, (expected.width + 0.5).max(1.0) as usize, reach)?;
    let inner = (0.3 * expected.width).max(0.5);
    let top = highest(darkness, middle, half);
    let enough = FAINT
        .max(4.0 * expected.noise as f32)
        .max(0.35 * expected.contrast as f32);
    if top < enough {
        return None;
    }
    let level = 0.5 * top;
    let right = crossing(darkness, middle, inner, 1, level)?;
    let left = crossing(darkness, middle, inner, -1, level)?;
    let width = right.at - left.at;
    if (width - expected.width).abs() > 0.35 * expected.width + 0.6 {
        return None;
    }
    let steepness = f64::from(right.slope.min(left.slope));
    if steepness < 1e-3 {
        return None;
    }
    let noise = f64::from(scatter)
        .min(3.0 * expected.noise)
        .max(expected.noise);
    Some(Section {
        offset: 0.5 * (left.at + right.at) - reach as f64,
        sigma: noise / steepness * core::f64::consts::FRAC_1_SQRT_2,
        contrast: f64::from(top),
        noise: f64::from(scatter),
        width,
        steepness: steepness * width / f64::from(top),
    })
}

/// Middle of the window of `width` samples that is darkest, near ones first: of all windows
/// nearly as dark as the darkest, the one nearest to the line's middle.
fn peak(darkness: &[f32], width: usize, reach: usize) -> Option<f64> {
    let last = darkness.len().checked_sub(width + 1)?;
    let mut sums = [0.0_f32; 2 * REACH + 1];
    let mut running = darkness.get(..width)?.iter().sum();
    for (k, sum) in sums.iter_mut().enumerate().take(last + 1) {
        *sum = running;
        running += darkness.get(k + width).unwrap_or(&0.0) - darkness[k];
    }
    let most = sums.get(1..last)?.iter().copied().fold(0.0, f32::max);
    let offset = 0.5 * (width - 1) as f64;
    let neighbours = sums.windows(3).take(last.saturating_sub(1)).enumerate();
    neighbours
        .filter(|(_, sums)| sums[1] > 0.7 * most && sums[1] >= sums[0] && sums[1] >= sums[2])
        .map(|(k, _)| (k + 1) as f64 + offset)
        .min_by(|a, b| {
            (a - reach as f64)
                .abs()
                .total_cmp(&(b - reach as f64).abs())
        })
}

/// Darkest sample within `half` of `middle`.
fn highest(darkness: &[f32], middle: f64, half: f64) -> f32 {
    let from = (middle - half).max(0.0) as usize;
    let to = ((middle + half).ceil() as usize + 1).min(darkness.len());
    darkness
        .get(from..to)
        .unwrap_or_default()
        .iter()
        .copied()
        .fold(0.0, f32::max)
}

struct Crossing {
    at: f64,
    slope: f32,
}

/// Where the darkness falls below `level`, going outwards from `inner` beside the `middle` in the
/// sense of `step`; from nearer to it where the needle is narrower there.
fn crossing(
    darkness: &[f32],
    middle: f64,
    inner: f64,
    step: isize,
    level: f32,
) -> Option<Crossing> {
    let index = |place: f64| (place >= 0.0).then_some(place as usize);
    let centre = index(middle + 0.5)?;
    let mut k = index(middle + inner * step as f64 + 0.5)?;
    while *darkness.get(k)? < level {
        if k == centre {
            // No needle of this width here.
            return None;
        }
        k = k.checked_add_signed(-step)?;
    }
    loop {
        let next = k.checked_add_signed(step)?;
        let (here, there) = (*darkness.get(k)?, *darkness.get(next)?);
        if there < level {
            let slope = here - there;
            return Some(Crossing {
                at: k as f64 + step as f64 * f64::from((here - level) / slope),
                slope,
            });
        }
        k = next;
    }
}

/// Darkness summed over the needle's width and a margin, on the line through `origin` along
/// `direction`, the background being `even`; and its first moment about `origin`.
pub(super) fn mass(
    image: &GrayImage,
    background: &Background,
    origin: Vector2<f64>,
    direction: Vector2<f64>,
    reach: usize,
    even: f64,
) -> Option<[f64; 2]> {
    let mut samples = [0.0; 2 * REACH + 1];
    let samples = samples.get_mut(..=2 * reach)?;
    background.line(image, origin - direction * reach as f64, direction, samples)?;
    let (mut sum, mut moment) = (0.0, 0.0);
    for (k, sample) in samples.iter().enumerate() {
        let darkness = even - f64::from(*sample);
        sum += darkness;
        moment += darkness * (k as f64 - reach as f64);
    }
    Some([sum, moment])
}

/// Brightness of the background beside the needle: the mean at `distance` on both sides.
pub(super) fn beside(
    image: &GrayImage,
    background: &Background,
    origin: Vector2<f64>,
    direction: Vector2<f64>,
    distance: f64,
) -> Option<f64> {
    let sides = [distance, distance + 1.0, -distance, -distance - 1.0];
    let mut sum = 0.0;
    for side in sides {
        sum += f64::from(background.brightness(image, origin + direction * side)?);
    }
    Some(sum / sides.len() as f64)
}
