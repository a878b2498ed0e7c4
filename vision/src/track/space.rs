//! The needle in space: one polynomial curve fitted to both images through refracted rays.

use nalgebra::{Matrix2x3, SMatrix, SVector, Vector2, Vector3};

use super::cholesky::Factor;
use super::curve::{Curve2, MOST, Weights, normal, slopes, weights};
use super::filter::CurveFilter;
use crate::camera::View;

const STATES: usize = 3 * MOST;
/// Measurements of one image: the offset of each control point, and the tip along its axis.
const ROWS: usize = MOST + 1;

type State = SVector<f64, STATES>;
type Information = SMatrix<f64, STATES, STATES>;

/// Error of a curve in one image that stays from image to image \[px\], in images 640 wide: a
/// highlight along one side, uneven light, and that curves in space and in images cannot both be
/// polynomials. A filter would average it away; so it counts here.
const LASTING: f64 = 0.02;
/// The same of a bevelled tip along its axis, relative to the bevel's length: its silhouette as
/// modelled is off by up to 0.23 px of 6.3 px, depending on how it is turned.
const LASTING_BEVEL: f64 = 0.025;
/// How firmly parameters are spaced evenly; it shapes nothing \[m\].
const SPACING: f64 = 5e-4;

/// What the errors that stay from image to image are in proportion to.
pub(super) struct Lasting {
    /// Pixels for one pixel of an image 640 wide.
    pub px: f64,
    /// Length of the bevel \[m\].
    pub bevel: f64,
    /// Error of a tip that tapers, along the axis \[m\].
    pub taper: f64,
}

/// A polynomial curve in the stereo frame with its covariance.
#[derive(Clone, Debug)]
pub(super) struct Curve3 {
    count: usize,
    points: [Vector3<f64>; MOST],
    covariance: Information,
    /// Disagreement of the two tips along the needle \[px\].
    pub epipolar: f64,
}

impl Curve3 {
    /// A curve through points, not yet fitted.
    pub(super) fn through(count: usize, points: [Vector3<f64>; MOST]) -> Self {
        Self {
            count,
            points,
            covariance: Information::identity(),
            epipolar: 0.0,
        }
    }

    pub(super) fn control_points(&self) -> &[Vector3<f64>] {
        self.points.get(..self.count).unwrap_or_default()
    }

    fn sum(&self, weights: &Weights) -> Vector3<f64> {
        self.control_points()
            .iter()
            .zip(weights)
            .fold(Vector3::zeros(), |sum, (p, w)| sum + p * *w)
    }

    pub(super) fn at(&self, t: f64) -> Vector3<f64> {
        self.sum(&weights(self.count, t))
    }

    pub(super) fn derivative(&self, t: f64) -> Vector3<f64> {
        self.sum(&slopes(self.count, t))
    }

    /// Covariance of two weighted sums of the control points \[m2\].
    fn covariance_between(&self, left: &Weights, right: &Weights) -> SMatrix<f64, 3, 3> {
        let mut sum = SMatrix::zeros();
        for i in 0..self.count {
            for j in 0..self.count {
                sum += self.covariance.fixed_view::<3, 3>(3 * i, 3 * j) * (left[i] * right[j]);
            }
        }
        sum
    }

    /// Covariance of the point at `t` \[m2\].
    pub(super) fn point_covariance(&self, t: f64) -> SMatrix<f64, 3, 3> {
        let row = weights(self.count, t);
        self.covariance_between(&row, &row)
    }

    /// Covariance of the derivative at `t` \[m2\].
    pub(super) fn slope_covariance(&self, t: f64) -> SMatrix<f64, 3, 3> {
        let row = slopes(self.count, t);
        self.covariance_between(&row, &row)
    }

    /// Moves control points along.
    pub(super) fn shift(&mut self, shifts: &[Vector3<f64>; MOST]) {
        for (point, shift) in self.points.iter_mut().zip(shifts) {
            *point += shift;
        }
    }

