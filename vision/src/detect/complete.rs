//! Completing a grid that lacks corners: holes, and lines beyond its border, each looked for where
//! its neighbours put it.

use hal::GrayImage;
use nalgebra::{Point2, Vector2};

use super::BoardSize;
use super::grid::{Cell, Grid};
use super::refine::refine_corner;
use super::saddle::{BORDER, RADIUS, Saddle, saddle_at};

/// Fewer corners than this predict nothing.
const LEAST: usize = 6;
/// A corner further than this from its prediction is another one, in parts of the spacing.
const NEAR: f64 = 0.3;
/// Cosine between an edge's ray and the direction to the neighbour: perspective and lens.
const ALONG: f64 = 0.9;

/// How a corner is looked for.
struct Look {
    /// Half widths of the windows, by the spacing \[px\]: of large squares a guess misses by more
    /// than a small window holds.
    windows: &'static [fn(f64) -> f64],
    /// Whether a corner counts whose ring the image's border cuts.
    cut: bool,
}

/// Within a board of known size.
const EAGER: Look = Look {
    windows: &[small, |spacing| spacing / 6.0],
    cut: true,
};
/// Where nothing says that there is a corner.
const STRICT: Look = Look {
    windows: &[small],
    cut: false,
};
/// A corner cut by the border lies this near to its prediction, in parts of the spacing.
const CUT_NEAR: f64 = 0.06;

fn small(spacing: f64) -> f64 {
    (spacing / 3.0).clamp(2.0, RADIUS)
}

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
                && let Some(cell) = look(image, grid, col.cast_signed(), row.cast_signed(), &EAGER)
            {
                grid.cells[row * grid.cols + col] = Some(cell);
                any = true;
            }
        }
    }
    any
}

/// The columns and rows of the board where it goes on beyond a whole grid: at least half of a line
/// is there.
pub(super) fn goes_on(image: &GrayImage, grid: &Grid) -> Option<(usize, usize)> {
    let side = (0..4).find(|&side| half_there(&beyond(image, grid, side, &STRICT)))?;
    Some(longer(grid, side))
}

/// Columns and rows with the line beyond one side.
fn longer(grid: &Grid, side: usize) -> (usize, usize) {
    if side < 2 {
        (grid.cols + 1, grid.rows)
    } else {
        (grid.cols, grid.rows + 1)
    }
}

fn half_there(line: &[Option<Cell>]) -> bool {
    2 * line.iter().flatten().count() >= line.len()
}

/// Looks for the line beyond one side.
fn beyond(image: &GrayImage, grid: &Grid, side: usize, how: &Look) -> Vec<Option<Cell>> {
    let (cols, rows) = (grid.cols, grid.rows);
    let along = if side < 2 { rows } else { cols }.cast_signed();
    let place = |k: isize| match side {
        0 => (-1, k),
        1 => (cols.cast_signed(), k),
        2 => (k, -1),
        _ => (k, rows.cast_signed()),
    };
    (0..along)
        .map(|k| {
            let (col, row) = place(k);
            look(image, grid, col, row, how)
        })
        .collect()
}

/// Looks for the line beyond one side; kept if at least half of it is there.
fn extend(image: &GrayImage, grid: &mut Grid, size: BoardSize, side: usize) -> bool {
    let (cols, rows) = (grid.cols, grid.rows);
    let (more_cols, more_rows) = longer(grid, side);
    if !within(more_cols, more_rows, size) {
        return false;
    }
    let line = beyond(image, grid, side, &EAGER);
    if !half_there(&line) {
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
fn look(image: &GrayImage, grid: &Grid, col: isize, row: isize, how: &Look) -> Option<Cell> {
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
    let crossing = how.windows.iter().find_map(|half| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a part of a distance within the image"
        )]
        let at = refine_corner(image, start, half(spacing) as usize, 20)?;
        let miss = (at - start).norm() / spacing;
        let saddle = crossing_at(image, at, spacing);
        let cut = how.cut && miss < CUT_NEAR && border(image, &at) < RADIUS + BORDER;
        (miss <= NEAR && (saddle.is_some() || cut)).then_some((at, saddle))
    });
    let (at, saddle) = crossing?;
    let Some(saddle) = saddle else {
        return Some(Cell { at, dark });
    };
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

/// The crossing at a place, read on a ring within its squares and the image.
fn crossing_at(image: &GrayImage, at: Point2<f64>, spacing: f64) -> Option<Saddle> {
    // A little less than to the border, as the ring must lie within.
    let room = 0.98 * (border(image, &at) - BORDER);
    let radius = RADIUS.min(0.4 * spacing).min(room);
    saddle_at(image, at, radius.max(2.0))
}

/// Distance to the image's border \[px\].
fn border(image: &GrayImage, at: &Point2<f64>) -> f64 {
    let (w, h) = (image.width() as f64, image.height() as f64);
    at.x.min(at.y).min(w - at.x).min(h - at.y)
}
