//! Completing a grid that lacks corners: holes, and lines beyond its border, each looked for where
//! its neighbours put it.

use hal::GrayImage;
use nalgebra::{Point2, Vector2};

use super::BoardSize;
use super::grid::{Cell, Grid};
use super::refine::refine_corner;
use super::saddle::{RADIUS, saddle_at};

/// Fewer corners than this predict nothing.
const LEAST: usize = 6;
/// A corner further than this from its prediction is another one, in parts of the spacing.
const NEAR: f64 = 0.3;
/// Cosine between an edge's ray and the direction to the neighbour: perspective and lens.
const ALONG: f64 = 0.9;

/// Completes a grid that is part of a board of `size`.
pub(super) fn complete(image: &GrayImage, grid: &mut Grid, size: BoardSize) {
    if grid.count() < LEAST || !within(grid.cols, grid.rows, size) {
        return;
    }
    // Each round adds a line or fills a hole: more rounds than lines are not needed.
    for _ in 0..size.cols + size.rows {
        let filled = fill(image, grid);
        let extended = (0..4).any(|side| extend(image, grid, size, side));
        if !filled && !extended {
            return;
        }
    }
}

fn within(cols: usize, rows: usize, size: BoardSize) -> bool {
    (cols <= size.cols && rows <= size.rows) || (cols <= size.rows && rows <= size.cols)
}

/// Looks for the corners missing inside.
fn fill(image: &GrayImage, grid: &mut Grid) -> bool {
    let mut any = false;
    for row in 0..grid.rows {
        for col in 0..grid.cols {
            if grid.at(col, row).is_none()
                && let Some(cell) = look(image, grid, col.cast_signed(), row.cast_signed())
            {
                grid.cells[row * grid.cols + col] = Some(cell);
                any = true;
            }
        }
    }
    any
}

/// Looks for the line beyond one side; kept if at least half of it is there.
fn extend(image: &GrayImage, grid: &mut Grid, size: BoardSize, side: usize) -> bool {
    let (cols, rows) = (grid.cols, grid.rows);
    let (more_cols, more_rows) = if side < 2 {
        (cols + 1, rows)
    } else {
        (cols, rows + 1)
    };
    if !within(more_cols, more_rows, size) {
        return false;
    }
    let along = if side < 2 { rows } else { cols }.cast_signed();
    let place = |k: isize| match side {
        0 => (-1, k),
        1 => (cols.cast_signed(), k),
        2 => (k, -1),
        _ => (k, rows.cast_signed()),
    };
    let line: Vec<Option<Cell>> = (0..along)
        .map(|k| {
            let (col, row) = place(k);
            look(image, grid, col, row)
        })
        .collect();
    if 2 * line.iter().flatten().count() < line.len() {
        return false;
    }
    let (shift_col, shift_row) = (usize::from(side == 0), usize::from(side == 2));
    let mut cells = vec![None; more_cols * more_rows];
    for row in 0..rows {
        for col in 0..cols {
            cells[(row + shift_row) * more_cols + col + shift_col] = grid.cells[row * cols + col];
        }
    }
    for (k, cell) in line.into_iter().enumerate() {
        let (col, row) = match side {
            0 => (0, k),
            1 => (cols, k),
            2 => (k, 0),
            _ => (k, rows),
        };
        cells[row * more_cols + col] = cell;
    }
    *grid = Grid {
        cols: more_cols,
        rows: more_rows,
        cells,
    };
    true
}

/// A crossing where the neighbours put it, of the colours they ask for.
fn look(image: &GrayImage, grid: &Grid, col: isize, row: isize) -> Option<Cell> {
    let get = |dc: isize, dr: isize| {
        let c = usize::try_from(col + dc).ok().filter(|&c| c < grid.cols)?;
        let r = usize::try_from(row + dr).ok().filter(|&r| r < grid.rows)?;
        grid.at(c, r)
    };
    let mut guesses: Vec<Point2<f64>> = Vec::new();
    let mut spacing = f64::INFINITY;
    for (dc, dr) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
        if let (Some(a), Some(b)) = (get(dc, dr), get(2 * dc, 2 * dr)) {
            let step = a.at - b.at;
            spacing = spacing.min(step.norm());
            // With a third, the change of the step goes on.
            let bend = get(3 * dc, 3 * dr).map_or_else(Vector2::zeros, |c| step - (b.at - c.at));
            guesses.push(a.at + step + bend);
        }
    }
    for (dc, dr) in [(1, 1), (1, -1), (-1, 1), (-1, -1)] {
        if let (Some(a), Some(b), Some(c)) = (get(dc, 0), get(0, dr), get(dc, dr)) {
            spacing = spacing.min((c.at - a.at).norm()).min((c.at - b.at).norm());
            guesses.push(a.at + (b.at - c.at));
        }
    }
    let dark = [(1, 0), (0, 1), (-1, 0), (0, -1)]
        .into_iter()
        .find_map(|(dc, dr)| get(dc, dr))
        .map(|c| !c.dark)?;
    if guesses.is_empty() {
        return None;
    }
    let mean = guesses.iter().fold(Vector2::zeros(), |s, g| s + g.coords) / guesses.len() as f64;
    let start = Point2::from(mean);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a few pixels"
    )]
    let half = (spacing / 3.0).clamp(2.0, RADIUS) as usize;
    let at = refine_corner(image, start, half, 20)?;
    if (at - start).norm() > NEAR * spacing {
        return None;
    }
    let (w, h) = (image.width() as f64, image.height() as f64);
    let border = at.x.min(at.y).min(w - at.x).min(h - at.y) - 2.0;
    let radius = RADIUS.min(0.4 * spacing).min(border);
    let saddle = saddle_at(image, at, radius.max(2.0))?;
    // Towards growing column, or growing row, seen from a neighbour's directions.
    let towards = |dc: isize, dr: isize| {
        get(dc, dr)
            .map(|c| c.at - at)
            .or_else(|| get(-dc, -dr).map(|c| at - c.at))
    };
    let (found, cos) = match (towards(1, 0), towards(0, 1)) {
        (Some(along), _) => {
            let (k, cos) = saddle.ray_towards(&along.normalize());
            (saddle.dark_after(k), cos)
        }
        (None, Some(down)) => {
            let (k, cos) = saddle.ray_towards(&down.normalize());
            (!saddle.dark_after(k), cos)
        }
        (None, None) => return None,
    };
    (cos > ALONG && found == dark).then_some(Cell { at, dark })
}
