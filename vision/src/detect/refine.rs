//! Sub-pixel position of a crossing.
//!
//! At the centre every gradient of the window is orthogonal to the line that joins it to the
//! centre \[Foerstner1987\]; the weighted least squares of that, iterated.

use hal::GrayImage;
use nalgebra::{Matrix2, Point2, Vector2};

/// Settings of the refinement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RefineOptions {
    /// Greatest half width of the window in images up to 640 px wide \[px\], proportionally more
    /// in wider ones. A corner's own is also at most a quarter of the distance to its nearest
    /// neighbour, so that no other edge enters it, and a third where that does not do.
    pub max_half_width: usize,
    /// Greatest number of iterations.
    pub max_iterations: usize,
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self {
            max_half_width: 5,
            max_iterations: 20,
        }
    }
}

/// Half width above which the buffers do not suffice \[px\].
const LARGEST: usize = 30;
/// A step below this ends the iteration \[px\].
const SETTLED: f64 = 1e-3;

/// The crossing near `start`; `None` if the iteration leaves the window or does not settle.
/// The half width is limited to 2..=30. At the image's border the part of the window that lies in
/// the image counts.
pub fn refine_corner(
    image: &GrayImage,
    start: Point2<f64>,
    half_width: usize,
    max_iterations: usize,
) -> Option<Point2<f64>> {
    let half = half_width.clamp(2, LARGEST);
    let size = 2 * half + 3;
    let mut weights = [0.0_f32; 2 * LARGEST + 1];
    for (k, w) in weights.iter_mut().take(2 * half + 1).enumerate() {
        let x = (k as f32 - half as f32) / half as f32;
        *w = (-x * x).exp();
    }
    let mut patch = [0.0_f32; (2 * LARGEST + 3) * (2 * LARGEST + 3)];
    let mut at = start;
    for _ in 0..max_iterations.max(1) {
        sample(image, &at, &mut patch[..size * size], size)?;
        let within = |at: f64, pixels: usize| {
            let mut inside = weights;
            // Samples a pixel before, and a pixel and its interpolation after.
            let last = pixels as f64 - 3.0;
            for (k, w) in inside.iter_mut().take(2 * half + 1).enumerate() {
                let place = at - half as f64 + k as f64;
                if place < 1.0 || place > last {
                    *w = 0.0;
                }
            }
            inside
        };
        let (wx, wy) = (within(at.x, image.width()), within(at.y, image.height()));
        let (a, b) = moments(
            &patch[..size * size],
            size,
            &wx[..=2 * half],
            &wy[..=2 * half],
        );
        let det = a.determinant();
        // Both edge directions must be there: the smaller eigenvalue not below a thousandth.
        if det.is_nan() || det <= 1e-3 * a.trace() * a.trace() / 4.0 {
            return None;
        }
        let step = Vector2::new(
            a[(1, 1)] * b.x - a[(0, 1)] * b.y,
            a[(0, 0)] * b.y - a[(1, 0)] * b.x,
        ) / det;
        at += step;
        if (at - start).amax() > half as f64 {
            return None;
        }
        if step.norm() < SETTLED {
            return Some(at);
        }
    }
    None
}

/// Bilinear samples of the window with one pixel around it for the differences; beyond the border
/// those of the border. `None` if its middle is not in the image.
fn sample(image: &GrayImage, at: &Point2<f64>, patch: &mut [f32], size: usize) -> Option<()> {
    let (w, h) = (image.width(), image.height());
    let inside = |v: f64, pixels: usize| v >= 1.0 && v < pixels as f64 - 2.0;
    if !(inside(at.x, w) && inside(at.y, h)) {
        return None;
    }
    let reach = (size / 2) as f64;
    let (x0, y0) = ((at.x - reach).floor(), (at.y - reach).floor());
    #[expect(clippy::cast_possible_truncation, reason = "a fraction of a pixel")]
    let (fx, fy) = ((at.x - reach - x0) as f32, (at.y - reach - y0) as f32);
    let (w00, w10) = ((1.0 - fx) * (1.0 - fy), fx * (1.0 - fy));
    let (w01, w11) = ((1.0 - fx) * fy, fx * fy);
    #[expect(clippy::cast_possible_truncation, reason = "near the image")]
    let (xi, yi) = (x0 as isize, y0 as isize);
    let row = |y: isize| image.row(usize::try_from(y).unwrap_or(0).min(h - 1));
    let whole = usize::try_from(xi).ok().filter(|x| x + size < w);
    for (r, line) in patch.chunks_exact_mut(size).enumerate() {
        let y = yi + r.cast_signed();
        let (top, bottom) = (row(y), row(y + 1));
        if let Some(x) = whole {
            let (top, bottom) = (&top[x..=x + size], &bottom[x..=x + size]);
            for k in 0..size {
                line[k] = w00 * f32::from(top[k])
                    + w10 * f32::from(top[k + 1])
                    + w01 * f32::from(bottom[k])
                    + w11 * f32::from(bottom[k + 1]);
            }
            continue;
        }
        let column = |k: usize| {
            usize::try_from(xi + k.cast_signed())
                .unwrap_or(0)
                .min(w - 1)
        };
        for (k, v) in line.iter_mut().enumerate() {
            let (a, b) = (column(k), column(k + 1));
            *v = w00 * f32::from(top[a])
                + w10 * f32::from(top[b])
                + w01 * f32::from(bottom[a])
                + w11 * f32::from(bottom[b]);
        }
    }
    Some(())
}

/// Sum of w g g^T, and of w g g^T p with p from the window's centre.
fn moments(
    patch: &[f32],
    size: usize,
    columns: &[f32],
    rows: &[f32],
) -> (Matrix2<f64>, Vector2<f64>) {
    let n = columns.len();
    let half = (n / 2) as f32;
    let (mut a, mut b, mut c, mut bx, mut by) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
    for r in 0..n {
        let up = &patch[r * size + 1..][..n];
        let mid = &patch[(r + 1) * size..][..size];
        let down = &patch[(r + 2) * size + 1..][..n];
        let y = r as f32 - half;
        let (mut xx, mut xy, mut yy, mut sx, mut sy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for k in 0..n {
            let gx = mid[k + 2] - mid[k];
            let gy = down[k] - up[k];
            let w = columns[k];
            let x = k as f32 - half;
            let (wxx, wxy, wyy) = (w * gx * gx, w * gx * gy, w * gy * gy);
            xx += wxx;
            xy += wxy;
            yy += wyy;
            sx += wxx * x + wxy * y;
            sy += wxy * x + wyy * y;
        }
        let w = f64::from(rows[r]);
        a += w * f64::from(xx);
        b += w * f64::from(xy);
        c += w * f64::from(yy);
        bx += w * f64::from(sx);
        by += w * f64::from(sy);
    }
    (Matrix2::new(a, b, b, c), Vector2::new(bx, by))
}
