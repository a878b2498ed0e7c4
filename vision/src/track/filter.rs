//! The Kalman filter over a curve's control points and the speed of the tip.

use nalgebra::{SMatrix, SVector, Vector2};

use super::cholesky::Factor;
use super::curve::{Curve2, MOST, Weights, slopes, weights};

/// The curve's control points, then the tip's speed; what is left over is idle.
const STATES: usize = 2 * MOST + 1;
/// Pairs of control points, each counted once.
const PAIRS: usize = MOST * (MOST + 1) / 2;

/// Of the filter.
pub(super) type State = SVector<f64, STATES>;
type Covariance = SMatrix<f64, STATES, STATES>;

/// Curve, tip speed and their covariance.
#[derive(Clone, Debug)]
pub(super) struct CurveFilter {
    count: usize,
    state: State,
    covariance: Covariance,
    /// Information form during an update, and its vector.
    information: Covariance,
    pull: State,
}

/// What is known of a curve's change between two images.
#[derive(Clone, Copy, Debug, Default)]
pub struct Change {
    /// Time since \[s\].
    pub dt: f64,
    /// Parameter at which the new curve starts on the old one.
    pub start: f64,
    /// Advance of the tip along the curve by odometry \[px\], with its standard deviation.
    pub advance: Option<(f64, f64)>,
    /// Displacement of each control point by the base's motion \[px\].
    pub shifts: [Vector2<f64>; MOST],
    /// Unexplained change \[px\].
    pub walk: f64,
}

/// A measured displacement along a line through the curve.
#[derive(Clone, Copy, Debug)]
pub(super) struct Offset {
    /// Weights of the point on the predicted curve.
    pub weights: Weights,
    /// Unit direction of the line.
    pub direction: Vector2<f64>,
    /// Measured displacement from the predicted curve \[px\].
    pub value: f64,
    /// Variance of the measurement \[px2\].
    pub variance: f64,
    /// Products of two weights each, in the order of [`CurveFilter::solve`].
    products: [f64; PAIRS],
}

impl Offset {
    pub(super) fn new(
        weights: Weights,
        direction: Vector2<f64>,
        value: f64,
        variance: f64,
    ) -> Self {
        let mut products = [0.0; PAIRS];
        let mut pair = 0;
        for (i, wi) in weights.iter().enumerate() {
            for wj in weights.iter().take(i + 1) {
                products[pair] = wi * wj;
                pair += 1;
            }
        }
        Self {
            weights,
            direction,
            value,
            variance,
            products,
        }
    }
}

/// What measurements say of the state.
pub(super) struct Solution {
    /// Change of the state.
    pub change: State,
    /// Of the information matrix.
    factor: Factor<STATES>,
}

impl CurveFilter {
    /// A curve known up to smooth deformations: shifts of its ends by `loose` \[px\], bends in
    /// proportion to its length.
    pub(super) fn new(curve: &Curve2, loose: f64) -> Self {
        let count = curve.control_points().len();
        let mut state = State::zeros();
        for (i, p) in curve.control_points().iter().enumerate() {
            state.fixed_rows_mut::<2>(2 * i).copy_from(p);
        }
        let mut covariance = Covariance::zeros();
        covariance[(2 * count, 2 * count)] = 20_f64.powi(2);
        let mut filter = Self {
            count,
            state,
            covariance,
            information: Covariance::zeros(),
            pull: State::zeros(),
        };
        let length = curve.length();
        filter.loosen(&[
            loose,
            loose,
            0.02 * length,
            0.01 * length,
            0.003 * length,
            0.003 * length,
        ]);
        filter
    }

    /// Adds smooth lateral and longitudinal change: one standard deviation for each power of
    /// the parameter (about the curve's middle).
    fn loosen(&mut self, sigmas: &[f64; MOST]) {
        let last = (self.count - 1) as f64;
        for (power, sigma) in sigmas.iter().enumerate().take(self.count) {
            let mode = |i: usize| {
                let place = 2.0 * i as f64 / last - 1.0;
                (0..power).fold(1.0, |product, _| product * place)
            };
            for i in 0..self.count {
                for j in 0..self.count {
                    let term = sigma * sigma * mode(i) * mode(j);
                    self.covariance[(2 * i, 2 * j)] += term;
                    self.covariance[(2 * i + 1, 2 * j + 1)] += term;
                }
            }
        }
    }

    /// Place of the tip's speed in the state.
    const fn speed_at(&self) -> usize {
        2 * self.count
    }

    /// States in use.
    const fn states(&self) -> usize {
        2 * self.count + 1
    }

