//! Is a labelled board what a lens makes of a plane?
//!
//! A homography, and what it leaves as a cubic of position (a lens's distortion over a board is
//! little more): a corner that does not fit is false, whatever found it.

use nalgebra::{Point2, SMatrix, SVector};

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
/// Also names a corner of a board of which nothing can be fitted (points on a line).
pub fn irregular_corner(
    corners: &[Point2<f64>],
    size: BoardSize,
    limit_px: f64,
) -> Option<Irregular> {
    let distances = leave_one_out(corners, size);
    let Some(distances) = distances else {
        return Some(Irregular {
            corner: 0,
            distance_px: f64::INFINITY,
            sigma_px: 0.0,
        });
    };
    let (corner, distance_px) = distances
        .iter()
        .copied()
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    let mut sorted = distances;
    sorted.sort_by(f64::total_cmp);
    // The median distance of a plane's Gaussian is 1.177 sigma.
    let sigma_px = sorted[sorted.len() / 2] / 1.177;
    let limit = limit_px.max(8.0 * sigma_px);
    (distance_px.is_nan() || distance_px > limit).then_some(Irregular {
        corner,
        distance_px,
        sigma_px,
    })
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
