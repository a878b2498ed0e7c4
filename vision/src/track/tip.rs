//! The tip from the darkness along the needle's end, for a bevel seen at any azimuth.
//!
//! The bevel's face is an ellipse on the shaft's cylinder; its image is an ellipse that touches
//! both sides of the shaft. What is left of the shaft's width beside and between the touching
//! points is known in closed form; the two halves of it, blurred, are fitted to the darkness.

use hal::GrayImage;
use nalgebra::{Point2, Vector2};

use super::across::sample;

/// Step of the model's table \[px\].
const STEP: f64 = 0.25;
const TABLE: usize = 512;
/// Most samples along the axis.
const ROWS: usize = 320;

/// The bevel's face in an image, relative to O: `centre + first cos + second sin` \[px\].
#[derive(Clone, Copy, Debug)]
pub(super) struct FaceImage {
    pub centre: Vector2<f64>,
    pub first: Vector2<f64>,
    pub second: Vector2<f64>,
}

/// Visible width along the axis, in halves right and left of the centre line, blurred.
#[derive(Clone, Debug)]
pub(super) struct TipModel {
    halves: Vec<[f64; 2]>,
    /// Where the table begins, from O \[px\].
    from: f64,
    /// Where half of the width is left, from O \[px\].
    half_way: f64,
    width: f64,
    blur: f64,
    raw: Vec<[f64; 2]>,
}

impl TipModel {
    pub(super) fn new() -> Self {
        Self {
            halves: Vec::with_capacity(TABLE),
            from: 0.0,
            half_way: 0.0,
            width: 1.0,
            blur: 1.0,
            raw: Vec::with_capacity(TABLE),
        }
    }

    /// Builds the table for a face; `axis` is the unit tangent out of the needle.
    pub(super) fn build(&mut self, face: &FaceImage, axis: Vector2<f64>, width: f64, blur: f64) {
        let normal = Vector2::new(-axis.y, axis.x);
        let split = |v: &Vector2<f64>| (v.dot(&axis), v.dot(&normal));
        let (vc, qc) = split(&face.centre);
        let ((av, aq), (bv, bq)) = (split(&face.first), split(&face.second));
        let reach = av.hypot(bv).max(1e-6);
        let (qa, qb) = (
            (aq * av + bq * bv) / reach,
            ((bq * av - aq * bv) / reach).abs(),
        );
        let side = qa.hypot(qb).max(1e-9);
        let margin = 3.0 * blur + 2.0;
        self.from = (vc - reach).min(0.0) - margin;
        let end = vc + reach + margin;
        let n = steps((end - self.from) / STEP).min(TABLE);
        let half = 0.5 * width;
        self.raw.clear();
        for i in 0..n {
            let k = (self.from + STEP * i as f64 - vc) / reach;
            let arch = (1.0 - k * k).max(0.0).sqrt() * qb;
            let upper = if k <= qa / side {
                half
            } else if k < 1.0 {
                qc + k * qa + arch
            } else {
                0.0
            };
            let lower = if k <= -qa / side {
                -half
            } else if k < 1.0 {
                qc + k * qa - arch
            } else {
                0.0
            };
            // Lateral blur and the soft division of the samples move darkness between the halves.
            let soft = blur.hypot(0.58);
            let right = |q: f64| {
                let z = q / soft;
                q * normal_share(z) + soft * 0.398_942_28 * (-0.5 * z * z).exp()
            };
            let r = right(upper) - right(lower);
            self.raw.push([r, (upper - lower) - r]);
        }
        self.width = width;
        self.blur = blur;
        self.smooth();
        let total = |h: &[f64; 2]| h[0] + h[1];
        let crossing = self
            .halves
            .iter()
            .rposition(|h| total(h) > 0.5 * width)
            .unwrap_or(0);
        self.half_way = self.from + STEP * crossing as f64;
    }

