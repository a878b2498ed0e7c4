//! `ChArUco` boards: a chessboard with a marker in every white square. The markers number the
//! corners, so that a part of a board counts.

mod dictionary;
mod squares;

use std::collections::BTreeMap;

use hal::GrayImage;
use nalgebra::{Matrix3, Point2};

pub use dictionary::{Dictionary, UnknownDictionary};
use squares::{painted, white_squares, widened};

use super::BoardSize;
use super::board::{BoardNotFound, WINDOW_WIDTH};
use super::complete::complete;
use super::find::{LIMIT, levels};
use super::grid::{Cell, Grid, grids};
use super::refine::{RefineOptions, refine_corner};
use super::response::{peaks, response};
use super::saddle::{RADIUS, Saddle, bilinear, saddle_at};
use super::scale::Scaled;
use crate::homography::map;

/// A `ChArUco` board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CharucoBoard {
    /// Its squares, along a row and along a column (OpenCV's size).
    pub squares: BoardSize,
    /// Its markers.
    pub dictionary: Dictionary,
}

/// Sides of markers that are tried, over the squares'; between them every marker is read.
const RATIOS: [f64; 5] = [0.9, 0.8, 0.7, 0.6, 0.5];
/// Markers that have to agree where the board lies.
const AGREEING: usize = 2;
/// Part of the read markers that agree; the others are misread or of another board.
const MAJORITY: f64 = 0.6;
/// Corners that a part of a board needs.
const LEAST: usize = 6;
/// Bits of a marker's black frame that may look white.
const FRAME: f64 = 0.1;
/// Grey levels between a marker's black and the white around it.
const CONTRAST: f64 = 15.0;

impl CharucoBoard {
    /// The inner corners, those that are found.
    pub const fn corners(&self) -> BoardSize {
        BoardSize {
            cols: self.squares.cols.saturating_sub(1),
            rows: self.squares.rows.saturating_sub(1),
        }
    }

    /// Places (column, row) of the squares with markers, in the order of the markers. The first
    /// square is black, or white on boards of OpenCV before 4.6 with an even number of rows.
    fn places(&self, first_white: bool) -> impl Iterator<Item = (i32, i32)> {
        let parity = usize::from(!first_white);
        self.squares
            .indices()
            .filter(move |(col, row)| (col + row) % 2 == parity)
            .filter_map(|(col, row)| Some((i32::try_from(col).ok()?, i32::try_from(row).ok()?)))
    }
}

/// How a grid's labels lie on the board: quarter turns clockwise, then a shift, in squares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Placed {
    turns: u8,
    shift: (i32, i32),
    first_white: bool,
}

impl Placed {
    /// The board's coordinates of a grid's.
    fn on_board(&self, (x, y): (i32, i32)) -> (i32, i32) {
        let (x, y) = rotated((x, y), self.turns);
        (x + self.shift.0, y + self.shift.1)
    }
}

fn rotated((x, y): (i32, i32), turns: u8) -> (i32, i32) {
    (0..turns).fold((x, y), |(x, y), _| (-y, x))
}

/// Finds the board's inner corners, row by row \[px\]; `None` where one is not seen.
///
/// # Errors
/// No chessboard, or none whose markers agree that it is this board.
pub fn detect_charuco(
    image: &GrayImage,
    board: &CharucoBoard,
    options: &RefineOptions,
) -> Result<Vec<Option<Point2<f64>>>, BoardNotFound> {
    let size = board.corners();
    if size.cols < 2 || size.rows < 2 {
        return Err(BoardNotFound::TooSmall {
            cols: size.cols,
            rows: size.rows,
        });
    }
    let mut best: Option<Labelled> = None;
    let mut seen = (0, 0);
    for scaled in levels(image) {
        let Some(mut found) = search(&scaled, board, &mut seen) else {
            continue;
        };
        // What one scale does not show another may; the first is the sharpest.
        if let Some(before) = best {
            for (corner, known) in found.corners.iter_mut().zip(before.corners) {
                *corner = known.or(*corner);
            }
            (found.ratio, found.first_white) = (before.ratio, before.first_white);
        }
        drop_uneven(&mut found.corners, size);
        let whole = found.corners.iter().all(Option::is_some);
        best = Some(found);
        if whole {
            break;
        }
    }
    let (crossings, markers) = seen;
    let found = best.ok_or(BoardNotFound::NoMarkers { crossings, markers })?;
    let mut corners = found.refined(image, size, options);
    drop_uneven(&mut corners, size);
    let count = corners.iter().flatten().count();
    let flat = |of: fn(usize, usize) -> usize| {
        let mut lines = (0..corners.len())
            .filter(|k| corners[*k].is_some())
            .map(|k| of(k, size.cols));
        let first = lines.next();
        lines.all(|line| Some(line) == first)
    };
    if count < LEAST || flat(|k, cols| k % cols) || flat(|k, cols| k / cols) {
        return Err(BoardNotFound::NoMarkers { crossings, markers });
    }
    Ok(corners)
}

