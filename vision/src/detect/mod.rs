//! Detection of boards of known kind and size: chessboards, `ChArUco` boards, grids of circles.
//!
//! A chessboard counts only whole: exactly its corners, labelled without contradiction, and where a
//! lens would image them. Anything less is a named error, never a board with fewer corners.

mod board;
mod charuco;
mod circles;
mod complete;
mod find;
mod grid;
mod kind;
mod pattern;
mod refine;
mod regular;
mod response;
mod saddle;
mod scale;

pub use board::{BoardCorners, BoardNotFound, detect_board, refine_board};
pub use charuco::{CharucoBoard, Dictionary, UnknownDictionary, detect_charuco};
pub use circles::detect_circles;
pub use find::find_board;
pub use kind::{BoardKind, UnknownBoard};
pub use refine::{RefineOptions, refine_corner};
pub use regular::{Irregular, irregular_corner};

/// Number of inner corners of a chessboard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct BoardSize {
    /// Corners along a row.
    pub cols: usize,
    /// Corners along a column.
    pub rows: usize,
}

impl BoardSize {
    /// Number of corners.
    pub const fn count(&self) -> usize {
        self.cols * self.rows
    }

    /// Column and row of each corner, row-major: the order of every list of corners.
    pub fn indices(self) -> impl Iterator<Item = (usize, usize)> {
        (0..self.rows).flat_map(move |r| (0..self.cols).map(move |c| (c, r)))
    }

    /// Whether the colours tell the board's two ends apart: an odd and an even number.
    pub const fn has_unique_orientation(&self) -> bool {
        !(self.cols + self.rows).is_multiple_of(2)
    }
}
