//! A chessboard before the cameras, for calibrations.

use hal::Transform;
use hal::frame::{Board, World};
use nalgebra::{Point3, Vector3};

use super::coverage::SparsePlane;
use super::lens::Pixel;
use super::view::{Through, View};

/// A flat chessboard held before the cameras, the container removed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardView {
    /// The board: origin at the first inner corner, x along the rows, y along the columns, z
    /// away from the side with the pattern.
    pub world_from_board: Transform<World, Board>,
    /// Inner corners in a row.
    pub columns: usize,
    /// Rows of inner corners.
    pub rows: usize,
    /// Side of a square \[m\].
    pub square: f64,
}

/// A board that cannot be photographed.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BoardError {
    /// No board.
    #[error(
        "a board of {columns} x {rows} inner corners of {square_mm} mm is none (2-100 corners, 0.1-1000 mm)"
    )]
    Size {
        /// Inner corners in a row.
        columns: usize,
        /// Rows of inner corners.
        rows: usize,
        /// Side of a square \[mm\].
        square_mm: f64,
    },
    /// A camera sees the board's back, or the board reaches behind the camera.
    #[error("the {camera} camera does not see the board's face (turned by {angle_deg} deg)")]
    Turned {
        /// Which camera.
        camera: &'static str,
        /// Angle between the line of sight and the board's normal \[deg\].
        angle_deg: f64,
    },
}

/// White paper beyond the outer squares, in squares.
const MARGIN: f64 = 0.6;
/// Pieces into which an edge is cut, so that distortion bends it.
const PIECES: usize = 8;

impl BoardView {
    /// Inner corners in the board's frame \[m\], row by row.
    pub fn corners(&self) -> impl Iterator<Item = Point3<f64>> + '_ {
        (0..self.rows).flat_map(move |j| {
            (0..self.columns)
                .map(move |i| Point3::new(i as f64 * self.square, j as f64 * self.square, 0.0))
        })
    }

    /// # Errors
    /// The board is none, or the camera does not see its face.
    pub(super) fn check(&self, view: &View, camera: &'static str) -> Result<(), BoardError> {
        let count = 2..=100;
        if !(count.contains(&self.columns)
            && count.contains(&self.rows)
            && (1e-4..=1.0).contains(&self.square))
        {
            return Err(BoardError::Size {
                columns: self.columns,
                rows: self.rows,
                square_mm: 1e3 * self.square,
            });
        }
        let camera_from_board = view.camera_from_world() * self.world_from_board.isometry();
        let normal = camera_from_board.rotation * Vector3::z();
        for (u, v) in [(-2, -2), (-2, 2), (2, -2), (2, 2)] {
            // Generously outside the paper.
            let corner = Point3::new(
                self.square * (0.5 * self.columns as f64 * (1.0 + 0.5 * f64::from(u))),
                self.square * (0.5 * self.rows as f64 * (1.0 + 0.5 * f64::from(v))),
                0.0,
            );
            let p = (camera_from_board * corner).coords;
            let angle = normal.angle(&p);
            // Written so that NaN is refused.
            if !(p.z > 0.0 && angle < 89f64.to_radians()) {
                return Err(BoardError::Turned {
                    camera,
                    angle_deg: angle.to_degrees(),
                });
            }
        }
        Ok(())
    }

    /// Adds the paper to one plane and the black squares to another.
    pub(super) fn paint(&self, view: &View, paper: &mut SparsePlane, ink: &mut SparsePlane) {
        let (columns, rows) = (self.columns as f64, self.rows as f64);
        let sheet = self.rectangle(
            view,
            [-1.0 - MARGIN, -1.0 - MARGIN],
            [columns + MARGIN, rows + MARGIN],
        );
        paper.polygon(sheet.into_iter(), 1.0);
        for j in 0..=self.rows {
            for i in (j % 2..=self.columns).step_by(2) {
                let (x, y) = (i as f64, j as f64);
                ink.polygon(
                    self.rectangle(view, [x - 1.0, y - 1.0], [x, y]).into_iter(),
                    1.0,
                );
            }
        }
    }

    /// Outline in the image of a rectangle of the board, in squares.
    fn rectangle(&self, view: &View, from: [f64; 2], to: [f64; 2]) -> Vec<Pixel> {
        let corners = [from, [to[0], from[1]], to, [from[0], to[1]]];
        (0..4)
            .flat_map(|side| {
                let (a, b) = (corners[side], corners[(side + 1) % 4]);
                (0..PIECES).filter_map(move |k| {
                    let t = k as f64 / PIECES as f64;
                    let p = Point3::new(
                        self.square * (a[0] + t * (b[0] - a[0])),
                        self.square * (a[1] + t * (b[1] - a[1])),
                        0.0,
                    );
                    view.project(&(self.world_from_board.isometry() * p), Through::OpenAir)
                })
            })
            .collect()
    }
}