    fn smooth(&mut self) {
        let sigma = self.blur / STEP;
        let reach = steps(3.0 * sigma).min(48);
        let mut kernel = [0.0; 49];
        let mut sum = 0.0;
        for (k, w) in kernel[..=reach].iter_mut().enumerate() {
            *w = (-0.5 * (k as f64 / sigma).powi(2)).exp();
            sum += if k == 0 { *w } else { 2.0 * *w };
        }
        self.halves.clear();
        let last = self.raw.len() - 1;
        for i in 0..self.raw.len() {
            let mut h = [0.0; 2];
            for k in 0..=reach {
                let (a, b) = (self.raw[i.saturating_sub(k)], self.raw[(i + k).min(last)]);
                for c in 0..2 {
                    h[c] += kernel[k] * if k == 0 { a[c] } else { a[c] + b[c] };
                }
            }
            self.halves.push(h.map(|v| v / sum));
        }
    }

    /// Both halves at `v` from O, with their derivatives.
    #[inline]
    fn at(&self, v: f64) -> ([f64; 2], [f64; 2]) {
        let u = (v - self.from) / STEP;
        let last = self.halves.len() - 1;
        if u <= 0.0 {
            return (self.halves[0], [0.0; 2]);
        }
        let i = steps(u - 0.5);
        if i >= last {
            return ([0.0; 2], [0.0; 2]);
        }
        let f = u - i as f64;
        let (a, b) = (self.halves[i], self.halves[i + 1]);
        let slope = [(b[0] - a[0]) / STEP, (b[1] - a[1]) / STEP];
        ([a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1])], slope)
    }
}

/// Rounds to the nearest count.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "counts are small; negative ones become zero"
)]
fn steps(x: f64) -> usize {
    x.round().max(0.0) as usize
}

/// Cumulative normal distribution, to 1e-3 (a logistic approximation).
fn normal_share(z: f64) -> f64 {
    1.0 / (1.0 + (-z * (1.5957 + 0.070_565 * z * z)).exp())
}

/// The measured tip.
#[derive(Clone, Copy, Debug)]
pub(super) struct TipMark {
    /// O, from the prediction along the tangent \[px\].
    pub offset: f64,
    /// Standard deviation \[px\].
    pub sigma: f64,
    /// Misfit of the profile, relative to the shaft's darkness.
    pub misfit: f64,
}

/// Samples along the axis, reused.
#[derive(Clone, Debug)]
pub(super) struct Profile {
    rows: Vec<Option<[f64; 2]>>,
}

impl Profile {
    pub(super) fn new() -> Self {
        Self {
            rows: Vec::with_capacity(ROWS),
        }
    }

    /// Finds O within `search` of `v = 0` on the curve `place(v)` (point and unit normal at
    /// arc v); `contrast` is the shaft's darkness.
    pub(super) fn locate(
        &mut self,
        image: &GrayImage,
        place: impl Fn(f64) -> (Point2<f64>, Vector2<f64>),
        model: &TipModel,
        contrast: f64,
        search: f64,
    ) -> Option<TipMark> {
        let before = (search + 2.5 * model.width + 3.0 * model.blur - model.from).ceil();
        let after = search - model.from.min(0.0) + model.half_way + 6.0 * model.blur + 6.0;
        let n = steps(before + after).min(ROWS);
        let core = steps(0.5 * model.width + 2.0 * model.blur).max(2);
        self.rows.clear();
        for i in 0..n {
            let (p, normal) = place(i as f64 - before);
            self.rows.push(halves(image, p, normal, core));
        }
        let shaft = contrast * model.width;
        // From the shaft outwards to where it ends: half is left there, and no more behind.
        let mut dark = 0;
        let mut end = None;
        let mut light = 0;
        for (i, row) in self.rows.iter().enumerate() {
            let Some(h) = row else { continue };
            if h[0] + h[1] > 0.5 * shaft {
                dark += 1;
                light = 0;
                end = Some(i);
            } else if dark > 2 {
                light += 1;
                if light >= 3 {
                    break;
                }
            }
        }
        let end = end? as f64;
        if dark < 3 || light < 3 {
            return None;
        }
        let coarse = end + 0.5 - before - model.half_way;
        self.refine(model, shaft, before, coarse)
    }

