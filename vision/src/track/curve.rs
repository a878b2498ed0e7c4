//! Polynomial curves through control points on the needle.

use nalgebra::Vector2;

/// Most control points of a curve.
pub(super) const MOST: usize = 6;

/// Weights of the control points.
pub(super) type Weights = [f64; MOST];

/// Lagrange weights of `n` control points at equal parameters 0 to 1, at parameter `t`.
pub(super) fn weights(n: usize, t: f64) -> Weights {
    let scale = (n - 1) as f64;
    let x = t * scale;
    let mut out = [0.0; MOST];
    for (i, weight) in out.iter_mut().enumerate().take(n) {
        *weight = (0..n).filter(|j| *j != i).fold(1.0, |product, j| {
            product * (x - j as f64) / (i as f64 - j as f64)
        });
    }
    out
}

/// Derivatives of [`weights`] by the parameter.
pub(super) fn slopes(n: usize, t: f64) -> Weights {
    let scale = (n - 1) as f64;
    let x = t * scale;
    let mut out = [0.0; MOST];
    for (i, slope) in out.iter_mut().enumerate().take(n) {
        let others = || (0..n).filter(|j| *j != i);
        let denominator: f64 = others().map(|j| i as f64 - j as f64).product();
        let sum: f64 = others()
            .map(|k| {
                others()
                    .filter(|j| *j != k)
                    .map(|j| x - j as f64)
                    .product::<f64>()
            })
            .sum();
        *slope = sum / denominator * scale;
    }
    out
}

/// The direction square to `tangent`, a quarter turn from x towards y.
pub(super) fn normal(tangent: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-tangent.y, tangent.x)
}

/// A curve in one image: from where the needle comes into sight (parameter 0) to the tip O
/// (parameter 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve2 {
    count: usize,
    points: [Vector2<f64>; MOST],
}

impl Curve2 {
    /// A curve through `points`, at equal parameters; between 4 and 6 of them are taken.
    pub(super) fn new(count: usize, points: [Vector2<f64>; MOST]) -> Self {
        Self { count, points }
    }

    /// The control points \[px\]; the last is the tip.
    pub fn control_points(&self) -> &[Vector2<f64>] {
        self.points.get(..self.count).unwrap_or_default()
    }

    /// The tip O \[px\].
    pub fn tip(&self) -> Vector2<f64> {
        self.control_points().last().copied().unwrap_or_default()
    }

    /// The point at `t` \[px\].
    pub fn at(&self, t: f64) -> Vector2<f64> {
        self.sum(&weights(self.count, t))
    }

    /// The derivative at `t` \[px\].
    pub fn derivative(&self, t: f64) -> Vector2<f64> {
        self.sum(&slopes(self.count, t))
    }

    /// Sum of the control points by `weights`.
    pub(super) fn sum(&self, weights: &Weights) -> Vector2<f64> {
        self.control_points()
            .iter()
            .zip(weights)
            .fold(Vector2::zeros(), |sum, (p, w)| sum + p * *w)
    }

    /// Length of the polygon through 16 points \[px\].
    pub fn length(&self) -> f64 {
        const PIECES: usize = 16;
        let mut last = self.at(0.0);
        let mut length = 0.0;
        for i in 1..=PIECES {
            let next = self.at(i as f64 / PIECES as f64);
            length += (next - last).norm();
            last = next;
        }
        length
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_reproduce_polynomials_and_their_slopes() {
        for n in 4..=MOST {
            let value = |t: f64| (0..n).rev().fold(0.0, |sum, _| sum * t + 1.0);
            let slope = |t: f64| (1..n).rev().fold(0.0, |sum, k| sum * t + k as f64);
            for t in [-0.2, 0.0, 0.3, 0.77, 1.0, 1.1] {
                let sum = |w: Weights| {
                    (0..n)
                        .map(|i| w[i] * value(i as f64 / (n - 1) as f64))
                        .sum::<f64>()
                };
                // Rounding of sums of a few products of order one.
                assert!((sum(weights(n, t)) - value(t)).abs() < 1e-12);
                assert!((sum(slopes(n, t)) - slope(t)).abs() < 1e-11);
            }
        }
    }
}