/// Second difference of three corners in line over the shorter distance: perspective and lens stay
/// below.
const UNEVEN: f64 = 0.3;

/// Drops corners that do not lie in line with others, the one that disturbs most lines first.
fn drop_uneven(corners: &mut [Option<Point2<f64>>], size: BoardSize) {
    loop {
        let at = |k: usize| corners.get(k).copied().flatten();
        // Lines that a corner disturbs, and lines that hold it.
        let mut lines: BTreeMap<usize, (usize, usize)> = BTreeMap::new();
        for (col, row) in size.indices() {
            let k = row * size.cols + col;
            for (there, stride) in [(col + 2 < size.cols, 1), (row + 2 < size.rows, size.cols)] {
                let three = [k, k + stride, k + 2 * stride];
                let [Some(a), Some(b), Some(c)] = three.map(at) else {
                    continue;
                };
                let (first, second) = (b - a, c - b);
                let limit = UNEVEN * first.norm().min(second.norm());
                if there {
                    let uneven = usize::from((second - first).norm() > limit);
                    for k in three {
                        let line = lines.entry(k).or_default();
                        *line = (line.0 + uneven, line.1 + 1);
                    }
                }
            }
        }
        let worst = lines
            .into_iter()
            .filter(|(_, (uneven, _))| *uneven > 0)
            .max_by(|(_, a), (_, b)| {
                let share = |(uneven, all): &(usize, usize)| *uneven as f64 / *all as f64;
                share(a).total_cmp(&share(b)).then(a.0.cmp(&b.0))
            });
        let Some((worst, _)) = worst else { return };
        corners[worst] = None;
    }
}

/// The board's corners of one scale, in the whole image's pixels.
struct Labelled {
    corners: Vec<Option<Point2<f64>>>,
    /// The markers' side over the squares'.
    ratio: f64,
    /// Whether the board's first square is white.
    first_white: bool,
}

impl Labelled {
    /// The corners as a grid, with the colours that the board has.
    fn grid(&self, size: BoardSize) -> Grid {
        let cell = |(k, at): (usize, &Option<Point2<f64>>)| {
            let (col, row) = (k % size.cols, k / size.cols);
            // The square beyond an inner corner is one further from the board's edge, both ways.
            let dark = ((col + row) % 2 == 0) != self.first_white;
            at.map(|at| Cell { at, dark })
        };
        Grid {
            cols: size.cols,
            rows: size.rows,
            cells: self.corners.iter().enumerate().map(cell).collect(),
        }
    }

    /// Refined in the whole image, the markers painted over.
    fn refined(
        &self,
        image: &GrayImage,
        size: BoardSize,
        options: &RefineOptions,
    ) -> Vec<Option<Point2<f64>>> {
        let wider = widened(&self.grid(size));
        let squares = white_squares(&wider).map(|(_, to_image)| to_image);
        let plain = painted(image, squares, self.ratio);
        let at = |k: usize| self.corners.get(k).copied().flatten();
        // Between a corner and the marker of a square beside it.
        let gap = 0.5 * (1.0 - self.ratio);
        let largest =
            options.max_half_width as f64 * (image.width() as f64 / WINDOW_WIDTH).max(1.0);
        let refine = |k: usize| {
            let corner = at(k)?;
            let (col, row) = (k % size.cols, k / size.cols);
            let to = |dc: isize, dr: isize| {
                let c = col.checked_add_signed(dc).filter(|&c| c < size.cols)?;
                let r = row.checked_add_signed(dr)?;
                Some((at(r * size.cols + c)? - corner).norm())
            };
            let beside = [(1, 0), (-1, 0), (0, 1), (0, -1)].map(|(c, r)| to(c, r));
            let spacing = beside.into_iter().flatten().fold(f64::INFINITY, f64::min);
            // Where the border cuts most of a square beside a corner, its marker may pass for an edge.
            let (w, h) = (image.width() as f64, image.height() as f64);
            if corner.x.min(corner.y).min(w - corner.x).min(h - corner.y) < BORDER * spacing {
                return None;
            }
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a part of a distance within the image"
            )]
            let halves = [spacing / 4.0, gap * spacing].map(|half| half.min(largest) as usize);
            let [wide, narrow] =
                halves.map(|half| refine_corner(&plain, corner, half, options.max_iterations));
            // Squares that the border cuts are painted where lines lead: what is left of a marker
            // draws the crossing in the wide window, while the narrow one holds nothing of it.
            let drawn = wide.zip(narrow).is_some_and(|(wide, narrow)| {
                (wide - narrow).norm() > (DRAWN * gap * spacing).max(LEAST_DRAWN)
            });
            let better = if drawn { narrow } else { wide };
            better.filter(|better| (better - corner).norm() < NEAR * spacing)
        };
        (0..size.count()).map(refine).collect()
    }
}