    /// Lengthens the curve at its tip, its parameters evenly spaced again; `sigma` is the doubt
    /// of the length, `walk` that of the place \[m\].
    pub(super) fn grow(&mut self, length: f64, sigma: f64, walk: f64) {
        let slope = self.derivative(1.0);
        let speed = slope.norm();
        if speed <= 0.0 {
            return;
        }
        let old = self.clone();
        let last = (self.count - 1) as f64;
        let share = |i: usize| i as f64 / last;
        let mut rows = [[0.0; MOST]; MOST];
        for (i, row) in rows.iter_mut().enumerate().take(self.count) {
            *row = weights(self.count, share(i) * (1.0 + length / speed));
            self.points[i] = old.sum(row);
        }
        let outward = slope * (sigma / speed);
        let along = outward * outward.transpose();
        for i in 0..self.count {
            for j in 0..self.count {
                let mut sum = old.covariance_between(&rows[i], &rows[j]);
                sum += along * (share(i) * share(j));
                // The curve shifts and turns about its middle.
                let turning = (2.0 * share(i) - 1.0) * (2.0 * share(j) - 1.0);
                sum += SMatrix::<f64, 3, 3>::identity() * (walk * walk * (1.0 + turning));
                self.covariance
                    .fixed_view_mut::<3, 3>(3 * i, 3 * j)
                    .copy_from(&sum);
            }
        }
    }

    /// Fits the curve to both images; `false` where the images do not determine it.
    pub(super) fn fit(
        &mut self,
        views: &[View; 2],
        filters: [&CurveFilter; 2],
        lasting: &Lasting,
        rounds: usize,
    ) -> bool {
        let curves = filters.map(CurveFilter::curve);
        let mut last = None;
        for _ in 0..rounds {
            let mut equations = Normal::new(self);
            for ((view, filter), curve) in views.iter().zip(filters).zip(&curves) {
                if equations
                    .image(self, view, filter, curve, lasting)
                    .is_none()
                {
                    return false;
                }
            }
            let Some(factor) = Factor::new(&equations.information, 3 * self.count) else {
                return false;
            };
            let step = factor.solve(&equations.pull);
            last = Some(factor);
            for (i, point) in self.points.iter_mut().enumerate().take(self.count) {
                *point += step.fixed_rows::<3>(3 * i);
            }
            let moved = step.amax();
            if !moved.is_finite() || moved > 0.05 {
                return false;
            }
            // Rays bend by so little on the way that what is left is its square over the distance.
            if moved < 4e-6 {
                break;
            }
        }
        if let Some(factor) = last {
            self.covariance = factor.inverse();
        }
        self.epipolar = self.disagreement(views, &curves).unwrap_or(f64::INFINITY);
        true
    }

    /// Half the difference of the tips along the needle, between image and projection \[px\].
    fn disagreement(&self, views: &[View; 2], curves: &[Curve2; 2]) -> Option<f64> {
        let tip = self.at(1.0);
        let mut along = [0.0; 2];
        for ((along, view), curve) in along.iter_mut().zip(views).zip(curves) {
            let px = view.project(&tip)?.0.coords;
            *along = (px - curve.tip()).dot(&curve.derivative(1.0).normalize());
        }
        Some(along[0].abs().max(along[1].abs()))
    }
}

/// Normal equations of one round.
struct Normal {
    count: usize,
    information: Information,
    pull: State,
}

impl Normal {
    fn new(curve: &Curve3) -> Self {
        let count = curve.count;
        let mut normal = Self {
            count,
            information: Information::zeros(),
            pull: State::zeros(),
        };
        normal.space(curve);
        normal
    }

    /// Control points are spread evenly along the chord.
    fn space(&mut self, curve: &Curve3) {
        let (Some(first), Some(last)) = (
            curve.control_points().first(),
            curve.control_points().last(),
        ) else {
            return;
        };
        let Some(chord) = (last - first).try_normalize(1e-9) else {
            return;
        };
        let weight = 1.0 / (SPACING * SPACING);
        let end = self.count - 1;
        for i in 1..end {
            let share = i as f64 / end as f64;
            let even = first + (last - first) * share;
            let residual = chord.dot(&(even - curve.points[i]));
            let parts = [(i, 1.0), (0, share - 1.0), (end, -share)];
            for (a, wa) in parts {
                for axis in 0..3 {
                    self.pull[3 * a + axis] += weight * wa * chord[axis] * residual;
                    for (b, wb) in parts {
                        for other in 0..3 {
                            self.information[(3 * a + axis, 3 * b + other)] +=
                                weight * wa * wb * chord[axis] * chord[other];
                        }
                    }
                }
            }
        }
    }

