//! From an image to the labelled corners of a board.

use hal::GrayImage;
use nalgebra::Point2;

use super::BoardSize;
use super::find::find_board;
use super::refine::{RefineOptions, refine_corner};
use super::regular::irregular_corner;

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
    /// No markers that say where a part of a `ChArUco` board lies.
    #[error(
        "no two markers of the board that agree, of {markers} read ({crossings} isolated \
         crossings): is it this dictionary, and this number of squares?"
    )]
    NoMarkers {
        /// Crossings found.
        crossings: usize,
        /// Markers that agreed.
        markers: usize,
    },
    /// No grid of circles of this size.
    #[error(
        "expected a grid of {expected} circles, {found} hang together of {discs} discs: all must be \
         visible, none touch the image's border or another"
    )]
    NoCircles {
        /// Expected circles.
        expected: usize,
        /// Circles of the largest grid.
        found: usize,
        /// Discs found.
        discs: usize,
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
/// Width of the images for which the windows of [`RefineOptions`] are meant \[px\]; wider ones show
/// the same edges over more pixels.
pub(super) const WINDOW_WIDTH: f64 = 640.0;

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
    let wide = (image.width() as f64 / WINDOW_WIDTH).max(1.0);
    let largest = options.max_half_width as f64 * wide;
    for (k, (col, row)) in board.size.indices().enumerate() {
        let spacing = spacing(&start, board.size, col, row);
        let half = (spacing / 4.0).min(largest);
        // A soft edge may need more of itself than a quarter of the square; what the image's border
        // cuts, less.
        board.corners[k] = [half, spacing / 3.0, half / 2.0]
            .into_iter()
            .find_map(|half| refine_corner(image, start[k], pixels(half), options.max_iterations))
            .ok_or(BoardNotFound::Unclear {
                corner: k,
                x_px: start[k].x,
                y_px: start[k].y,
            })?;
    }
    check(board, FALSE_PX)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a part of a distance within the image"
)]
fn pixels(length: f64) -> usize {
    length as usize
}

/// Whether every corner lies where the others put it.
pub(super) fn check(board: &BoardCorners, limit_px: f64) -> Result<(), BoardNotFound> {
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