/// Least distance of a corner to the image's border, in parts of the spacing.
const BORDER: f64 = 0.5;
/// Difference between the crossings of a wide and a narrow window beyond which a marker is in the
/// wide one: in parts of the gap between corner and marker, and what noise makes of it \[px\].
const DRAWN: f64 = 0.2;
const LEAST_DRAWN: f64 = 0.5;
/// Part of the spacing by which a corner may move when it is refined.
const NEAR: f64 = 0.15;

/// Looks for the board at one scale. `seen` becomes the most crossings and markers seen.
fn search(scaled: &Scaled, board: &CharucoBoard, seen: &mut (usize, usize)) -> Option<Labelled> {
    let image = &scaled.image;
    let saddles: Vec<Saddle> = peaks(&response(image), image.width(), LIMIT)
        .iter()
        .filter_map(|p| saddle_at(image, Point2::new(p.x as f64, p.y as f64), RADIUS))
        .collect();
    seen.0 = seen.0.max(saddles.len());
    let size = board.corners();
    let codes = board.dictionary.codes();
    let mut corners = vec![None; size.count()];
    let mut first = None;
    for grid in &mut grids(&saddles) {
        complete(image, grid, size);
        let Some((placed, markers, found_ratio)) = place(image, grid, board, &codes) else {
            continue;
        };
        seen.1 = seen.1.max(markers);
        first.get_or_insert((found_ratio, placed.first_white));
        for row in 0..grid.rows {
            for col in 0..grid.cols {
                let place = (i32::try_from(col), i32::try_from(row));
                let (Some(cell), (Ok(x), Ok(y))) = (grid.at(col, row), place) else {
                    continue;
                };
                // Inner corners begin one square from the board's edge.
                let (x, y) = placed.on_board((x, y));
                let inner =
                    |v: i32, count: usize| usize::try_from(v - 1).ok().filter(|&v| v < count);
                if let (Some(c), Some(r)) = (inner(x, size.cols), inner(y, size.rows)) {
                    corners[r * size.cols + c].get_or_insert(scaled.in_whole(&cell.at));
                }
            }
        }
    }
    first.map(|(ratio, first_white)| Labelled {
        corners,
        ratio,
        first_white,
    })
}

/// Where a grid lies on the board by the markers in its white squares, how many agree, and their
/// side over the squares'.
fn place(
    image: &GrayImage,
    grid: &Grid,
    board: &CharucoBoard,
    codes: &[u64],
) -> Option<(Placed, usize, f64)> {
    let conventions: Vec<(bool, Vec<(i32, i32)>)> = [false, true]
        .into_iter()
        .filter(|white| !white || board.squares.rows.is_multiple_of(2))
        .map(|white| (white, board.places(white).collect()))
        .collect();
    let wider = widened(grid);
    let size = board.corners();
    // Of two that the markers allow, the one that has the corners on the board; then boards of today.
    let on_board = |placed: &Placed| {
        let there = |k: &usize| {
            let (col, row) = (i32::try_from(k % grid.cols), i32::try_from(k / grid.cols));
            let (x, y) = placed.on_board((col.unwrap_or(0), row.unwrap_or(0)));
            grid.cells[*k].is_some()
                && inner(x, size.cols).is_some()
                && inner(y, size.rows).is_some()
        };
        (0..grid.cells.len()).filter(there).count()
    };
    // The place, how many markers agree, and the sides with which they do.
    let mut best: Option<(Placed, usize, Vec<f64>)> = None;
    for ratio in RATIOS {
        let mut votes: BTreeMap<Placed, usize> = BTreeMap::new();
        let mut read = 0;
        for (cell, to_image) in white_squares(&wider) {
            let Some((id, turns)) = marker(image, &to_image, ratio, board.dictionary, codes) else {
                continue;
            };
            read += 1;
            for (first_white, places) in &conventions {
                let first_white = *first_white;
                let Some(&(x, y)) = places.get(id) else {
                    continue;
                };
                // Twice the centres of the squares, so that all are integers; the grid was widened.
                let (u, v) = rotated((2 * cell.0 - 1, 2 * cell.1 - 1), turns);
                let shift = ((2 * x + 1 - u) / 2, (2 * y + 1 - v) / 2);
                let placed = Placed {
                    turns,
                    shift,
                    first_white,
                };
                *votes.entry(placed).or_default() += 1;
            }
        }
        let most = votes
            .into_iter()
            .max_by_key(|(p, n)| (*n, on_board(p), !p.first_white));
        if let Some((placed, agreeing)) = most
            && agreeing >= AGREEING
            && agreeing as f64 >= MAJORITY * f64::from(read)
        {
            match &mut best {
                Some((_, n, ratios)) if agreeing == *n => ratios.push(ratio),
                Some((_, n, _)) if agreeing < *n => {}
                _ => best = Some((placed, agreeing, vec![ratio])),
            }
        }
    }
    // Of the sides that serve as well the middle one is nearest to the truth.
    best.map(|(placed, agreeing, ratios)| {
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        (placed, agreeing, mean)
    })
}

