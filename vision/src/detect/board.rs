//! From an image to the labelled corners of a board.

use hal::GrayImage;
use nalgebra::Point2;

use super::BoardSize;
use super::grid::{Cell, Grid, grids};
use super::refine::{RefineOptions, refine_corner};
use super::regular::irregular_corner;
use super::response::{peaks, response};
use super::saddle::saddle_at;

/// The corners of one board in one image.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardCorners {
    /// The board's size.
    pub size: BoardSize,
    /// Corners, row-major \[px\]. The first row begins with a dark square to its right and
    /// below; columns to rows turn from x to y of the image.
    pub corners: Vec<Point2<f64>>,
    /// Whether the colours say which end is which; else the first corner is the one nearest to
    /// the image's top left.
    pub unique_orientation: bool,
}

/// Why an image has no board.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BoardNotFound {
    /// A board of this size cannot be detected.
    #[error("a board needs at least 3 x 3 inner corners, not {cols} x {rows}")]
    TooSmall {
        /// Corners along a row.
        cols: usize,
        /// Corners along a column.
        rows: usize,
    },
    /// No chessboard at all.
    #[error("no chessboard in the image ({crossings} isolated crossings)")]
    Nothing {
        /// Crossings found.
        crossings: usize,
    },
    /// A chessboard of another size, or one that is not wholly visible.
    #[error(
        "expected a board of {expected_cols} x {expected_rows} inner corners, found {found} \
         corners in a grid of {cols} x {rows}"
    )]
    WrongSize {
        /// Expected corners along a row.
        expected_cols: usize,
        /// Expected corners along a column.
        expected_rows: usize,
        /// Corners found.
        found: usize,
        /// Columns of the found grid.
        cols: usize,
        /// Rows of the found grid.
        rows: usize,
    },
    /// More than one board of this size.
    #[error("{boards} boards of the expected size in one image")]
    Several {
        /// Number of boards.
        boards: usize,
    },
    /// A corner is not where the others say.
    #[error(
        "corner {corner} lies {distance_px:.2} px from where the other corners put it \
         (their sigma {sigma_px:.2} px)"
    )]
    FalseCorner {
        /// Index of the corner, row-major.
        corner: usize,
        /// Distance from where it should be.
        distance_px: f64,
        /// Robust standard deviation of the others.
        sigma_px: f64,
    },
    /// A corner could not be refined.
    #[error("corner {corner} near ({x_px:.1}, {y_px:.1}) is no clear crossing")]
    Unclear {
        /// Index of the corner, row-major.
        corner: usize,
        /// Column.
        x_px: f64,
        /// Row.
        y_px: f64,
    },
}

/// A corner further than this from where the others put it is false, once refined \[px\].
const FALSE_PX: f64 = 0.75;
/// The same before refinement, when corners are whole pixels of a reduced image.
const FALSE_COARSE_PX: f64 = 3.0;
/// Images wider than this are first searched at half their size \[px\].
const WIDE: usize = 900;
/// Crossings considered in an image.
const LIMIT: usize = 600;

/// Finds, refines and checks a board.
///
/// # Errors
/// See [`BoardNotFound`].
pub fn detect_board(
    image: &GrayImage,
    size: BoardSize,
    options: &RefineOptions,
) -> Result<BoardCorners, BoardNotFound> {
    let mut board = find_board(image, size)?;
    refine_board(image, &mut board, options)?;
    Ok(board)
}

/// Finds a board and labels its corners to about a pixel.
///
/// # Errors
/// See [`BoardNotFound`].
pub fn find_board(image: &GrayImage, size: BoardSize) -> Result<BoardCorners, BoardNotFound> {
    if size.cols < 3 || size.rows < 3 {
        return Err(BoardNotFound::TooSmall {
            cols: size.cols,
            rows: size.rows,
        });
    }
    if image.width() > WIDE {
        let half = halved(image);
        if let Ok(mut board) = find_board(&half, size) {
            for corner in &mut board.corners {
                // The centre of the half-size pixel k is between pixels 2k and 2k + 1.
                *corner = Point2::new(2.0 * corner.x + 0.5, 2.0 * corner.y + 0.5);
            }
            return Ok(board);
        }
    }
    let map = response(image);
    let saddles: Vec<_> = peaks(&map, image.width(), LIMIT)
        .iter()
        .filter_map(|p| saddle_at(image, Point2::new(p.x as f64, p.y as f64)))
        .collect();
    let mut found = grids(&saddles);
    for grid in &mut found {
        grid.strip(size.cols.max(size.rows), size.cols.min(size.rows));
        complete(image, grid, size);
    }
    let fits = |g: &&Grid| {
        g.count() == size.count()
            && ((g.cols, g.rows) == (size.cols, size.rows)
                || (g.rows, g.cols) == (size.cols, size.rows))
    };
    let whole: Vec<_> = found.iter().filter(fits).collect();
    match whole.as_slice() {
        [one] => {
            let board = oriented(one, size);
            check(&board, FALSE_COARSE_PX)?;
            Ok(board)
        }
        [] => Err(found.first().map_or(
            BoardNotFound::Nothing {
                crossings: saddles.len(),
            },
            |g| BoardNotFound::WrongSize {
                expected_cols: size.cols,
                expected_rows: size.rows,
                found: g.count(),
                cols: g.cols,
                rows: g.rows,
            },
        )),
        several => Err(BoardNotFound::Several {
            boards: several.len(),
        }),
    }
}

