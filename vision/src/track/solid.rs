//! The joint 3D curve: fitted through refracted rays to both images' offsets and tips.

use nalgebra::{Matrix3, Point2, SMatrix, SVector, Unit, Vector2, Vector3};

use super::planar::{Graph, Planar, TipState};
use super::polynomial::{MAX_POINTS, Values, basis, basis_slope, dot};
use crate::camera::View;

const UNKNOWNS: usize = 2 * MAX_POINTS + 1;
type Normal = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
/// Points of the table from an image's chord to the 3D chord.
const TABLE: usize = 9;

/// A polynomial over its chord in space, in the stereo frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Solid {
    pub origin: Vector3<f64>,
    pub axis: Vector3<f64>,
    pub sides: [Vector3<f64>; 2],
    pub length: f64,
    pub n: usize,
    pub values: [Values; 2],
    pub cov: Normal,
    /// Squared residual of the two tips along the needle: chi-square, 1 degree of freedom.
    pub tip_misfit: f64,
}

impl Solid {
    /// The line that both images' chords show, ending at `tip`.
    pub(super) fn from_chords(
        views: &[View; 2],
        graphs: [&Graph; 2],
        tip: Vector3<f64>,
    ) -> Option<Self> {
        let mut planes = [Vector3::zeros(); 2];
        let mut jacobians = [SMatrix::<f64, 2, 3>::zeros(); 2];
        for k in 0..2 {
            let (_, j) = views[k].project_with_derivative(&tip)?;
            planes[k] = (j.transpose() * graphs[k].across()).normalize();
            jacobians[k] = j;
        }
        let axis = planes[0].cross(&planes[1]).try_normalize(0.02)?;
        let towards =
            (jacobians[0] * axis).dot(&graphs[0].axis) + (jacobians[1] * axis).dot(&graphs[1].axis);
        let axis = if towards < 0.0 { -axis } else { axis };
        let length = (0..2)
            .map(|k| graphs[k].length / (jacobians[k] * axis).norm().max(1.0))
            .fold(0.0, f64::max);
        let (a, b) = sides(&axis);
        Some(Self {
            origin: tip - axis * length,
            axis,
            sides: [a, b],
            length,
            n: graphs[0].n.max(graphs[1].n),
            values: [[0.0; MAX_POINTS]; 2],
            cov: Normal::zeros(),
            tip_misfit: 0.0,
        })
    }

    pub(super) fn point(&self, s: f64) -> Vector3<f64> {
        let l = basis(self.n, s);
        self.origin
            + self.axis * (s * self.length)
            + self.sides[0] * dot(&l, &self.values[0])
            + self.sides[1] * dot(&l, &self.values[1])
    }

    /// Derivative along the chord; nearly of unit length.
    pub(super) fn slope(&self, s: f64) -> Vector3<f64> {
        let l = basis_slope(self.n, s);
        self.axis
            + (self.sides[0] * dot(&l, &self.values[0]) + self.sides[1] * dot(&l, &self.values[1]))
                / self.length
    }

    pub(super) fn direction(&self) -> Unit<Vector3<f64>> {
        Unit::new_normalize(self.slope(1.0))
    }

    /// Spreads the control points over `base..tip` (parameters of the present chord).
    pub(super) fn spread(&mut self, base: f64, tip: f64) {
        let old = *self;
        self.origin += self.axis * (base * old.length);
        self.length = (tip - base) * old.length;
        for i in 0..self.n {
            let l = basis(self.n, base + (tip - base) * i as f64 / (self.n - 1) as f64);
            for k in 0..2 {
                self.values[k][i] = dot(&l, &old.values[k]);
            }
        }
    }

    /// Takes more control points on the same curve.
    pub(super) fn set_points(&mut self, n: usize) {
        let old = *self;
        self.n = n;
        for i in 0..n {
            let l = basis(old.n, i as f64 / (n - 1) as f64);
            for k in 0..2 {
                self.values[k][i] = dot(&l, &old.values[k]);
            }
        }
    }

    /// Gauss-Newton on the marks and the tips; false if the needle cannot be reconstructed.
    pub(super) fn fit(
        &mut self,
        views: &[View; 2],
        images: [&Planar; 2],
        systematic: f64,
        rounds: usize,
    ) -> bool {
        for _ in 0..rounds {
            let Some(step) = self.step(views, images, systematic) else {
                return false;
            };
            if step < 2e-7 {
                break;
            }
        }
        self.length > 0.0
    }

    fn step(&mut self, views: &[View; 2], images: [&Planar; 2], systematic: f64) -> Option<f64> {
        let mut a = Normal::identity() * 1e-30;
        let mut g = SVector::<f64, UNKNOWNS>::zeros();
        // A prior of 50 mm: no information, but the directions that no camera sees stay put.
        for i in 0..2 * MAX_POINTS {
            a[(i, i)] = 400.0;
        }
        a[(UNKNOWNS - 1, UNKNOWNS - 1)] = 400.0;
        let mut tips = [(0.0, 0.0, 0.0); 2];
        for k in 0..2 {
            let (view, image) = (&views[k], images[k]);
            let mut table = [0.0; TABLE];
            for (i, x) in table.iter_mut().enumerate() {
                let p = self.point(i as f64 / (TABLE - 1) as f64);
                *x = image.graph.local(view.project(&p)?.0).0;
            }
            for m in image.marks.iter().filter(|m| m.weight > 0.1) {
                let s = invert(&table, m.x)?;
                if !(-0.03..=1.1).contains(&s) {
                    continue;
                }
                let variance = image.variance(m);
                self.row(view, m.px, s, variance, &mut a, &mut g)?;
            }
            tips[k] = self.tip_row(view, image, systematic, &mut a, &mut g)?;
        }
        let c = a.cholesky()?;
        let x = c.solve(&g);
        self.cov = c.inverse();
        let along = x[UNKNOWNS - 1];
        self.tip_misfit = 0.0;
        for (e, by_length, w) in tips {
            self.tip_misfit += w * (e - by_length * along).powi(2);
        }
        for i in 0..self.n {
            self.values[0][i] += x[i];
            self.values[1][i] += x[MAX_POINTS + i];
        }
        let relative = (along / self.length).clamp(-0.5, 0.5);
        if relative.abs() > 0.0 {
            self.spread(0.0, 1.0 + relative);
        }
        let size = x.amax();
        size.is_finite().then_some(size)
    }