/// The inner corner at a place of the board: they begin one square from its edge.
fn inner(place: i32, count: usize) -> Option<usize> {
    usize::try_from(place - 1).ok().filter(|&v| v < count)
}

/// The marker in a square: its number, and the quarter turns clockwise that set it upright.
fn marker(
    image: &GrayImage,
    to_image: &Matrix3<f64>,
    ratio: f64,
    dictionary: Dictionary,
    codes: &[u64],
) -> Option<(usize, u8)> {
    let side = dictionary.side();
    let cells = side + 2;
    let grey = |u: f64, v: f64| {
        let p = map(to_image, &Point2::new(u, v));
        let (w, h) = (image.width() as f64, image.height() as f64);
        let inside = p.x >= 0.0 && p.y >= 0.0 && p.x < w - 1.0 && p.y < h - 1.0;
        inside.then(|| bilinear(image, p.x, p.y))
    };
    let place = |k: usize, off: f64| 0.5 + ratio * ((k as f64 + 0.5 + off) / cells as f64 - 0.5);
    // A cell is the mean of five samples.
    let cell = |row: usize, col: usize| {
        let mut sum = 0.0;
        for (du, dv) in [
            (0.0, 0.0),
            (0.2, 0.2),
            (-0.2, 0.2),
            (0.2, -0.2),
            (-0.2, -0.2),
        ] {
            sum += grey(place(col, du), place(row, dv))?;
        }
        Some(sum / 5.0)
    };
    let mut values = Vec::with_capacity(cells * cells);
    for row in 0..cells {
        for col in 0..cells {
            values.push(cell(row, col)?);
        }
    }
    let border = |k: usize| {
        let (row, col) = (k / cells, k % cells);
        row == 0 || col == 0 || row + 1 == cells || col + 1 == cells
    };
    let (mut black, mut count) = (0.0, 0.0);
    for (k, value) in values.iter().enumerate().filter(|(k, _)| border(*k)) {
        debug_assert!(border(k));
        black += value;
        count += 1.0;
    }
    black /= count;
    // The white around the marker, half way to the square's edge.
    let beside = (1.0 - ratio) / 4.0;
    let around = [
        (beside, 0.5),
        (1.0 - beside, 0.5),
        (0.5, beside),
        (0.5, 1.0 - beside),
    ];
    let mut white = 0.0;
    for (u, v) in around {
        white += grey(u, v)? / 4.0;
    }
    if white - black < CONTRAST {
        return None;
    }
    let middle = f64::midpoint(white, black);
    let bright = values
        .iter()
        .enumerate()
        .filter(|(k, v)| border(*k) && **v > middle);
    if bright.count() as f64 > FRAME * count {
        return None;
    }
    let inner = values.iter().enumerate().filter(|(k, _)| !border(*k));
    let mut code = inner.fold(0, |code, (_, v)| code << 1 | u64::from(*v > middle));
    for turns in 0..4 {
        let near = |known: &u64| (known ^ code).count_ones() <= dictionary.wrong_bits();
        if let Some(id) = codes.iter().position(near) {
            return Some((id, turns));
        }
        code = dictionary::turned(code, side);
    }
    None
}