    /// The curve as estimated.
    pub(super) fn curve(&self) -> Curve2 {
        let mut points = [Vector2::zeros(); MOST];
        for (i, point) in points.iter_mut().enumerate().take(self.count) {
            *point = self.state.fixed_rows::<2>(2 * i).into_owned();
        }
        Curve2::new(self.count, points)
    }

    /// Speed of the tip along the curve, and its standard deviation \[px/s\].
    pub(super) fn speed(&self) -> (f64, f64) {
        let speed = self.speed_at();
        let variance = self.covariance[(speed, speed)];
        (self.state[speed], variance.max(0.0).sqrt())
    }

    /// Carries the state on to the next image: the curve grows at its tip, starts where it now
    /// comes into sight, moves with the base and walks.
    pub(super) fn predict(&mut self, change: &Change) {
        let speed = self.speed_at();
        let before = self.curve();
        let length = before.derivative(1.0).norm().max(1.0);
        if let (Some((advance, sigma)), true) = (change.advance, change.dt > 0.0) {
            self.state[speed] = advance / change.dt;
            self.covariance
                .fixed_view_mut::<1, STATES>(speed, 0)
                .fill(0.0);
            self.covariance
                .fixed_view_mut::<STATES, 1>(0, speed)
                .fill(0.0);
            self.covariance[(speed, speed)] = (sigma / change.dt).powi(2);
        }
        let growth = self.state[speed] * change.dt / length;
        let span = 1.0 + growth - change.start;
        let mut transition = Covariance::identity();
        let mut next = self.state;
        for i in 0..self.count {
            let share = i as f64 / (self.count - 1) as f64;
            let t = change.start + span * share;
            let row = weights(self.count, t);
            let outgrown = before.sum(&slopes(self.count, t)) * share * change.dt / length;
            let moved = before.sum(&row) + change.shifts[i];
            for axis in 0..2 {
                next[2 * i + axis] = moved[axis];
                for (j, weight) in row.iter().enumerate().take(self.count) {
                    transition[(2 * i + axis, 2 * j + axis)] = *weight;
                }
                transition[(2 * i + axis, speed)] = outgrown[axis];
            }
        }
        self.covariance = transition * self.covariance * transition.transpose();
        self.state = next;
        let walk = change.walk;
        self.loosen(&[walk, walk, 0.5 * walk, 0.3 * walk, 0.2 * walk, 0.2 * walk]);
        for i in 0..self.count {
            // Part of the base's motion that the fading towards the tip gets wrong.
            let doubt = 0.2 * change.shifts[i].norm_squared();
            self.covariance[(2 * i, 2 * i)] += doubt;
            self.covariance[(2 * i + 1, 2 * i + 1)] += doubt;
        }
        // The insertion speed changes by some px/s within a second.
        self.covariance[(speed, speed)] += 25.0 * change.dt;
    }

    /// Variance of the curve at `weights` along `direction` \[px2\].
    pub(super) fn variance(&self, weights: &Weights, direction: &Vector2<f64>) -> f64 {
        self.covariance_of(weights, direction, weights, direction)
    }

    /// Covariance of two points of the curve, each along its own direction \[px2\].
    pub(super) fn covariance_of(
        &self,
        weights: &Weights,
        direction: &Vector2<f64>,
        other_weights: &Weights,
        other_direction: &Vector2<f64>,
    ) -> f64 {
        let mut sum = 0.0;
        for i in 0..self.count {
            for j in 0..self.count {
                let block = self.covariance.fixed_view::<2, 2>(2 * i, 2 * j);
                sum += weights[i] * other_weights[j] * direction.dot(&(block * other_direction));
            }
        }
        sum
    }

    /// Starts an update from independent measurements. The needle bends by no more than about
    /// `curvature` \[1/px\], which is what keeps a short shaft straight; of what that says, `share`
    /// counts.
    pub(super) fn begin(&mut self, curvature: f64, share: f64) -> bool {
        let Some(factor) = Factor::new(&self.covariance, self.states()) else {
            return false;
        };
        self.information = factor.inverse();
        self.pull = State::zeros();
        let spacing = self.curve().derivative(1.0).norm() / (self.count - 1) as f64;
        let weight = share / (curvature * spacing * spacing).powi(2).max(1e-6);
        let bend = [1.0, -2.0, 1.0];
        for first in 0..self.count - 2 {
            for axis in 0..2 {
                let at = |k: usize| 2 * (first + k) + axis;
                let bent: f64 = (0..3).map(|k| bend[k] * self.state[at(k)]).sum();
                for a in 0..3 {
                    self.pull[at(a)] -= weight * bend[a] * bent;
                    for b in 0..3 {
                        self.information[(at(a), at(b))] += weight * bend[a] * bend[b];
                    }
                }
            }
        }
        true
    }

