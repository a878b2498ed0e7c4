//! The blur of an image and the width of a needle that was sought, from its profile: unlike how steep its
//! flanks are ([`super::blur`]), this tells them where the blur is as wide as the needle.
#![expect(
    clippy::cast_possible_wrap,
    clippy::cast_possible_truncation,
    reason = "small counts"
)]

use super::blur::{Band, normal};

/// Values tried of blur and width in each round, and rounds; each searches around the best of the last.
const TRIED: usize = 21;
const ROUNDS: usize = 4;
/// Steps to either side of the best that the next round covers: where the blur is wide, wide and narrow bands
/// are nearly alike.
const AROUND: f64 = 2.5;
/// Least blur and width \[px\].
const LEAST: f64 = 0.3;

impl Band {
    /// Height at `x` from the middle, of a band of height 1 \[px\].
    pub(super) fn height(&self, x: f64) -> f64 {
        let half = 0.5 * self.width;
        normal((x + half) / self.blur) - normal((x - half) / self.blur)
    }
}

/// The band that fits `profile` best: heights at every pixel from the middle on outwards, both sides
/// averaged, above a base that is not known. It is about `width` \[px\] wide at half height.
pub(super) fn fitted(profile: &[f64], width: f64) -> Band {
    let mut limits = [
        [LEAST, (0.5 * width).max(2.0 * LEAST)],
        [LEAST, width.max(2.0 * LEAST)],
    ];
    let mut best = (f64::INFINITY, Band::default());
    for _ in 0..ROUNDS {
        let ratios = limits.map(|[low, high]| (high / low).powf(1.0 / (TRIED - 1) as f64));
        for i in 0..TRIED * TRIED {
            let at = |k: usize, power: usize| limits[k][0] * ratios[k].powi(power as i32);
            let band = Band {
                blur: at(0, i / TRIED),
                width: at(1, i % TRIED),
            };
            let squares = misfit(profile, &band);
            if squares < best.0 {
                best = (squares, band);
            }
        }
        let around = [best.1.blur, best.1.width];
        for k in 0..2 {
            let wide = ratios[k].powf(AROUND);
            limits[k] = [(around[k] / wide).max(LEAST), around[k] * wide];
        }
    }
    best.1
}

/// Squares that are left of `profile` when `band` is fitted to it with a height and a base.
fn misfit(profile: &[f64], band: &Band) -> f64 {
    let n = profile.len() as f64;
    let (mut p, mut pp, mut py, mut y, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (k, seen) in profile.iter().enumerate() {
        let height = band.height(k as f64);
        p += height;
        pp += height * height;
        py += height * seen;
        y += seen;
        yy += seen * seen;
    }
    let (covariance, variance) = (py - p * y / n, pp - p * p / n);
    let left = yy - y * y / n;
    if variance > 1e-9 {
        left - covariance * covariance / variance
    } else {
        left
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_blur_of_a_drawn_band_is_found() {
        for width in [3.0, 6.0, 20.0] {
            for blur in [0.6, 1.0, 2.0, 4.0] {
                let drawn = Band { blur, width };
                let (mut low, mut high) = (0.0, 40.0);
                for _ in 0..50 {
                    let middle = 0.5 * (low + high);
                    if drawn.height(middle) > 0.5 * drawn.height(0.0) {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                let places = (0..).map(f64::from).take_while(|x| *x <= low + 8.0);
                let profile: Vec<f64> = places.map(|x| 0.3 * drawn.height(x) - 0.02).collect();
                let found = fitted(&profile, 2.0 * low);
                // Where the blur is as wide as the band, all bands look nearly alike.
                let doubt = 0.02 + 0.03 * (blur / width).powi(2);
                assert!(
                    (found.blur / blur - 1.0).abs() < doubt
                        && (found.width / width - 1.0).abs() < 4.0 * doubt,
                    "{drawn:?}: {found:?}"
                );
            }
        }
    }
}