    /// One mark: its distance from the projected curve.
    fn row(
        &self,
        view: &View,
        px: Point2<f64>,
        s: f64,
        variance: f64,
        a: &mut Normal,
        g: &mut SVector<f64, UNKNOWNS>,
    ) -> Option<()> {
        let (at, j) = view.project_with_derivative(&self.point(s))?;
        let t = j * self.slope(s);
        let normal = Vector2::new(-t.y, t.x).try_normalize(0.0)?;
        let e = normal.dot(&(px - at.0));
        let across = normal.transpose() * j;
        let by = [(across * self.sides[0])[0], (across * self.sides[1])[0]];
        let l = basis(self.n, s);
        let w = 1.0 / variance;
        let mut row = [0.0; 2 * MAX_POINTS];
        for i in 0..self.n {
            row[i] = by[0] * l[i];
            row[MAX_POINTS + i] = by[1] * l[i];
        }
        for i in 0..2 * MAX_POINTS {
            if row[i] == 0.0 {
                continue;
            }
            let wi = w * row[i];
            g[i] += wi * e;
            for k in 0..2 * MAX_POINTS {
                a[(i, k)] += wi * row[k];
            }
        }
        Some(())
    }

    /// The tip along the projected tangent: residual, derivative by the length, weight.
    fn tip_row(
        &self,
        view: &View,
        image: &Planar,
        systematic: f64,
        a: &mut Normal,
        g: &mut SVector<f64, UNKNOWNS>,
    ) -> Option<(f64, f64, f64)> {
        let (at, j) = view.project_with_derivative(&self.point(1.0))?;
        let t = j * self.slope(1.0);
        let tangent = t.try_normalize(0.0)?;
        let along = tangent.dot(&image.graph.axis).abs().max(0.2);
        // An end is known less well than an edge along the whole shaft.
        let mut variance = image.tip_cov[(0, 0)] / (along * along) + (2.0 * systematic).powi(2);
        if image.tip_state != TipState::Measured {
            variance = variance * 9.0 + 0.25;
        }
        let e = tangent.dot(&(image.tip() - at.0));
        let across = tangent.transpose() * j;
        let w = 1.0 / variance;
        let l = basis(self.n, 1.0);
        let mut row = SVector::<f64, UNKNOWNS>::zeros();
        for i in 0..self.n {
            row[i] = (across * self.sides[0])[0] * l[i];
            row[MAX_POINTS + i] = (across * self.sides[1])[0] * l[i];
        }
        let by_length = tangent.dot(&t);
        row[UNKNOWNS - 1] = by_length;
        *g += row * (w * e);
        *a += row * row.transpose() * w;
        Some((e, by_length, w))
    }

    /// Covariance of the point at `s`; with the length's where `s` is 1.
    pub(super) fn covariance(&self, s: f64) -> Matrix3<f64> {
        let l = basis(self.n, s);
        let mut j = SMatrix::<f64, 3, UNKNOWNS>::zeros();
        for i in 0..self.n {
            j.set_column(i, &(self.sides[0] * l[i]));
            j.set_column(MAX_POINTS + i, &(self.sides[1] * l[i]));
        }
        if s >= 1.0 {
            j.set_column(UNKNOWNS - 1, &self.slope(1.0));
        }
        j * self.cov * j.transpose()
    }

    /// Standard deviation of the direction at the tip, per axis \[rad\].
    pub(super) fn direction_sigma(&self) -> f64 {
        let l = basis_slope(self.n, 1.0);
        let mut sum = 0.0;
        for k in 0..2 {
            for i in 0..self.n {
                for j in 0..self.n {
                    sum += l[i] * l[j] * self.cov[(k * MAX_POINTS + i, k * MAX_POINTS + j)];
                }
            }
        }
        (0.5 * sum.max(0.0)).sqrt() / self.length
    }
}

/// Two unit vectors across `axis`.
pub(super) fn sides(axis: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let helper = if axis.x.abs() < 0.8 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let a = axis.cross(&helper).normalize();
    (a, axis.cross(&a))
}

/// Where a table of growing values reaches `x`, on 0..1 and beyond by extrapolation.
fn invert(table: &[f64; TABLE], x: f64) -> Option<f64> {
    let mut i = 0;
    while i + 2 < TABLE && table[i + 1] < x {
        i += 1;
    }
    let step = table[i + 1] - table[i];
    (step > 1e-9).then(|| (i as f64 + (x - table[i]) / step) / (TABLE - 1) as f64)
}
