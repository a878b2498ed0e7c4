//! The blur of an image, from how steep a needle's flanks are.

/// Blurs that are tried, by the needle's half width.
const TRIED: [f64; 14] = [
    0.03, 0.05, 0.08, 0.12, 0.18, 0.26, 0.37, 0.5, 0.7, 0.95, 1.3, 1.8, 2.5, 3.5,
];
/// Length of a difference that stands for the slope \[px\].
const STEP: f64 = 1.0;

/// A band as it was before it was blurred.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Band {
    /// Gaussian blur \[px\].
    pub blur: f64,
    /// Width without it \[px\].
    pub width: f64,
}

/// The band that blurred has flanks of the slope `steepness` at half height, in heights a width, and
/// there is `width` \[px\] wide.
pub(super) fn estimate(width: f64, steepness: f64) -> Band {
    let mut last: Option<(f64, Band)> = None;
    for ratio in TRIED {
        let half = half_width(ratio);
        // Of a band with a half width of 1; here it is in pixels.
        let unit = 0.5 * width / half;
        let slope = slope(ratio, half, STEP / unit) * 2.0 * half;
        let band = Band {
            blur: ratio * unit,
            width: 2.0 * unit,
        };
        if slope <= steepness {
            return last.map_or(band, |(before, last)| {
                let share = ((before - steepness) / (before - slope)).clamp(0.0, 1.0);
                Band {
                    blur: last.blur + (band.blur - last.blur) * share,
                    width: last.width + (band.width - last.width) * share,
                }
            });
        }
        last = Some((slope, band));
    }
    last.map(|(_, band)| band).unwrap_or_default()
}

/// A band of half width 1 under a Gaussian, by its height in the middle.
fn band(x: f64, sigma: f64) -> f64 {
    let height = |x: f64| normal((x + 1.0) / sigma) - normal((x - 1.0) / sigma);
    height(x) / height(0.0)
}

/// Where it is half as high.
fn half_width(sigma: f64) -> f64 {
    let (mut low, mut high) = (0.0, 2.0 + 3.0 * sigma);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if band(middle, sigma) > 0.5 {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Its slope there, as a difference over `step`.
fn slope(sigma: f64, half: f64, step: f64) -> f64 {
    (band(half - 0.5 * step, sigma) - band(half + 0.5 * step, sigma)) / step
}

/// Distribution function of the normal distribution, to 1.5e-7 \[Abramowitz1964, 7.1.26\].
pub(super) fn normal(x: f64) -> f64 {
    const A: [f64; 5] = [
        0.254_829_592,
        -0.284_496_736,
        1.421_413_741,
        -1.453_152_027,
        1.061_405_429,
    ];
    let z = x.abs() * core::f64::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let sum = A.iter().rev().fold(0.0, |sum, a| (sum + a) * t);
    let upper = 0.5 * sum * (-z * z).exp();
    if x < 0.0 { upper } else { 1.0 - upper }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_blur_of_a_drawn_band_is_found() {
        for half in [1.5, 3.0, 10.0] {
            for sigma in [0.6, 1.0, 2.0, 4.0] {
                let height = |x: f64| band(x / half, sigma / half);
                let (mut low, mut high) = (0.0, 40.0);
                for _ in 0..50 {
                    let middle = 0.5 * (low + high);
                    if height(middle) > 0.5 {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                let slope = height(low - 0.5) - height(low + 0.5);
                let found = estimate(2.0 * low, slope * 2.0 * low);
                // Between the blurs tried the slope is taken as linear.
                assert!(
                    (found.blur / sigma - 1.0).abs() < 0.1,
                    "{half} {sigma}: {found:?}"
                );
                // Where the blur is wider than the band, all bands look alike.
                let doubt = 0.05 + 0.2 * (sigma / half).powi(2);
                assert!(
                    (0.5 * found.width / half - 1.0).abs() < doubt,
                    "{half} {sigma}: {found:?}"
                );
            }
        }
    }
}