/// Refines the corners of a found board and checks them against each other.
///
/// # Errors
/// A corner is no clear crossing, or not where the others say.
pub fn refine_board(
    image: &GrayImage,
    board: &mut BoardCorners,
    options: &RefineOptions,
) -> Result<(), BoardNotFound> {
    let start = board.corners.clone();
    for (k, (col, row)) in board.size.indices().enumerate() {
        let spacing = spacing(&start, board.size, col, row);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a quarter of a distance within the image"
        )]
        let quarter = (spacing / 4.0) as usize;
        let half = quarter.min(options.max_half_width);
        board.corners[k] = refine_corner(image, start[k], half, options.max_iterations).ok_or(
            BoardNotFound::Unclear {
                corner: k,
                x_px: start[k].x,
                y_px: start[k].y,
            },
        )?;
    }
    check(board, FALSE_PX)
}

fn check(board: &BoardCorners, limit_px: f64) -> Result<(), BoardNotFound> {
    match irregular_corner(&board.corners, board.size, limit_px) {
        None => Ok(()),
        Some(i) => Err(BoardNotFound::FalseCorner {
            corner: i.corner,
            distance_px: i.distance_px,
            sigma_px: i.sigma_px,
        }),
    }
}

/// Distance to the nearest neighbour along row and column.
fn spacing(corners: &[Point2<f64>], size: BoardSize, col: usize, row: usize) -> f64 {
    let k = row * size.cols + col;
    let mut least = f64::INFINITY;
    for (inside, j) in [
        (col > 0, k.wrapping_sub(1)),
        (col + 1 < size.cols, k + 1),
        (row > 0, k.wrapping_sub(size.cols)),
        (row + 1 < size.rows, k + size.cols),
    ] {
        if inside {
            least = least.min((corners[k] - corners[j]).norm());
        }
    }
    least
}

/// Looks again where a grid that is nearly the board lacks a corner.
fn complete(image: &GrayImage, grid: &mut Grid, size: BoardSize) {
    let within = grid.cols.max(grid.rows) <= size.cols.max(size.rows)
        && grid.cols.min(grid.rows) <= size.cols.min(size.rows);
    if !within || 3 * grid.count() < 2 * size.count() {
        return;
    }
    for _ in 0..2 {
        for row in 0..grid.rows {
            for col in 0..grid.cols {
                if grid.at(col, row).is_none()
                    && let Some(cell) = look(image, grid, col, row)
                {
                    grid.cells[row * grid.cols + col] = Some(cell);
                }
            }
        }
    }
}

/// A crossing where the neighbours put it, of the colours they ask for.
fn look(image: &GrayImage, grid: &Grid, col: usize, row: usize) -> Option<Cell> {
    let get = |dc: isize, dr: isize| {
        let c = col.checked_add_signed(dc).filter(|&c| c < grid.cols)?;
        let r = row.checked_add_signed(dr).filter(|&r| r < grid.rows)?;
        grid.at(c, r)
    };
    let mut guesses = Vec::new();
    for (dc, dr) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
        if let (Some(a), Some(b)) = (get(dc, dr), get(2 * dc, 2 * dr)) {
            guesses.push((a.at + (a.at - b.at), !a.dark, (a.at - b.at).norm()));
        }
    }
    let &(_, dark, spacing) = guesses.first()?;
    let mean = guesses
        .iter()
        .fold(nalgebra::Vector2::zeros(), |s, g| s + g.0.coords)
        / guesses.len() as f64;
    let start = Point2::from(mean);
    let at = refine_corner(image, start, 5, 20)?;
    let saddle = saddle_at(image, at)?;
    // Towards growing column and row, seen from a neighbour's directions.
    let along = get(1, 0)
        .map(|c| c.at - at)
        .or_else(|| get(-1, 0).map(|c| at - c.at))?;
    let (k, cos) = saddle.ray_towards(&along.normalize());
    let right = cos > 0.9 && saddle.dark_after(k) == dark && (at - start).norm() < 0.25 * spacing;
    right.then_some(Cell { at, dark })
}

/// Turns the labels so that the first square is dark.
fn oriented(grid: &Grid, size: BoardSize) -> BoardCorners {
    let mut best: Option<(bool, f64, Grid)> = None;
    let mut turned = grid.clone();
    for _ in 0..4 {
        if (turned.cols, turned.rows) == (size.cols, size.rows)
            && let Some(first) = turned.at(0, 0)
        {
            let (bright, order) = (!first.dark, first.at.x + first.at.y);
            let better = best
                .as_ref()
                .is_none_or(|(b, o, _)| (bright, order) < (*b, *o));
            if better {
                best = Some((bright, order, turned.clone()));
            }
        }
        turned = turned.turned();
    }
    let grid = best.map_or(turned, |(_, _, g)| g);
    BoardCorners {
        size,
        corners: grid.cells.iter().flatten().map(|c| c.at).collect(),
        unique_orientation: size.has_unique_orientation(),
    }
}

/// Means of two by two pixels.
fn halved(image: &GrayImage) -> GrayImage {
    let (w, h) = (image.width() / 2, image.height() / 2);
    let mut half = GrayImage::filled(w, h, 0);
    for (y, line) in half.pixels_mut().chunks_exact_mut(w).enumerate() {
        let (a, b) = (image.row(2 * y), image.row(2 * y + 1));
        for (x, v) in line.iter_mut().enumerate() {
            let sum = u16::from(a[2 * x])
                + u16::from(a[2 * x + 1])
                + u16::from(b[2 * x])
                + u16::from(b[2 * x + 1]);
            #[expect(clippy::cast_possible_truncation, reason = "a mean of four bytes")]
            {
                *v = ((sum + 2) / 4) as u8;
            }
        }
    }
    half
}
