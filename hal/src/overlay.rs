//! The left image with what was tracked in it.

use crate::CameraFrame;

const CURVE: [u8; 3] = [0, 230, 60];
const TARGET: [u8; 3] = [255, 30, 30];
/// Half the length of the target's cross \[px\].
const CROSS: f64 = 8.0;

/// An image and what to draw into it; pixel centres are integers.
#[derive(Clone, Debug)]
pub struct Overlay {
    /// The image.
    pub image: CameraFrame,
    /// The tracked curve \[px\].
    pub curve_px: Vec<[f64; 2]>,
    /// Where the target is seen \[px\].
    pub target_px: Option<[f64; 2]>,
}

impl Overlay {
    /// The image in colour with all of it drawn in, row-major, red, green and blue a pixel; what lies
    /// outside the image is left out.
    pub fn draw(&self) -> Vec<u8> {
        let (width, height) = (self.image.image.width(), self.image.image.height());
        let mut canvas = Canvas {
            width,
            height,
            rgb: self
                .image
                .image
                .pixels()
                .iter()
                .flat_map(|&grey| [grey; 3])
                .collect(),
        };
        for ends in self.curve_px.windows(2) {
            canvas.line(ends[0], ends[1], CURVE);
        }
        if let Some([x, y]) = self.target_px {
            canvas.line([x - CROSS, y], [x + CROSS, y], TARGET);
            canvas.line([x, y - CROSS], [x, y + CROSS], TARGET);
        }
        canvas.rgb
    }
}

struct Canvas {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Canvas {
    fn line(&mut self, [x0, y0]: [f64; 2], [x1, y1]: [f64; 2], colour: [u8; 3]) {
        let steps = (x1 - x0).abs().max((y1 - y0).abs()).ceil();
        // Neither infinite nor longer than any image's diagonal.
        let limit = 2.0 * (self.width + self.height) as f64;
        if !(x0 + y0).is_finite() || !(0.0..=limit).contains(&steps) {
            return;
        }
        let steps = steps.max(1.0);
        let mut i = 0.0;
        while i <= steps {
            let t = i / steps;
            self.dot(x0 + t * (x1 - x0), y0 + t * (y1 - y0), colour);
            i += 1.0;
        }
    }

    /// Three pixels wide, so that a viewer that shrinks the image keeps it.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "checked to lie inside the image"
    )]
    fn dot(&mut self, x: f64, y: f64, colour: [u8; 3]) {
        for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
            let (x, y) = (x.round() + f64::from(dx), y.round() + f64::from(dy));
            if x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64 {
                let at = 3 * (y as usize * self.width + x as usize);
                if let Some(pixel) = self.rgb.get_mut(at..at + 3) {
                    pixel.copy_from_slice(&colour);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{GrayImage, Stamp};

    #[test]
    fn draws_inside_and_leaves_out_what_is_not() {
        let image = CameraFrame {
            stamp: Stamp::ZERO,
            sequence: 3,
            image: GrayImage::filled(20, 10, 7).into(),
        };
        let curve_px = vec![[2.0, 4.0], [6.0, 4.0], [900.0, 4.0], [f64::NAN, 1.0]];
        let overlay = Overlay {
            image,
            curve_px,
            target_px: Some([15.0, 5.0]),
        };
        let drawn = overlay.draw();
        let pixel = |x: usize, y: usize| &drawn[3 * (20 * y + x)..][..3];
        assert_eq!(drawn.len(), 600);
        assert_eq!(pixel(2, 4), CURVE);
        assert_eq!(pixel(4, 5), CURVE, "three pixels wide");
        assert_eq!(pixel(15, 9), TARGET);
        assert_eq!(pixel(0, 0), [7; 3]);
        assert_eq!(pixel(8, 3), [7; 3]);
    }
}
