//! Plane-to-image homographies.

use nalgebra::{Matrix3, Point2, SMatrix, SVector, Vector3};

/// The homography that takes `from` to `to` in the least-squares sense of the direct linear
/// transform with normalised coordinates \[Hartley1997\]; `None` for fewer than four points or
/// points on a line.
pub(crate) fn homography(from: &[Point2<f64>], to: &[Point2<f64>]) -> Option<Matrix3<f64>> {
    if from.len() < 4 || from.len() != to.len() {
        return None;
    }
    let (na, nb) = (normaliser(from)?, normaliser(to)?);
    // With centred coordinates the last element is the depth of the centroid: never zero, so
    // that it may be fixed and the eight others solved for.
    let mut m = SMatrix::<f64, 8, 8>::zeros();
    let mut v = SVector::<f64, 8>::zeros();
    for (p, q) in from.iter().zip(to) {
        let (x, y) = na.apply(p);
        let (u, w) = nb.apply(q);
        let rows = [
            (SVector::from([x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y]), u),
            (SVector::from([0.0, 0.0, 0.0, x, y, 1.0, -w * x, -w * y]), w),
        ];
        for (row, value) in rows {
            m.syger(1.0, &row, &row, 1.0);
            v += row * value;
        }
    }
    m.fill_upper_triangle_with_lower_triangle();
    let h = m.cholesky()?.solve(&v);
    let h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0);
    let full = nb.inverse() * h * na.matrix();
    let scaled = full / full[(2, 2)];
    scaled.iter().all(|x| x.is_finite()).then_some(scaled)
}

/// Where a homography takes a point.
pub(crate) fn map(h: &Matrix3<f64>, p: &Point2<f64>) -> Point2<f64> {
    let q = h * Vector3::new(p.x, p.y, 1.0);
    Point2::new(q.x / q.z, q.y / q.z)
}

/// A shift and a scale.
struct Normaliser {
    centre: Point2<f64>,
    scale: f64,
}

fn normaliser(points: &[Point2<f64>]) -> Option<Normaliser> {
    let n = points.len() as f64;
    let sum = points
        .iter()
        .fold(nalgebra::Vector2::zeros(), |s, p| s + p.coords);
    let centre = Point2::from(sum / n);
    let spread = points
        .iter()
        .map(|p| (p - centre).norm_squared())
        .sum::<f64>()
        / n;
    (spread > 0.0 && spread.is_finite()).then(|| Normaliser {
        centre,
        scale: (2.0 / spread).sqrt(),
    })
}

impl Normaliser {
    fn apply(&self, p: &Point2<f64>) -> (f64, f64) {
        let q = (p - self.centre) * self.scale;
        (q.x, q.y)
    }

    fn matrix(&self) -> Matrix3<f64> {
        let (s, c) = (self.scale, &self.centre);
        Matrix3::new(s, 0.0, -s * c.x, 0.0, s, -s * c.y, 0.0, 0.0, 1.0)
    }

    fn inverse(&self) -> Matrix3<f64> {
        let (s, c) = (1.0 / self.scale, &self.centre);
        Matrix3::new(s, 0.0, c.x, 0.0, s, c.y, 0.0, 0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recovers_a_perspective() {
        let truth = Matrix3::new(1.1, 0.2, 300.0, -0.1, 0.9, 200.0, 1e-3, -2e-3, 1.0);
        let from: Vec<_> = (0..12)
            .map(|k| Point2::new(f64::from(k % 4) * 25.0, f64::from(k / 4) * 30.0))
            .collect();
        let to: Vec<_> = from.iter().map(|p| map(&truth, p)).collect();
        let h = homography(&from, &to).unwrap();
        assert!((h - truth).norm() < 1e-9 * truth.norm());
    }

    #[test]
    fn points_on_a_line_have_none() {
        let line: Vec<_> = (0..6)
            .map(|k| Point2::new(f64::from(k), 2.0 * f64::from(k)))
            .collect();
        let h = homography(&line, &line);
        assert!(h.is_none_or(|h| h.iter().all(|x| x.is_finite())));
        assert!(homography(&line[..3], &line[..3]).is_none());
    }
}