    /// Gauss-Newton on the place and the darkness.
    fn refine(&self, model: &TipModel, shaft: f64, before: f64, coarse: f64) -> Option<TipMark> {
        let mut v0 = coarse;
        let gain0 = shaft / model.width;
        let mut gain = gain0;
        let (mut sigma, mut misfit) = (f64::INFINITY, f64::INFINITY);
        for _ in 0..6 {
            let first = steps(v0 + before + model.from - model.width).min(self.rows.len());
            let last = steps(v0 + before + model.half_way + 3.0 * model.blur + 4.0)
                .min(self.rows.len().saturating_sub(1));
            // Darkness: known from the shaft to a fifth.
            let (mut a, mut b, mut c) = (0.0, 0.0, (5.0 * model.width).powi(2) * 0.01);
            let (mut g, mut h) = (0.0, c * (gain0 - gain));
            let (mut square, mut count) = (0.0, 0.0);
            let scale = (misfit * shaft * 3.0).max(0.12 * shaft);
            for i in first..=last {
                let Some(Some(row)) = self.rows.get(i) else {
                    continue;
                };
                let (m, slope) = model.at(i as f64 - before - v0);
                for k in 0..2 {
                    let e = row[k] - gain * m[k];
                    let z = (e / scale).powi(2);
                    let weight = if z < 1.0 { (1.0 - z).powi(2) } else { 0.0 };
                    let d = -gain * slope[k];
                    a += weight * d * d;
                    b += weight * d * m[k];
                    c += weight * m[k] * m[k];
                    g += weight * d * e;
                    h += weight * m[k] * e;
                    square += e.abs().min(scale).powi(2);
                    count += 1.0;
                }
            }
            let det = a * c - b * b;
            if count < 8.0 || det.is_nan() || det <= 1e-9 * a * c || a <= 0.0 {
                return None;
            }
            let step = ((c * g - b * h) / det).clamp(-2.0, 2.0);
            v0 += step;
            gain += (a * h - b * g) / det;
            let variance = square / (count - 2.0);
            sigma = (variance * c / det).sqrt();
            misfit = variance.sqrt() / shaft;
            if step.abs() < 2e-3 {
                break;
            }
        }
        let plausible = gain > 0.5 * gain0 && gain < 1.8 * gain0 && misfit < 0.2;
        (plausible && (v0 - coarse).abs() < model.width + 3.0).then_some(TipMark {
            offset: v0,
            sigma,
            misfit,
        })
    }
}

/// Darkness right and left of the centre line, background removed \[grey px\].
fn halves(
    image: &GrayImage,
    p: Point2<f64>,
    normal: Vector2<f64>,
    core: usize,
) -> Option<[f64; 2]> {
    const FLANK: usize = 3;
    let half = (core + FLANK) as f64;
    let n = 2 * (core + FLANK) + 1;
    let (mut low, mut high) = (0.0, 0.0);
    let (mut sum, mut right) = (0.0, 0.0);
    for k in 0..n {
        let q = k as f64 - half;
        let at = p + normal * q;
        let g = f64::from(sample(image, at.x, at.y)?);
        if k < FLANK {
            low += g;
        } else if k >= n - FLANK {
            high += g;
        } else {
            sum += g;
            right += g * (0.5 + 0.5 * q).clamp(0.0, 1.0);
        }
    }
    let (low, high) = (low / FLANK as f64, high / FLANK as f64);
    let level = 0.5 * (low + high);
    // Mean of the background over the right half: level plus the tilt at its middle.
    let count = (2 * core + 1) as f64;
    let tilt = (high - low) / (2.0 * core as f64 + FLANK as f64 + 1.0);
    let mut lever = 0.0;
    for k in 1..=core {
        lever += k as f64;
    }
    let r = 0.5 * count * level + tilt * lever - right;
    Some([r, count * level - sum - r])
}
