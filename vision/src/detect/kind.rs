//! The kinds of boards under one name.

use core::str::FromStr;

use hal::GrayImage;
use nalgebra::Point2;

use super::{
    BoardNotFound, BoardSize, CharucoBoard, Dictionary, RefineOptions, UnknownDictionary,
    detect_board, detect_charuco, detect_circles,
};

/// A board of any kind that is detected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardKind {
    /// A chessboard, by its inner corners; it counts only whole.
    Chessboard(BoardSize),
    /// A chessboard with markers; a part counts.
    Charuco(CharucoBoard),
    /// An asymmetric grid of circles; it counts only whole.
    Circles(BoardSize),
}

/// A name that is no board.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UnknownBoard {
    /// Of no kind.
    #[error(
        "{0}: expected COLUMNSxROWS inner corners of a chessboard (9x6), \
         charuco:COLUMNSxROWS:DICTIONARY with the number of squares (charuco:7x5:DICT_4X4_50), or \
         circles:COLUMNSxROWS of an asymmetric grid (circles:4x11)"
    )]
    Kind(String),
    /// A dictionary that is not supported.
    #[error(transparent)]
    Dictionary(#[from] UnknownDictionary),
    /// A board whose dictionary has too few markers.
    #[error("{name}: {squares} squares with markers, but {dictionary} has {markers}")]
    TooFewMarkers {
        /// The board.
        name: String,
        /// Squares with markers.
        squares: usize,
        /// The dictionary.
        dictionary: Dictionary,
        /// Its markers.
        markers: usize,
    },
}

impl FromStr for BoardKind {
    type Err = UnknownBoard;

    fn from_str(text: &str) -> Result<Self, UnknownBoard> {
        let unknown = || UnknownBoard::Kind(text.to_owned());
        let size = |text: &str| {
            let (cols, rows) = text.split_once(['x', 'X']).ok_or_else(unknown)?;
            let number = |t: &str| t.trim().parse().map_err(|_| unknown());
            Ok::<_, UnknownBoard>(BoardSize {
                cols: number(cols)?,
                rows: number(rows)?,
            })
        };
        let parts: Vec<&str> = text.split(':').map(str::trim).collect();
        match parts.as_slice() {
            [one] => Ok(Self::Chessboard(size(one)?)),
            ["circles", one] => Ok(Self::Circles(size(one)?)),
            ["charuco", one, dictionary] => {
                let board = CharucoBoard {
                    squares: size(one)?,
                    dictionary: dictionary.parse()?,
                };
                let (squares, markers) = (board.squares.count() / 2, board.dictionary.count());
                if squares > markers {
                    return Err(UnknownBoard::TooFewMarkers {
                        name: text.to_owned(),
                        squares,
                        dictionary: board.dictionary,
                        markers,
                    });
                }
                Ok(Self::Charuco(board))
            }
            _ => Err(unknown()),
        }
    }
}

impl BoardKind {
    /// Columns and rows of its points: inner corners or circles.
    pub const fn size(&self) -> BoardSize {
        match self {
            Self::Chessboard(size) | Self::Circles(size) => *size,
            Self::Charuco(board) => board.corners(),
        }
    }

    /// Finds its points in an image, row by row \[px\]; `None` where one is not seen.
    ///
    /// # Errors
    /// See [`BoardNotFound`].
    pub fn detect(
        &self,
        image: &GrayImage,
        options: &RefineOptions,
    ) -> Result<Vec<Option<Point2<f64>>>, BoardNotFound> {
        let whole = |points: Vec<Point2<f64>>| points.into_iter().map(Some).collect();
        match self {
            Self::Chessboard(size) => {
                detect_board(image, *size, options).map(|board| whole(board.corners))
            }
            Self::Charuco(board) => detect_charuco(image, board, options),
            Self::Circles(size) => detect_circles(image, *size).map(whole),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_are_named_by_kind_and_unknown_ones_are_told_what_is_known() {
        let size = |text: &str| text.parse::<BoardKind>().map(|kind| kind.size());
        let of = |cols, rows| Ok(BoardSize { cols, rows });
        assert_eq!(size("9x6"), of(9, 6));
        assert_eq!(size("circles:4x11"), of(4, 11));
        assert_eq!(size("charuco:7x5:DICT_4X4_50"), of(6, 4));
        for wrong in ["nine", "charuco:7x5", "dots:4x11", "circles:4", "a:b:c:d"] {
            let error = size(wrong).unwrap_err().to_string();
            assert!(
                error.contains(wrong) && error.contains("charuco:"),
                "{error}"
            );
        }
        let error = size("charuco:7x5:DICT_7X7_50").unwrap_err().to_string();
        assert!(error.contains("DICT_4X4_50"), "{error}");
        let error = size("charuco:20x20:DICT_4X4_50").unwrap_err().to_string();
        assert!(error.contains("200 squares"), "{error}");
    }
}
