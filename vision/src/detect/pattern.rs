//! Whether the squares between labelled corners alternate.

use hal::GrayImage;
use nalgebra::{Point2, Vector2};

use super::grid::Grid;
use super::saddle::bilinear;

/// Share of the neighbouring squares that must differ the right way.
const ALTERNATING: f64 = 0.95;
/// Grey levels by which neighbouring squares differ at least: two sigma of a poor camera's noise
/// in the mean of five samples.
const CONTRAST: f64 = 4.0;
/// Samples of a square, from its centre in parts of its half diagonals.
const SAMPLES: [(f64, f64); 5] = [(0.0, 0.0), (0.4, 0.0), (0.0, 0.4), (-0.4, 0.0), (0.0, -0.4)];

/// Whether dark and bright squares alternate between the corners of a whole grid.
pub(super) fn is_chessboard(image: &GrayImage, grid: &Grid) -> bool {
    let (cols, rows) = (grid.cols - 1, grid.rows - 1);
    let mut greys = Vec::with_capacity(cols * rows);
    for row in 0..rows {
        for col in 0..cols {
            let Some(grey) = square(image, grid, col, row) else {
                return false;
            };
            greys.push(grey);
        }
    }
    let (mut right, mut all) = (0_u32, 0_u32);
    let mut compare = |a: usize, b: usize, dark: bool| {
        let step = if dark {
            greys[b] - greys[a]
        } else {
            greys[a] - greys[b]
        };
        all += 1;
        right += u32::from(step > CONTRAST);
    };
    for row in 0..rows {
        for col in 0..cols {
            let Some(cell) = grid.at(col, row) else {
                return false;
            };
            let k = row * cols + col;
            if col + 1 < cols {
                compare(k, k + 1, cell.dark);
            }
            if row + 1 < rows {
                compare(k, k + cols, cell.dark);
            }
        }
    }
    f64::from(right) >= ALTERNATING * f64::from(all)
}

/// Mean grey of the square that begins at a corner.
fn square(image: &GrayImage, grid: &Grid, col: usize, row: usize) -> Option<f64> {
    let corner = |c: usize, r: usize| grid.at(c, r).map(|cell| cell.at.coords);
    let (a, b) = (corner(col, row)?, corner(col + 1, row)?);
    let (c, d) = (corner(col + 1, row + 1)?, corner(col, row + 1)?);
    let centre = (a + b + c + d) / 4.0;
    let (one, other): (Vector2<f64>, Vector2<f64>) = ((c - a) / 2.0, (d - b) / 2.0);
    let (w, h) = (image.width() as f64, image.height() as f64);
    let mut sum = 0.0;
    for (s, t) in SAMPLES {
        let p = Point2::from(centre + one * s + other * t);
        if !(p.x >= 0.0 && p.y >= 0.0 && p.x < w - 1.0 && p.y < h - 1.0) {
            return None;
        }
        sum += bilinear(image, p.x, p.y);
    }
    Some(sum / SAMPLES.len() as f64)
}
