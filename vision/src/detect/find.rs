//! The search for a board: several scales of an image, each sharp or smoothed, until one shows
//! the whole board.

use hal::GrayImage;
use nalgebra::Point2;

use super::BoardSize;
use super::board::{BoardCorners, BoardNotFound, check};
use super::complete::complete;
use super::grid::{Grid, grids};
use super::pattern::is_chessboard;
use super::refine::refine_corner;
use super::response::{peaks, response};
use super::saddle::{RADIUS, Saddle, saddle_at};
use super::scale::{Scaled, doubled, halved, smoothed};

/// A corner further than this from where the others put it is false, before the last refinement
/// \[px\].
const FALSE_COARSE_PX: f64 = 3.0;
/// Images wider than this are first searched at a reduced size \[px\].
const WIDE: usize = 900;
/// Images narrower than this show no board that a further reduction would make clearer \[px\].
const NARROW: usize = 200;
/// Crossings considered in an image: a board has about fifty, and texture makes some.
const LIMIT: usize = 600;

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
    // The scale at which squares have some ten pixels comes first, then coarser ones, which
    // bridge gaps and blur, then finer ones for small squares.
    let mut pyramid = vec![Scaled::whole(image)];
    while let Some(last) = pyramid.last()
        && last.image.width() >= NARROW
        && last.image.height() >= NARROW / 2
    {
        let next = halved(last);
        pyramid.push(next);
    }
    let first = pyramid
        .iter()
        .position(|s| s.image.width() <= WIDE)
        .unwrap_or(0);
    let mut problem = None;
    let mut note = |e: BoardNotFound| {
        let better = problem
            .as_ref()
            .is_none_or(|p| corners_in(&e) > corners_in(p));
        if better {
            problem = Some(e);
        }
    };
    let coarser = (first..pyramid.len()).map(|k| (k, false));
    let soft = (first..pyramid.len().min(first + 2)).map(|k| (k, true));
    let finer = (0..first).rev().map(|k| (k, false));
    for (level, smooth) in coarser.take(2).chain(soft).chain(finer) {
        let scaled = &pyramid[level];
        let tried = if smooth {
            search(&smoothed(scaled), size)
        } else {
            search(scaled, size)
        };
        match tried {
            Ok(board) => return Ok(board),
            Err(e @ BoardNotFound::Several { .. }) => return Err(e),
            Err(e) => note(e),
        }
    }
    for scaled in [first == 0, first + 2 < pyramid.len()]
        .into_iter()
        .zip([0, first + 2])
        .filter_map(|(wanted, k)| wanted.then(|| pyramid.get(k)).flatten())
    {
        let scaled = if scaled.steps == 0 {
            doubled(scaled)
        } else {
            scaled.clone()
        };
        match search(&scaled, size) {
            Ok(board) => return Ok(board),
            Err(e) => note(e),
        }
    }
    Err(problem.unwrap_or(BoardNotFound::Nothing { crossings: 0 }))
}

/// How much of a board an attempt saw.
fn corners_in(e: &BoardNotFound) -> usize {
    match e {
        BoardNotFound::WrongSize { found, .. } => *found,
        BoardNotFound::FalseCorner { .. } | BoardNotFound::Unclear { .. } => usize::MAX,
        _ => 0,
    }
}

/// Looks for the board at one scale; the corners are the whole image's.
fn search(scaled: &Scaled, size: BoardSize) -> Result<BoardCorners, BoardNotFound> {
    let image = &scaled.image;
    let map = response(image);
    let saddles: Vec<Saddle> = peaks(&map, image.width(), LIMIT)
        .iter()
        .filter_map(|p| saddle_at(image, Point2::new(p.x as f64, p.y as f64), RADIUS))
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
            && is_chessboard(image, g)
    };
    let mut whole: Vec<&Grid> = Vec::new();
    for grid in found.iter().filter(fits) {
        // Two parts of one board may both have grown to the whole.
        let again = |other: &&Grid| (grid.centre() - other.centre()).norm() < grid.spacing();
        if !whole.iter().any(again) {
            whole.push(grid);
        }
    }
    match whole.as_slice() {
        [one] => {
            let mut board = oriented(one, size);
            for corner in &mut board.corners {
                if let Some(better) = refine_corner(image, *corner, 4, 20) {
                    *corner = better;
                }
            }
            check(&board, FALSE_COARSE_PX)?;
            for corner in &mut board.corners {
                *corner = scaled.in_whole(corner);
            }
            Ok(board)
        }
        [] => Err(found.iter().max_by_key(|g| g.count()).map_or(
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
