//! Polynomial curves through control points on the needle.

use nalgebra::Vector2;

/// Most control points of a curve.
pub(super) const MOST: usize = 6;

/// Weights of the control points.
pub(super) type Weights = [f64; MOST];

/// One over the products of differences between the control points' numbers, by their count.
const INVERSES: [Weights; MOST + 1] = {
    let mut table = [[0.0; MOST]; MOST + 1];
    let mut n = 1;
    while n <= MOST {
        let mut i = 0;
        while i < n {
            let mut product = 1.0;
            let mut j = 0;
            while j < n {
                if j != i {
                    product *= i as f64 - j as f64;
                }
                j += 1;
            }
            table[n][i] = 1.0 / product;
            i += 1;
        }
        n += 1;
    }
    table
};

/// Lagrange weights of `n` control points at equal parameters 0 to 1, at parameter `t`.
pub(super) fn weights(n: usize, t: f64) -> Weights {
    weights_and_slopes(n, t).0
}

/// Derivatives of [`weights`] by the parameter.
pub(super) fn slopes(n: usize, t: f64) -> Weights {
    weights_and_slopes(n, t).1
}

/// [`weights`] and [`slopes`].
#[inline]
pub(super) fn weights_and_slopes(n: usize, t: f64) -> (Weights, Weights) {
    match n {
        4 => lagrange::<4>(t),
        5 => lagrange::<5>(t),
        _ => lagrange::<MOST>(t),
    }
}

/// Of `N` control points, a number that is known when this is compiled: it is called a lot.
fn lagrange<const N: usize>(t: f64) -> (Weights, Weights) {
    let scale = (N - 1) as f64;
    let x = t * scale;
    let times = |(value, slope): (f64, f64), j: usize| {
        let factor = x - j as f64;
        (value * factor, slope * factor + value)
    };
    // Products of `x - j` with their derivatives: of all `j` below each index, then of all above.
    let mut below = [(1.0, 0.0); N];
    for j in 1..N {
        below[j] = times(below[j - 1], j - 1);
    }
    let (mut weights, mut slopes) = ([0.0; MOST], [0.0; MOST]);
    let mut above = (1.0, 0.0);
    for i in (0..N).rev() {
        let (value, slope) = below[i];
        weights[i] = value * above.0 * INVERSES[N][i];
        slopes[i] = (slope * above.0 + value * above.1) * INVERSES[N][i] * scale;
        above = times(above, i);
    }
    (weights, slopes)
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