    /// Adds measurements to what [`Self::begin`] prepared and solves: each by its share, their
    /// deviations taken as `scale` times what they state. The filter itself stays as it is.
    pub(super) fn solve(&self, offsets: &[Offset], shares: &[f64], scale: f64) -> Option<Solution> {
        let mut information = self.information;
        let mut pull = self.pull;
        // Of the symmetric sum the lower half is filled, which is what is factored.
        // A row is a place's weights times a direction: so there is a sum for each pair of weights
        // and each pair of axes.
        let mut sums = [[0.0; PAIRS]; 3];
        let mut pulls = [[0.0; MOST]; 2];
        let terms = offsets.iter().zip(shares);
        let terms = terms.filter(|(_, share)| **share > 0.0);
        let terms = terms.map(|(o, share)| (o, share / (o.variance * scale * scale)));
        match self.count {
            4 => accumulate::<4, 10>(terms, &mut sums, &mut pulls),
            5 => accumulate::<5, 15>(terms, &mut sums, &mut pulls),
            _ => accumulate::<MOST, PAIRS>(terms, &mut sums, &mut pulls),
        }
        let mut pair = 0;
        for i in 0..self.count {
            for j in 0..=i {
                information[(2 * i, 2 * j)] += sums[0][pair];
                information[(2 * i + 1, 2 * j)] += sums[1][pair];
                if i > j {
                    information[(2 * i, 2 * j + 1)] += sums[1][pair];
                }
                information[(2 * i + 1, 2 * j + 1)] += sums[2][pair];
                pair += 1;
            }
            pull[2 * i] += pulls[0][i];
            pull[2 * i + 1] += pulls[1][i];
        }
        let factor = Factor::new(&information, self.states())?;
        Some(Solution {
            change: factor.solve(&pull),
            factor,
        })
    }

    /// Takes a solution over.
    pub(super) fn accept(&mut self, solution: &Solution) {
        self.state += solution.change;
        self.covariance = solution.factor.inverse();
    }

    /// One scalar measurement.
    pub(super) fn update(&mut self, offset: &Offset) {
        let mut row = State::zeros();
        for i in 0..self.count {
            row[2 * i] = offset.weights[i] * offset.direction.x;
            row[2 * i + 1] = offset.weights[i] * offset.direction.y;
        }
        let cross = self.covariance * row;
        let gain = cross / (row.dot(&cross) + offset.variance);
        self.state += gain * offset.value;
        self.covariance -= gain * cross.transpose();
        self.covariance = 0.5 * (self.covariance + self.covariance.transpose());
    }

    /// Forgets where along its axis the tip is, up to `sigma` \[px\].
    pub(super) fn free_tip(&mut self, sigma: f64) {
        let curve = self.curve();
        let mut outward = State::zeros();
        for i in 0..self.count {
            let share = i as f64 / (self.count - 1) as f64;
            let tangent = curve.derivative(share) / curve.derivative(1.0).norm();
            outward
                .fixed_rows_mut::<2>(2 * i)
                .copy_from(&(tangent * share * sigma));
        }
        self.covariance += outward * outward.transpose();
    }
}

/// Adds weighted measurements up: `P` products of `N` weights by pairs of axes, and what draws at
/// the control points by axes. Both numbers are known when this is compiled: it is called a lot.
fn accumulate<'a, const N: usize, const P: usize>(
    terms: impl Iterator<Item = (&'a Offset, f64)>,
    sums: &mut [[f64; PAIRS]; 3],
    pulls: &mut [[f64; MOST]; 2],
) {
    let mut squares = [[0.0; P]; 3];
    let mut drawn = [[0.0; N]; 2];
    for (offset, weight) in terms {
        let (x, y) = (offset.direction.x, offset.direction.y);
        let axes = [weight * x * x, weight * x * y, weight * y * y];
        for (sums, axis) in squares.iter_mut().zip(axes) {
            for (sum, product) in sums.iter_mut().zip(&offset.products) {
                *sum += axis * product;
            }
        }
        let pulled = [weight * offset.value * x, weight * offset.value * y];
        for (sums, pulled) in drawn.iter_mut().zip(pulled) {
            for (sum, wi) in sums.iter_mut().zip(&offset.weights) {
                *sum += pulled * wi;
            }
        }
    }
    for (to, from) in sums.iter_mut().zip(squares) {
        to[..P].copy_from_slice(&from);
    }
    for (to, from) in pulls.iter_mut().zip(drawn) {
        to[..N].copy_from_slice(&from);
    }
}
