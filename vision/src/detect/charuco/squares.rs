//! A board's white squares: where they are, and their markers painted over, so that a corner is
//! refined as on a plain chessboard.

use hal::GrayImage;
use nalgebra::{Matrix3, Point2, Vector2};

use super::super::grid::{Cell, Grid};
use super::super::saddle::bilinear;
use crate::homography::{homography, map};

/// The grid with one more line on each side, and what is missing beside its corners, where its
/// lines lead: squares at the board's edge and at the image's have markers too.
pub(super) fn widened(grid: &Grid) -> Grid {
    let (cols, rows) = (grid.cols + 2, grid.rows + 2);
    let mut cells = vec![None; cols * rows];
    for row in 0..grid.rows {
        for col in 0..grid.cols {
            cells[(row + 1) * cols + col + 1] = grid.at(col, row).copied();
        }
    }
    let mut wider = Grid { cols, rows, cells };
    let known = wider.clone();
    let missing = |k: &usize| known.cells[*k].is_none();
    for k in (0..cols * rows).filter(missing) {
        wider.cells[k] = led_to(&known, k % cols, k / cols);
    }
    // Across the corner of a corner both its neighbours were led to.
    let led = wider.clone();
    for k in (0..cols * rows).filter(missing) {
        wider.cells[k] = wider.cells[k].or_else(|| across(&known, &led, k % cols, k / cols));
    }
    wider
}

/// The fourth corner of a square of which one is known and two were led to.
fn across(known: &Grid, led: &Grid, col: usize, row: usize) -> Option<Cell> {
    [(1, 1), (-1, 1), (1, -1), (-1, -1)]
        .into_iter()
        .find_map(|(dc, dr)| {
            let c = col.checked_add_signed(dc).filter(|&c| c < led.cols)?;
            let r = row.checked_add_signed(dr).filter(|&r| r < led.rows)?;
            let (first, a, b) = (known.at(c, r)?, led.at(c, row)?, led.at(col, r)?);
            Some(Cell {
                at: a.at + (b.at - first.at),
                dark: first.dark,
            })
        })
}

/// Where the lines of a grid lead at a place that it does not hold.
fn led_to(grid: &Grid, col: usize, row: usize) -> Option<Cell> {
    let (mut sum, mut count, mut dark) = (Vector2::zeros(), 0.0, None);
    for (dc, dr) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
        let get = |steps: isize| {
            let c = col
                .checked_add_signed(dc * steps)
                .filter(|&c| c < grid.cols)?;
            let r = row
                .checked_add_signed(dr * steps)
                .filter(|&r| r < grid.rows)?;
            grid.at(c, r).copied()
        };
        if let (Some(a), Some(b)) = (get(1), get(2)) {
            let step = a.at - b.at;
            // With a third, the change of the step goes on.
            let bend = get(3).map_or_else(Vector2::zeros, |c| step - (b.at - c.at));
            sum += a.at.coords + step + bend;
            count += 1.0;
            dark = Some(!a.dark);
        }
    }
    Some(Cell {
        at: Point2::from(sum / count),
        dark: dark?,
    })
}

/// The white squares of a grid, each with the map of its unit square into the image.
pub(super) fn white_squares(grid: &Grid) -> impl Iterator<Item = ((i32, i32), Matrix3<f64>)> {
    let unit = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(x, y)| Point2::new(x, y));
    let all = (0..grid.rows.saturating_sub(1))
        .flat_map(|r| (0..grid.cols.saturating_sub(1)).map(move |c| (c, r)));
    all.filter_map(move |(c, r)| {
        let first = grid.at(c, r)?;
        let corners = [
            first.at,
            grid.at(c + 1, r)?.at,
            grid.at(c + 1, r + 1)?.at,
            grid.at(c, r + 1)?.at,
        ];
        let place = (i32::try_from(c).ok()?, i32::try_from(r).ok()?);
        (!first.dark).then(|| Some((place, homography(&unit, &corners)?)))?
    })
}

/// Part of the white around a marker that is painted with it.
const MARGIN: f64 = 0.4;

/// Paints the middle of every square white: the marker of `ratio` of its side, and some of the
/// white around it. Each square is the map of the unit square into the image.
pub(super) fn painted(
    image: &GrayImage,
    squares: impl Iterator<Item = Matrix3<f64>>,
    ratio: f64,
) -> GrayImage {
    let mut out = image.clone();
    let reach = f64::midpoint(ratio, MARGIN * (1.0 - ratio));
    for to_image in squares {
        let Some(back) = to_image.try_inverse() else {
            continue;
        };
        // The white half way between marker and edge; in a narrow square an edge dims it.
        let beside = (1.0 - ratio) / 4.0;
        let places = [
            (beside, 0.5),
            (1.0 - beside, 0.5),
            (0.5, beside),
            (0.5, 1.0 - beside),
        ];
        let white = places
            .into_iter()
            .map(|(u, v)| map(&to_image, &Point2::new(u, v)))
            .filter(|p| inside(image, p))
            .map(|p| bilinear(image, p.x, p.y))
            .max_by(f64::total_cmp);
        let Some(white) = white else { continue };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "between bytes"
        )]
        let white = white as u8;
        let edge = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(u, v)| map(&to_image, &Point2::new(0.5 + reach * u, 0.5 + reach * v)));
        let low = edge.iter().fold(edge[0], |m, p| m.inf(p));
        let high = edge.iter().fold(edge[0], |m, p| m.sup(p));
        let width = image.width();
        for y in pixels(low.y, high.y, image.height()) {
            for x in pixels(low.x, high.x, width) {
                let at = map(&back, &Point2::new(x as f64, y as f64));
                if (at.x - 0.5).abs() <= reach && (at.y - 0.5).abs() <= reach {
                    out.pixels_mut()[y * width + x] = white;
                }
            }
        }
    }
    out
}

fn inside(image: &GrayImage, p: &Point2<f64>) -> bool {
    let (w, h) = (image.width() as f64, image.height() as f64);
    p.x >= 0.0 && p.y >= 0.0 && p.x < w - 1.0 && p.y < h - 1.0
}

/// The pixels between two places, within `0..count`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the image"
)]
fn pixels(low: f64, high: f64, count: usize) -> core::ops::Range<usize> {
    let clamped = |v: f64| v.clamp(0.0, count as f64) as usize;
    clamped(low.ceil())..clamped(high.floor() + 1.0)
}