    /// Adds one image's offsets and tip.
    fn image(
        &mut self,
        curve: &Curve3,
        view: &View,
        filter: &CurveFilter,
        seen: &Curve2,
        lasting: &Lasting,
    ) -> Option<()> {
        let count = self.count;
        let mut row_weights = [[0.0; MOST]; ROWS];
        let mut directions = [Vector2::zeros(); ROWS];
        let mut residuals = [0.0; ROWS];
        let mut jacobians = [Matrix2x3::zeros(); ROWS];
        for i in 0..count {
            let (px, jacobian) = view.project_with_derivative(&curve.points[i])?;
            let px = px.0.coords;
            let t = nearest(seen, px, i as f64 / (count - 1) as f64);
            let tangent = seen.derivative(t).try_normalize(1e-9)?;
            directions[i] = normal(&tangent);
            row_weights[i] = weights(count, t);
            residuals[i] = directions[i].dot(&(seen.at(t) - px));
            jacobians[i] = jacobian;
            if i + 1 == count {
                directions[count] = seen.derivative(1.0).try_normalize(1e-9)?;
                row_weights[count] = weights(count, 1.0);
                residuals[count] = directions[count].dot(&(seen.tip() - px));
                jacobians[count] = jacobian;
            }
            if i == 0 {
                self.hold_start(&jacobian, &tangent, tangent.dot(&(seen.at(0.0) - px)));
            }
        }
        let mut covariance = SMatrix::<f64, ROWS, ROWS>::identity();
        for a in 0..=count {
            for b in 0..=a {
                let c = filter.covariance_of(
                    &row_weights[a],
                    &directions[a],
                    &row_weights[b],
                    &directions[b],
                );
                covariance[(a, b)] = c;
                covariance[(b, a)] = c;
            }
            covariance[(a, a)] += (LASTING * lasting.px).powi(2);
        }
        let axis = curve.derivative(1.0).normalize();
        let along = (LASTING_BEVEL * lasting.bevel).hypot(lasting.taper);
        let along_px = (jacobians[count] * axis).norm() * along;
        covariance[(count, count)] += along_px.powi(2);
        let inverse = Factor::new(&covariance, count + 1)?.inverse();
        for a in 0..=count {
            let (pa, ra) = block(a, count, &directions, &jacobians);
            for b in 0..=count {
                let (pb, rb) = block(b, count, &directions, &jacobians);
                let weight = inverse[(a, b)];
                for axis in 0..3 {
                    self.pull[3 * pa + axis] += weight * ra[axis] * residuals[b];
                    for other in 0..3 {
                        self.information[(3 * pa + axis, 3 * pb + other)] +=
                            weight * ra[axis] * rb[other];
                    }
                }
            }
        }
        Some(())
    }

    /// The start is where the needle comes into sight, which is no property of the needle: loose.
    fn hold_start(&mut self, jacobian: &Matrix2x3<f64>, tangent: &Vector2<f64>, residual: f64) {
        /// Firmness \[px\].
        const START: f64 = 2.0;
        let row = jacobian.transpose() * tangent / START;
        for axis in 0..3 {
            self.pull[axis] += row[axis] * residual / START;
            for other in 0..3 {
                self.information[(axis, other)] += row[axis] * row[other];
            }
        }
    }
}

/// Control point that a row acts on, and the row's derivative by it.
fn block(
    row: usize,
    count: usize,
    directions: &[Vector2<f64>; ROWS],
    jacobians: &[Matrix2x3<f64>; ROWS],
) -> (usize, Vector3<f64>) {
    let point = row.min(count - 1);
    (point, jacobians[row].transpose() * directions[row])
}

/// Parameter of the point of `curve` nearest to `px`, sought from `t`.
fn nearest(curve: &Curve2, px: Vector2<f64>, mut t: f64) -> f64 {
    for _ in 0..4 {
        let slope = curve.derivative(t);
        let step = (px - curve.at(t)).dot(&slope) / slope.norm_squared().max(1e-9);
        t = (t + step).clamp(-0.3, 1.3);
        if step.abs() < 1e-6 {
            break;
        }
    }
    t
}
