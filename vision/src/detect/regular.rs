//! Is a labelled board what a lens makes of a plane?
//!
//! A homography, and what it leaves as a cubic of position (a lens's distortion over a board is
//! mostly little more): a corner that fits neither that nor its own row and column is false,
//! whatever found it.

use nalgebra::{Point2, SMatrix, SVector, Vector2};

use super::BoardSize;
use crate::homography::{homography, map};

/// Terms of a bivariate cubic.
const TERMS: usize = 10;

/// A corner that does not lie where its board says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Irregular {
    /// Index of the corner, row-major.
    pub corner: usize,
    /// Its distance from where the others put it \[px\].
    pub distance_px: f64,
    /// Robust standard deviation of the other corners \[px\].
    pub sigma_px: f64,
}

/// The worst corner, if it is further from where all others put it than `limit_px` and eight of
/// their standard deviations. `corners` are row-major.
///
/// Also names a corner of a board of which nothing can be fitted (points on a line). A corner at
/// which a strong lens bends the board more than the cubic follows is not named: its row or its
/// column, continued from its neighbours, then leads to it.
pub fn irregular_corner(
    corners: &[Point2<f64>],
    size: BoardSize,
    limit_px: f64,
) -> Option<Irregular> {
    let Some(distances) = leave_one_out(corners, size) else {
        return Some(Irregular {
            corner: 0,
            distance_px: f64::INFINITY,
            sigma_px: 0.0,
        });
    };
    let mut sorted = distances.clone();
    sorted.sort_by(f64::total_cmp);
    // The median distance of a plane's Gaussian is 1.177 sigma.
    let sigma_px = sorted[sorted.len() / 2] / 1.177;
    let limit = limit_px.max(8.0 * sigma_px);
    let local = local_sigma(corners, size);
    let (corner, distance_px) = distances
        .into_iter()
        .enumerate()
        .filter(|(k, d)| {
            let beyond = d.is_nan() || *d > limit;
            beyond && !leads_to(corners, size, *k, LOCAL * limit_px, local)
        })
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(Irregular {
        corner,
        distance_px,
        sigma_px,
    })
}

/// Limit of the local check over the global one's.
const LOCAL: f64 = 1.5;
/// Part of the spacing by which a strong lens departs from a continued line.
const BEND: f64 = 0.04;
/// Sigmas of the corners' noise, as a continued line amplifies it, within which both row and
/// column would have to miss.
const SIGMAS: f64 = 2.0;

/// A corner's row and its column: place in it, length, first corner, stride.
fn lines(size: BoardSize, corner: usize) -> [(usize, usize, usize, usize); 2] {
    let (col, row) = (corner % size.cols, corner / size.cols);
    [
        (col, size.cols, row * size.cols, 1),
        (row, size.rows, col, size.cols),
    ]
}

/// Robust standard deviation of the corners by how far their rows miss them \[px\].
fn local_sigma(corners: &[Point2<f64>], size: BoardSize) -> f64 {
    let mut misses: Vec<f64> = (0..corners.len())
        .map(|k| {
            let [(at, count, first, stride), _] = lines(size, k);
            let c = continued(at, count, |j| corners[first + j * stride].coords);
            (corners[k].coords - c.predicted).norm() / c.gain
        })
        .collect();
    misses.sort_by(f64::total_cmp);
    misses[misses.len() / 2] / 1.177
}

/// Whether the row or the column of a corner, continued by a cubic, leads to it. A line that holds
/// the corner between others says so more reliably than one that ends in it.
fn leads_to(
    corners: &[Point2<f64>],
    size: BoardSize,
    corner: usize,
    limit_px: f64,
    sigma_px: f64,
) -> bool {
    let [row, column] = lines(size, corner).map(|(at, count, first, stride)| {
        let c = continued(at, count, |j| corners[first + j * stride].coords);
        let limit = limit_px
            .max(BEND * c.spacing)
            .max(SIGMAS * c.gain * sigma_px);
        let leads = (corners[corner].coords - c.predicted).norm() <= limit;
        (leads, at > 0 && at + 1 < count)
    });
    match (row, column) {
        ((leads, true), (_, false)) | ((_, false), (leads, true)) => leads,
        ((a, _), (b, _)) => a || b,
    }
}

/// Where a line's other points put one of them.
struct Continued {
    predicted: Vector2<f64>,
    /// Distance of neighbours there.
    spacing: f64,
    /// Standard deviation of the miss over that of a point.
    gain: f64,
}

/// Where a line of `count` points puts the one `at`.
fn continued(at: usize, count: usize, point: impl Fn(usize) -> Vector2<f64>) -> Continued {
    // Counted from the nearer end.
    let flip = 2 * at >= count;
    let near = if flip { count - 1 - at } else { at };
    let p = |k: usize| point(if flip { count - 1 - k } else { k });
    let (predicted, gain) = match (near, count) {
        (0, 0..=3) => (p(1) * 2.0 - p(2), 6.0_f64),
        (0, 4) => ((p(1) - p(2)) * 3.0 + p(3), 20.0),
        (0, _) => (p(1) * 4.0 - p(2) * 6.0 + p(3) * 4.0 - p(4), 70.0),
        (1, 3) => ((p(0) + p(2)) / 2.0, 1.5),
        (1, 4) => ((p(0) + p(2) * 3.0 - p(3)) / 3.0, 20.0 / 9.0),
        (1, _) => ((p(0) + p(2) * 6.0 - p(3) * 4.0 + p(4)) / 4.0, 70.0 / 16.0),
        (k, _) => (
            ((p(k - 1) + p(k + 1)) * 4.0 - p(k - 2) - p(k + 2)) / 6.0,
            70.0 / 36.0,
        ),
    };
    let spacing = if near == 0 {
        (p(2) - p(1)).norm()
    } else {
        (p(near + 1) - p(near - 1)).norm() / 2.0
    };
    Continued {
        predicted,
        spacing,
        gain: gain.sqrt(),
    }
}

