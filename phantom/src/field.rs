//! Smooth random variation along depth.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Distance between samples \[m\].
const SPACING: f64 = 0.5e-3;
/// Depth up to which the field is drawn \[m\]; deeper it is constant.
const DEPTH: f64 = 0.2;

/// A stationary Gaussian field of depth with unit variance and squared-exponential
/// correlation, sampled every 0.5 mm.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Field {
    samples: Vec<f64>,
}

impl Field {
    /// Draws a field; its correlation falls to 1/e at `sqrt(2) length` \[m\].
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a positive number of samples"
    )]
    pub(crate) fn draw(rng: &mut ChaCha8Rng, length: f64) -> Self {
        // White noise smoothed by a Gaussian of width length / sqrt(2).
        let width = length / core::f64::consts::SQRT_2 / SPACING;
        let half = (3.0 * width).ceil() as usize;
        let count = (DEPTH / SPACING) as usize + 1;
        let noise: Vec<f64> = (0..count + 2 * half)
            .map(|_| StandardNormal.sample(rng))
            .collect();
        let kernel: Vec<f64> = (0..=2 * half)
            .map(|k| {
                let x = (k as f64 - half as f64) / width;
                (-0.5 * x * x).exp()
            })
            .collect();
        let norm = kernel.iter().map(|k| k * k).sum::<f64>().sqrt();
        let samples = noise
            .windows(kernel.len())
            .map(|window| {
                let sum: f64 = window.iter().zip(&kernel).map(|(n, k)| n * k).sum();
                sum / norm
            })
            .collect();
        Self { samples }
    }

    /// Value at `depth` \[m\], linear between samples.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the table"
    )]
    pub(crate) fn at(&self, depth: f64) -> f64 {
        let last = self.samples.len() - 2;
        let position = (depth / SPACING).clamp(0.0, (last + 1) as f64);
        let index = (position as usize).min(last);
        let fraction = position - index as f64;
        self.samples[index] + fraction * (self.samples[index + 1] - self.samples[index])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn unit_variance_and_the_stated_correlation() {
        let (length, draws) = (0.01, 4000);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let (mut variance, mut covariance) = (0.0, 0.0);
        for _ in 0..draws {
            let field = Field::draw(&mut rng, length);
            variance += field.at(0.05).powi(2);
            covariance += field.at(0.05) * field.at(0.06);
        }
        let n = f64::from(draws);
        // Standard errors: sqrt(2 / n) = 0.022 and 0.018; three of them.
        assert!((variance / n - 1.0).abs() < 0.067);
        assert!((covariance / n - (-0.5f64).exp()).abs() < 0.055);
    }
}
