//! The lens's Gaussian point-spread function.

use super::coverage::SparsePlane;
use super::renderer::narrow;

/// A normalised, symmetric kernel.
#[derive(Clone, Debug)]
pub(super) struct Blur {
    /// From the centre outwards.
    half: Vec<f32>,
}

impl Blur {
    /// None for no blur.
    pub(super) fn new(sigma: f64) -> Option<Self> {
        if sigma <= 0.0 {
            return None;
        }
        let weight = |k: i32| (-0.5 * (f64::from(k) / sigma).powi(2)).exp();
        let mut weights = vec![weight(0)];
        weights.extend((1..).map(weight).take_while(|w| *w > 1e-4));
        let sum = 2.0 * weights.iter().sum::<f64>() - weights[0];
        Some(Self {
            half: weights.iter().map(|w| narrow(w / sum)).collect(),
        })
    }

    /// Blurs a full plane; beyond the image it continues as at the border.
    pub(super) fn dense(&self, values: &mut [f32], width: usize, height: usize) {
        let mut rows = vec![0.0; width * height];
        for (row, out) in values.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
            for (x, out) in out.iter_mut().enumerate() {
                *out = self.half[0] * row[x];
                for (k, weight) in self.half.iter().enumerate().skip(1) {
                    *out += weight * (row[x.saturating_sub(k)] + row[(x + k).min(width - 1)]);
                }
            }
        }
        for y in 0..height {
            let out = &mut values[y * width..(y + 1) * width];
            let row = |y: usize| &rows[y * width..(y + 1) * width];
            for (out, v) in out.iter_mut().zip(row(y)) {
                *out = self.half[0] * v;
            }
            for (k, weight) in self.half.iter().enumerate().skip(1) {
                let (above, below) = (row(y.saturating_sub(k)), row((y + k).min(height - 1)));
                for ((out, a), b) in out.iter_mut().zip(above).zip(below) {
                    *out += weight * (a + b);
                }
            }
        }
    }

    /// Blurs what a sparse plane holds; `spare` must be empty and is left so.
    pub(super) fn sparse(&self, plane: &mut SparsePlane, spare: &mut SparsePlane) {
        let reach = self.half.len() - 1;
        let (width, height) = plane.size();
        for y in plane.rows() {
            let span = plane.span(y);
            if span.is_empty() {
                continue;
            }
            let wide = span.start.saturating_sub(reach)..(span.end + reach).min(width);
            let row = &plane.row(y)[span.clone()];
            let out = spare.open(y, wide.clone());
            for (x, &v) in span.zip(row) {
                out[x - wide.start] += self.half[0] * v;
                for (k, weight) in self.half.iter().enumerate().skip(1) {
                    if x >= wide.start + k {
                        out[x - k - wide.start] += weight * v;
                    }
                    if x + k < wide.end {
                        out[x + k - wide.start] += weight * v;
                    }
                }
            }
        }
        let rows = spare.rows();
        plane.clear();
        if rows.is_empty() {
            return;
        }
        for y in rows.start.saturating_sub(reach)..(rows.end + reach).min(height) {
            // The needle goes on beyond the image as it does at the border.
            let mut add = |from: usize, weight: f32| {
                let span = spare.span(from);
                if span.is_empty() {
                    return;
                }
                let out = plane.open(y, span.clone());
                for (out, v) in out.iter_mut().zip(&spare.row(from)[span]) {
                    *out += weight * v;
                }
            };
            add(y, self.half[0]);
            for (k, weight) in self.half.iter().enumerate().skip(1) {
                add(y.saturating_sub(k), *weight);
                add((y + k).min(height - 1), *weight);
            }
        }
        spare.clear();
    }
}