/// Distance of each corner from the fit to all others.
fn leave_one_out(corners: &[Point2<f64>], size: BoardSize) -> Option<Vec<f64>> {
    let board: Vec<_> = size
        .indices()
        .map(|(c, r)| Point2::new(c as f64, r as f64))
        .collect();
    let h = homography(&board, corners)?;
    let predicted: Vec<_> = board.iter().map(|p| map(&h, p)).collect();
    if corners.len() < 2 * TERMS {
        // Too few for the cubic: the homography alone, in which a lens's distortion remains.
        return Some(
            predicted
                .iter()
                .zip(corners)
                .map(|(a, b)| (a - b).norm())
                .collect(),
        );
    }
    let centre = predicted
        .iter()
        .fold(SVector::<f64, 2>::zeros(), |s, p| s + p.coords)
        / predicted.len() as f64;
    let scale = predicted
        .iter()
        .map(|p| (p.coords - centre).norm())
        .fold(0.0, f64::max);
    let basis = |p: &Point2<f64>| {
        let q = (p.coords - centre) / scale;
        let (x, y) = (q.x, q.y);
        SVector::<f64, TERMS>::from([
            1.0,
            x,
            y,
            x * x,
            x * y,
            y * y,
            x * x * x,
            x * x * y,
            x * y * y,
            y * y * y,
        ])
    };
    let mut m = SMatrix::<f64, TERMS, TERMS>::zeros();
    let mut v = SMatrix::<f64, TERMS, 2>::zeros();
    for (p, q) in predicted.iter().zip(corners) {
        let b = basis(p);
        m.syger(1.0, &b, &b, 1.0);
        v += b * (q - p).transpose();
    }
    m.fill_upper_triangle_with_lower_triangle();
    let factor = m.cholesky()?;
    let fit = factor.solve(&v);
    let distance = |(p, q): (&Point2<f64>, &Point2<f64>)| {
        let b = basis(p);
        let residual = (q - p) - fit.transpose() * b;
        let leverage = b.dot(&factor.solve(&b));
        residual.norm() / (1.0 - leverage).max(1e-6)
    };
    Some(predicted.iter().zip(corners).map(distance).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Distortion};
    use nalgebra::{Isometry3, Point3, Vector3};

    const SIZE: BoardSize = BoardSize { cols: 9, rows: 6 };

    fn board() -> Vec<Point2<f64>> {
        let camera = Camera {
            width: 640,
            height: 480,
            fx: 533.0,
            fy: 533.0,
            cx: 320.0,
            cy: 240.0,
            distortion: Distortion::from_array([-0.29, 0.12, 0.0013, -0.0002, -0.04]),
        };
        let pose = Isometry3::new(
            Vector3::new(-0.11, -0.07, 0.3),
            Vector3::new(0.5, -0.4, 0.1),
        );
        SIZE.indices()
            .map(|(c, r)| {
                let p = pose * Point3::new(0.025 * c as f64, 0.025 * r as f64, 0.0);
                camera.project(&p.coords).unwrap().0
            })
            .collect()
    }

    #[test]
    fn a_distorted_tilted_board_is_regular() {
        assert_eq!(irregular_corner(&board(), SIZE, 0.75), None);
    }

    #[test]
    fn a_board_that_fills_a_wide_angle_is_regular_and_its_false_corners_are_named() {
        let camera = Camera {
            width: 640,
            height: 480,
            fx: 330.0,
            fy: 330.0,
            cx: 322.0,
            cy: 236.0,
            distortion: Distortion::from_array([-0.2, 0.01, 0.0, 0.0, 0.0]),
        };
        let pose = Isometry3::new(
            Vector3::new(-0.11, -0.05, 0.15),
            Vector3::new(0.2, 0.35, 0.05),
        );
        let board: Vec<_> = SIZE
            .indices()
            .map(|(c, r)| {
                let p = pose * Point3::new(0.02 * c as f64, 0.02 * r as f64, 0.0);
                camera.project(&p.coords).unwrap().0
            })
            .collect();
        assert_eq!(irregular_corner(&board, SIZE, 0.75), None);
        for k in 0..54 {
            let mut corners = board.clone();
            corners[k].x += 5.0;
            assert!(irregular_corner(&corners, SIZE, 0.75).is_some(), "{k}");
        }
    }

    #[test]
    fn every_single_false_corner_is_named() {
        for k in 0..54 {
            for (dx, dy) in [(2.0, 0.0), (0.0, -2.0), (1.5, 1.5)] {
                let mut corners = board();
                corners[k].x += dx;
                corners[k].y += dy;
                let found = irregular_corner(&corners, SIZE, 0.75).unwrap();
                assert_eq!(found.corner, k);
            }
        }
        let mut swapped = board();
        swapped.swap(10, 11);
        assert!(irregular_corner(&swapped, SIZE, 0.75).is_some());
        let line = vec![Point2::new(1.0, 1.0); 54];
        assert!(irregular_corner(&line, SIZE, 0.75).is_some());
    }
}
