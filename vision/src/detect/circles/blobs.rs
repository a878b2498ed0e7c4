//! Dark discs on bright ground: connected areas that are ellipses.

use core::f64::consts::PI;

use hal::GrayImage;
use nalgebra::{Matrix2, Point2, Vector2};

/// An elliptic area.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blob {
    /// Its centre \[px\].
    pub at: Point2<f64>,
    /// Its area \[px2\].
    pub area: f64,
    /// Covariance of its area \[px2\]: a quarter of the squared half axes.
    pub spread: Matrix2<f64>,
}

/// Half width of the window whose mean tells dark from bright, over the image's longer side.
const WINDOW: f64 = 0.06;
/// Grey levels by which a disc is darker than the mean around it.
const DARKER: i64 = 6;
/// Smallest disc that is more than noise \[px2\].
const SMALLEST: f64 = 20.0;
/// An ellipse's area over that of its second moments; others are squares, letters, rims.
const ELLIPTIC: core::ops::RangeInclusive<f64> = 0.93..=1.07;
/// Greatest ratio of an ellipse's axes: a view 10 degrees from edge-on.
const FLAT: f64 = 6.0;

/// The dark ellipses of an image that do not touch its border.
pub(super) fn blobs(image: &GrayImage) -> Vec<Blob> {
    let (w, h) = (image.width(), image.height());
    let dark = darker_than_around(image);
    let mut seen = vec![false; w * h];
    let mut found = Vec::new();
    let mut todo = Vec::new();
    for start in 0..w * h {
        if !dark[start] || seen[start] {
            continue;
        }
        seen[start] = true;
        todo.push(start);
        let (mut n, mut sum, mut square) = (0.0, Vector2::zeros(), Matrix2::zeros());
        let mut border = false;
        while let Some(k) = todo.pop() {
            let (x, y) = (k % w, k / w);
            border |= x == 0 || y == 0 || x + 1 == w || y + 1 == h;
            let p = Vector2::new(x as f64, y as f64);
            n += 1.0;
            sum += p;
            square += p * p.transpose();
            let beside = [
                (x > 0).then(|| k - 1),
                (x + 1 < w).then(|| k + 1),
                (y > 0).then(|| k - w),
                (y + 1 < h).then(|| k + w),
            ];
            for next in beside.into_iter().flatten() {
                if dark[next] && !seen[next] {
                    seen[next] = true;
                    todo.push(next);
                }
            }
        }
        if border || n < SMALLEST {
            continue;
        }
        let mean = sum / n;
        // A pixel is a square, not a point.
        let spread = square / n - mean * mean.transpose() + Matrix2::identity() / 12.0;
        let root = spread.determinant().max(0.0).sqrt();
        let flatness = spread.trace() / root;
        if ELLIPTIC.contains(&(n / (4.0 * PI * root))) && flatness < FLAT + 1.0 / FLAT {
            found.push(Blob {
                at: Point2::from(mean),
                area: n,
                spread,
            });
        }
    }
    found
}

/// Which pixels are darker than the mean of the window around them.
fn darker_than_around(image: &GrayImage) -> Vec<bool> {
    let (w, h) = (image.width(), image.height());
    let mut integral = vec![0_i64; (w + 1) * (h + 1)];
    for y in 0..h {
        let mut line = 0;
        for (x, v) in image.row(y).iter().enumerate() {
            line += i64::from(*v);
            integral[(y + 1) * (w + 1) + x + 1] = integral[y * (w + 1) + x + 1] + line;
        }
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a part of the image's size"
    )]
    let half = (WINDOW * w.max(h) as f64) as usize + 1;
    let mut dark = vec![false; w * h];
    for y in 0..h {
        let (top, bottom) = (y.saturating_sub(half), (y + half + 1).min(h));
        for (x, v) in image.row(y).iter().enumerate() {
            let (left, right) = (x.saturating_sub(half), (x + half + 1).min(w));
            let at = |x: usize, y: usize| integral[y * (w + 1) + x];
            let sum = at(right, bottom) + at(left, top) - at(left, bottom) - at(right, top);
            let count = ((right - left) * (bottom - top)).cast_signed() as i64;
            dark[y * w + x] = (i64::from(*v) + DARKER) * count < sum;
        }
    }
    dark
}

/// The centre of a disc by its grey values; the blob's where the disc is not clear.
pub(super) fn centre(image: &GrayImage, blob: &Blob) -> Point2<f64> {
    // In half axes: the disc's inside, the ground beside it, and how far the edge is soft.
    const INSIDE: f64 = 0.6;
    const GROUND: (f64, f64) = (1.3, 1.6);
    let Some(inverse) = (blob.spread * 4.0).try_inverse() else {
        return blob.at;
    };
    let reach =
        Vector2::new(blob.spread[(0, 0)], blob.spread[(1, 1)]).map(|s| 2.0 * GROUND.1 * s.sqrt());
    let (w, h) = (image.width() as f64, image.height() as f64);
    let (low, high) = (blob.at.coords - reach, blob.at.coords + reach);
    if low.min() < 0.0 || high.x > w - 1.0 || high.y > h - 1.0 {
        return blob.at;
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "checked to lie inside the image"
    )]
    let (xs, ys) = (
        low.x as usize..=high.x as usize,
        low.y as usize..=high.y as usize,
    );
    let pixels = || {
        let xs = xs.clone();
        ys.clone().flat_map(move |y| {
            xs.clone().map(move |x| {
                let off = Vector2::new(x as f64, y as f64) - blob.at.coords;
                let radius = (off.dot(&(inverse * off))).sqrt();
                (off, radius, f64::from(image.row(y)[x]))
            })
        })
    };
    let mean = |from: f64, to: f64| {
        let chosen = pixels().filter(|(_, r, _)| (from..to).contains(r));
        let (sum, n) = chosen.fold((0.0, 0.0_f64), |(s, n), (_, _, v)| (s + v, n + 1.0));
        sum / n.max(1.0)
    };
    let (disc, ground) = (mean(0.0, INSIDE), mean(GROUND.0, GROUND.1));
    if ground - disc < DARKER as f64 {
        return blob.at;
    }
    let (mut sum, mut weight) = (Vector2::zeros(), 0.0);
    for (off, _, v) in pixels().filter(|(_, r, _)| *r < GROUND.0) {
        let part = ((ground - v) / (ground - disc)).clamp(0.0, 1.0);
        sum += off * part;
        weight += part;
    }
    blob.at + sum / weight
}
