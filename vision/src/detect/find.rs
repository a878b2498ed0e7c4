//! The search for a board: several scales of an image, each sharp or smoothed, until one shows
//! the whole board.

use hal::GrayImage;
use nalgebra::Point2;

use super::BoardSize;
use super::board::{BoardCorners, BoardNotFound, check};
use super::complete::{complete, goes_on};
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
pub(super) const LIMIT: usize = 600;

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
    let mut problem = None;
    for scaled in levels(image) {
        match search(&scaled, image, size) {
            Ok(board) => return Ok(board),
            Err(e @ BoardNotFound::Several { .. }) => return Err(e),
            Err(e) => {
                let better = problem
                    .as_ref()
                    .is_none_or(|p| corners_in(&e) > corners_in(p));
                if better {
                    problem = Some(e);
                }
            }
        }
    }
    Err(problem.unwrap_or(BoardNotFound::Nothing { crossings: 0 }))
}

/// An image at the scales that are searched, in their order: first that at which squares have some
/// ten pixels, then coarser and smoothed ones, which bridge gaps and blur, then finer ones for
/// small squares.
pub(super) fn levels(image: &GrayImage) -> impl Iterator<Item = Scaled> {
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
    let count = pyramid.len();
    let coarser = (first..count.min(first + 2)).map(|k| (k, Change::None));
    let soft = (first..count.min(first + 2)).map(|k| (k, Change::Smooth));
    let finer = (0..first).rev().map(|k| (k, Change::None));
    let twice = (first == 0).then_some((0, Change::Double));
    let coarsest = (first + 2 < count).then_some((first + 2, Change::None));
    coarser
        .chain(soft)
        .chain(finer)
        .chain(twice)
        .chain(coarsest)
        .map(move |(level, change)| {
            let scaled = &pyramid[level];
            match change {
                Change::None => scaled.clone(),
                Change::Smooth => smoothed(scaled),
                Change::Double => doubled(scaled),
            }
        })
}

/// What is done with a level of the pyramid.
#[derive(Clone, Copy)]
enum Change {
    None,
    Smooth,
    Double,
}

/// How much of a board an attempt saw.
fn corners_in(e: &BoardNotFound) -> usize {
    match e {
        BoardNotFound::WrongSize { found, .. } => *found,
        BoardNotFound::FalseCorner { .. } | BoardNotFound::Unclear { .. } => usize::MAX,
        _ => 0,
    }
}

/// Looks for the board at one scale of `whole`; the corners are the whole image's.
fn search(
    scaled: &Scaled,
    whole: &GrayImage,
    size: BoardSize,
) -> Result<BoardCorners, BoardNotFound> {
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
    let mut candidates: Vec<&Grid> = Vec::new();
    for grid in found.iter().filter(fits) {
        // Two parts of one board may both have grown to the whole.
        let again = |other: &&Grid| (grid.centre() - other.centre()).norm() < grid.spacing();
        if !candidates.iter().any(again) {
            candidates.push(grid);
        }
    }
    match candidates.as_slice() {
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
            let finer = one.moved(|at| scaled.in_whole(at));
            if let Some((cols, rows)) = goes_on(image, one).or_else(|| goes_on(whole, &finer)) {
                return Err(BoardNotFound::WrongSize {
                    expected_cols: size.cols,
                    expected_rows: size.rows,
                    found: cols * rows,
                    cols,
                    rows,
                });
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
