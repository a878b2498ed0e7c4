//! Where an image looks like the crossing of four chessboard squares.
//!
//! The ChESS response \[Bennett2014\]: on a ring of sixteen samples, opposite samples agree and
//! samples a quarter turn apart do not.

use hal::GrayImage;

/// Radius that the ring needs around a pixel \[px\].
pub(super) const RING: usize = 5;

/// A quarter of the ring; the rest are its quarter turns.
const QUARTER: [(i32, i32); 4] = [(5, 0), (5, 2), (4, 4), (2, 5)];

/// A local maximum of the response.
#[derive(Clone, Copy, Debug)]
pub(super) struct Peak {
    pub x: usize,
    pub y: usize,
    pub response: i16,
}

/// Pixels handled at once: arrays of fixed size fill the vector units.
const LANES: usize = 16;

/// Response at every pixel, zero within [`RING`] of the border.
pub(super) fn response(image: &GrayImage) -> Vec<i16> {
    let (w, h) = (image.width(), image.height());
    let mut out = vec![0; w * h];
    if w < 2 * RING + LANES || h <= 2 * RING {
        return out;
    }
    let n = w - 2 * RING;
    for y in RING..h - RING {
        let at = |dx: i32, dy: i32| {
            let row = image.row(y.wrapping_add_signed(dy as isize));
            &row[RING.wrapping_add_signed(dx as isize)..][..n]
        };
        let ring: [[&[u8]; 4]; 4] =
            QUARTER.map(|(x, y)| [at(x, y), at(-y, x), at(-x, -y), at(y, -x)]);
        // The eight neighbours: half dark, half bright at a crossing, also between pixels.
        let around = [
            (-1, -1),
            (0, -1),
            (1, -1),
            (-1, 0),
            (1, 0),
            (-1, 1),
            (0, 1),
            (1, 1),
        ]
        .map(|(x, y)| at(x, y));
        let line = &mut out[y * w + RING..][..n];
        let mut x = 0;
        while x < n {
            // The last block overlaps the one before.
            x = x.min(n - LANES);
            let block = lanes_response(&ring, &around, x);
            line[x..x + LANES].copy_from_slice(&block);
            x += LANES;
        }
    }
    out
}

fn lanes_response(ring: &[[&[u8]; 4]; 4], around: &[&[u8]; 8], x: usize) -> [i16; LANES] {
    let (mut sum, mut diff, mut total) = ([0_i16; LANES], [0_i16; LANES], [0_i16; LANES]);
    for rows in ring {
        let [a, b, c, d] = rows.map(|row| load(row, x));
        for k in 0..LANES {
            let (ac, bd) = (a[k] + c[k], b[k] + d[k]);
            sum[k] += (ac - bd).abs();
            diff[k] += (a[k] - c[k]).abs() + (b[k] - d[k]).abs();
            total[k] += ac + bd;
        }
    }
    let mut centre = [0_i16; LANES];
    for row in around {
        let v = load(row, x);
        for k in 0..LANES {
            centre[k] += v[k];
        }
    }
    let mut out = [0; LANES];
    for k in 0..LANES {
        out[k] = sum[k] - diff[k] - (2 * centre[k] - total[k]).abs();
    }
    out
}

fn load(row: &[u8], x: usize) -> [i16; LANES] {
    let mut out = [0; LANES];
    if let Some(bytes) = row.get(x..).and_then(<[u8]>::first_chunk::<LANES>) {
        for (o, b) in out.iter_mut().zip(bytes) {
            *o = i16::from(*b);
        }
    }
    out
}

/// Local maxima above a tenth of the greatest response, strongest first, at most `limit`.
pub(super) fn peaks(response: &[i16], width: usize, limit: usize) -> Vec<Peak> {
    // Below this no square edge stands out of the noise of an 8 bit image.
    const FLOOR: i16 = 60;
    const NEAR: usize = 4;
    let height = response.len() / width;
    let greatest = response.iter().copied().max().unwrap_or(0);
    let threshold = FLOOR.max(greatest / 10);
    let mut found = Vec::new();
    for y in RING..height.saturating_sub(RING) {
        let row = &response[y * width..(y + 1) * width];
        for (chunk, values) in row.chunks(32).enumerate() {
            // Most of an image is far below: decide for many pixels at once.
            if values.iter().fold(i16::MIN, |m, &v| m.max(v)) < threshold {
                continue;
            }
            for (k, &v) in values.iter().enumerate() {
                let x = chunk * 32 + k;
                if v >= threshold && is_peak(response, width, height, x, y, NEAR) {
                    found.push(Peak { x, y, response: v });
                }
            }
        }
    }
    found.sort_by(|a, b| {
        b.response
            .cmp(&a.response)
            .then((a.y, a.x).cmp(&(b.y, b.x)))
    });
    found.truncate(limit);
    found
}

/// Greatest of its neighbourhood; of equals the first in reading order.
fn is_peak(r: &[i16], width: usize, height: usize, x: usize, y: usize, near: usize) -> bool {
    let v = r[y * width + x];
    for yy in y.saturating_sub(near)..=(y + near).min(height - 1) {
        let (from, to) = (x.saturating_sub(near), (x + near).min(width - 1));
        for (k, &other) in r[yy * width + from..=yy * width + to].iter().enumerate() {
            let earlier = (yy, from + k) < (y, x);
            if other > v || (other == v && earlier) {
                return false;
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crossing_responds_and_an_edge_does_not() {
        let mut image = GrayImage::filled(60, 40, 0);
        for y in 0..40 {
            for x in 0..60 {
                // A crossing at (20, 20); from x = 40 on only the horizontal edge.
                let bright = (x < 20) == (y < 20) || (x >= 40 && y >= 20);
                image.pixels_mut()[y * 60 + x] = if bright { 200 } else { 30 };
            }
        }
        let r = response(&image);
        let found = peaks(&r, 60, 10);
        assert!(found[0].x.abs_diff(20) <= 1 && found[0].y.abs_diff(20) <= 1);
        assert!(r[20 * 60 + 50] <= 0, "edge");
        assert!(r[10 * 60 + 10] <= 0, "flat");
    }

    #[test]
    fn tiny_images_have_no_response() {
        let image = GrayImage::filled(8, 3, 9);
        assert!(peaks(&response(&image), 8, 10).is_empty());
    }
}
