//! Pictures of tracked pairs.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "pixels: checked against the image's size, which is a few thousand"
)]

use std::fs;
use std::io::Cursor;
use std::path::Path;

use hal::GrayImage;
use image::{ImageFormat, Rgb, RgbImage};
use nalgebra::Vector2;

use super::FileError;
use crate::track::Curve2;

const CURVE: Rgb<u8> = Rgb([255, 0, 0]);
const CONSIDERED: Rgb<u8> = Rgb([60, 120, 255]);
const TIP: Rgb<u8> = Rgb([255, 220, 0]);
/// Reach of the mark around the tip, which stays free itself \[px\].
const MARK: core::ops::RangeInclusive<i32> = 5..=11;

/// Writes images side by side as PNG, the curves in red, a yellow mark around each tip; where there
/// is no curve, what was `considered` in blue.
///
/// # Errors
/// The file cannot be written, or the picture not be coded.
pub fn write_overlay(
    path: &Path,
    images: &[&GrayImage],
    curves: &[Option<Curve2>; 2],
    considered: &[Vec<Vec<Vector2<f64>>>; 2],
) -> Result<(), FileError> {
    let width = images.iter().map(|image| image.width()).sum::<usize>();
    let height = images.iter().map(|image| image.height()).max().unwrap_or(0);
    let mut picture = RgbImage::new(width as u32, height as u32);
    let mut first = 0;
    for ((image, curve), considered) in images.iter().zip(curves).zip(considered) {
        for (y, row) in (0..image.height()).map(|y| (y, image.row(y))) {
            for (x, grey) in row.iter().enumerate() {
                picture.put_pixel((first + x) as u32, y as u32, Rgb([*grey; 3]));
            }
        }
        let mut pen = Pen {
            picture: &mut picture,
            first: first as u32,
            size: (image.width(), image.height()),
        };
        if let Some(curve) = curve {
            pen.curve(curve);
            pen.mark(curve);
        } else {
            for line in considered {
                pen.polygon(line);
            }
        }
        first += image.width();
    }
    let mut bytes = Cursor::new(Vec::new());
    picture
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|source| FileError::Encode {
            path: path.to_owned(),
            source,
        })?;
    fs::write(path, bytes.into_inner()).map_err(|source| FileError::Io {
        path: path.to_owned(),
        source,
    })
}

/// Draws in one image of the two.
struct Pen<'a> {
    picture: &'a mut RgbImage,
    first: u32,
    size: (usize, usize),
}

impl Pen<'_> {
    fn dot(&mut self, at: Vector2<f64>, colour: Rgb<u8>) {
        let (x, y) = (at.x.round(), at.y.round());
        if x >= 0.0 && y >= 0.0 && x < self.size.0 as f64 && y < self.size.1 as f64 {
            self.picture
                .put_pixel(self.first + x as u32, y as u32, colour);
        }
    }

    fn polygon(&mut self, line: &[Vector2<f64>]) {
        for piece in line.windows(2) {
            let step = piece[1] - piece[0];
            let dots = (2.0 * step.norm()).clamp(1.0, 1e4) as u32;
            for dot in 0..=dots {
                let share = f64::from(dot) / f64::from(dots);
                self.dot(piece[0] + step * share, CONSIDERED);
            }
        }
    }

    fn curve(&mut self, curve: &Curve2) {
        let steps = (2.0 * curve.length()).clamp(1.0, 1e5) as u32;
        for step in 0..=steps {
            self.dot(curve.at(f64::from(step) / f64::from(steps)), CURVE);
        }
    }

    /// A cross with a free middle.
    fn mark(&mut self, curve: &Curve2) {
        let tip = curve.tip();
        for reach in MARK.map(f64::from) {
            for (x, y) in [(reach, 0.0), (-reach, 0.0), (0.0, reach), (0.0, -reach)] {
                self.dot(tip + Vector2::new(x, y), TIP);
            }
        }
    }
}
