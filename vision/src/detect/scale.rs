//! An image at other scales.
#![expect(clippy::cast_possible_truncation, reason = "means of bytes are bytes")]

use hal::GrayImage;
use nalgebra::Point2;

/// An image and how it came from the whole one.
#[derive(Clone, Debug)]
pub(super) struct Scaled {
    pub image: GrayImage,
    /// Halvings; -1 for a doubled image.
    pub steps: i32,
}

impl Scaled {
    /// The image itself.
    pub(super) fn whole(image: &GrayImage) -> Self {
        Self {
            image: image.clone(),
            steps: 0,
        }
    }

    /// Where a point of this image lies in the whole one.
    pub(super) fn in_whole(&self, p: &Point2<f64>) -> Point2<f64> {
        let factor = 2.0_f64.powi(self.steps);
        // The centre of the half-size pixel k is between pixels 2k and 2k + 1.
        let at = |v: f64| (v + 0.5) * factor - 0.5;
        Point2::new(at(p.x), at(p.y))
    }
}

/// Means of two by two pixels.
pub(super) fn halved(scaled: &Scaled) -> Scaled {
    let image = &scaled.image;
    let (w, h) = (image.width() / 2, image.height() / 2);
    let mut half = GrayImage::filled(w, h, 0);
    for (y, line) in half.pixels_mut().chunks_exact_mut(w).enumerate() {
        let (a, b) = (image.row(2 * y), image.row(2 * y + 1));
        let pairs = a.chunks_exact(2).zip(b.chunks_exact(2));
        for (v, (a, b)) in line.iter_mut().zip(pairs) {
            let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
            *v = ((sum + 2) / 4) as u8;
        }
    }
    Scaled {
        image: half,
        steps: scaled.steps + 1,
    }
}

/// Twice the size, between pixels linear.
pub(super) fn doubled(scaled: &Scaled) -> Scaled {
    let image = &scaled.image;
    let (w, h) = (image.width(), image.height());
    let mut twice = GrayImage::filled(2 * w, 2 * h, 0);
    for (y, line) in twice.pixels_mut().chunks_exact_mut(2 * w).enumerate() {
        // Three parts of the pixel below, one of the next on that side.
        let near = y / 2;
        let far = if y % 2 == 0 {
            near.saturating_sub(1)
        } else {
            (near + 1).min(h - 1)
        };
        let (a, b) = (image.row(near), image.row(far));
        for (x, v) in line.iter_mut().enumerate() {
            let near = x / 2;
            let far = if x % 2 == 0 {
                near.saturating_sub(1)
            } else {
                (near + 1).min(w - 1)
            };
            let mix = |row: &[u8]| 3 * u16::from(row[near]) + u16::from(row[far]);
            *v = ((3 * mix(a) + mix(b) + 8) / 16) as u8;
        }
    }
    Scaled {
        image: twice,
        steps: scaled.steps - 1,
    }
}

/// Binomial over five by five pixels (a sigma of one): squares that do not quite touch meet.
pub(super) fn smoothed(scaled: &Scaled) -> Scaled {
    let image = &scaled.image;
    let (w, h) = (image.width(), image.height());
    let mut smooth = image.clone();
    if w < 5 || h < 5 {
        return scaled.clone();
    }
    let mut rows = vec![0_u16; w * h];
    for (y, line) in rows.chunks_exact_mut(w).enumerate() {
        let row = image.row(y);
        for (v, window) in line[2..].iter_mut().zip(row.windows(5)) {
            let [a, b, c, d, e] = [0, 1, 2, 3, 4].map(|k: usize| u16::from(window[k]));
            *v = a + 4 * b + 6 * c + 4 * d + e;
        }
        for x in [0, 1, w - 2, w - 1] {
            line[x] = 16 * u16::from(row[x]);
        }
    }
    let of = |y: usize| &rows[y * w..][..w];
    for (y, line) in smooth.pixels_mut().chunks_exact_mut(w).enumerate() {
        let up = |k: usize| of((y + k).saturating_sub(2).min(h - 1));
        let (a, b, c, d, e) = (up(0), up(1), up(2), up(3), up(4));
        for (x, v) in line.iter_mut().enumerate() {
            let sum = u32::from(a[x])
                + 4 * u32::from(b[x])
                + 6 * u32::from(c[x])
                + 4 * u32::from(d[x])
                + u32::from(e[x]);
            *v = ((sum + 128) / 256) as u8;
        }
    }
    Scaled {
        image: smooth,
        steps: scaled.steps,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bright_spot_stays_where_it_is_at_every_scale() {
        let mut image = GrayImage::filled(40, 30, 10);
        for y in 12..16 {
            for x in 20..24 {
                image.pixels_mut()[y * 40 + x] = 210;
            }
        }
        let whole = Scaled::whole(&image);
        for scaled in [
            halved(&whole),
            doubled(&whole),
            smoothed(&whole),
            halved(&halved(&whole)),
        ] {
            let (mut x, mut y, mut sum) = (0.0, 0.0, 0.0);
            for row in 0..scaled.image.height() {
                for (col, v) in scaled.image.row(row).iter().enumerate() {
                    let weight = f64::from(*v) - 10.0;
                    let at = scaled.in_whole(&Point2::new(col as f64, row as f64));
                    (x, y, sum) = (x + weight * at.x, y + weight * at.y, sum + weight);
                }
            }
            assert!(
                (x / sum - 21.5).abs() < 0.02,
                "{} {}",
                scaled.steps,
                x / sum
            );
            assert!(
                (y / sum - 13.5).abs() < 0.02,
                "{} {}",
                scaled.steps,
                y / sum
            );
        }
    }
}
