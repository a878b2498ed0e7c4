//! Tissue stiffness and the base's pose error, from the visible shape given the path.

use nalgebra::{Point3, SMatrix, SVector, Vector2};

use super::rod::{Rod, RodConstants};
use super::unseen::Unseen;
use super::{Moment, X, Y};
use crate::settings::EstimatorSettings;

/// Bounds of the stiffness per length \[N/m2\].
const BOUNDS: (f64, f64) = (5e2, 3e5);

/// Largest change of the logarithm in one fit.
const LARGEST_STEP: f64 = 0.15;

/// What neighbouring points share and the model lacks \[m\].
const MODEL_SIGMA: f64 = 0.05e-3;

/// Unknowns: log K, shift of the base (2) \[m\], tilt of the base (2) \[rad\].
type Information = SMatrix<f64, 5, 5>;

/// Recursive Gauss-Newton with a prior and a memory that fades.
#[derive(Clone, Debug)]
pub(super) struct StiffnessFit {
    prior: SVector<f64, 5>,
    prior_information: Information,
    information: Information,
    right: SVector<f64, 5>,
    value: SVector<f64, 5>,
    /// Pivot of the base about the entry, from a sensor of the tip alone \[rad\].
    pivot: Vector2<f64>,
    sigma: f64,
}

impl StiffnessFit {
    pub(super) fn new(s: &EstimatorSettings) -> Self {
        let shift = (s.base_shift_sigma_mm * 1e-3).max(1e-6).powi(-2);
        let tilt = s.base_tilt_sigma_deg.to_radians().max(1e-6).powi(-2);
        let k = s.stiffness_sigma.max(1e-3).powi(-2);
        let prior = SVector::from([s.stiffness_n_m2.ln(), 0.0, 0.0, 0.0, 0.0]);
        Self {
            prior,
            prior_information: Information::from_diagonal(&SVector::from([
                k, shift, shift, tilt, tilt,
            ])),
            information: Information::zeros(),
            right: SVector::zeros(),
            value: prior,
            pivot: Vector2::zeros(),
            sigma: s.stiffness_sigma,
        }
    }

    /// Standard deviation of log K.
    pub(super) fn sigma(&self) -> f64 {
        self.sigma
    }

    /// Estimated position error of the base \[m\].
    pub(super) fn base_shift(&self) -> Vector2<f64> {
        Vector2::new(self.value[1], self.value[2])
    }

    /// Estimated direction error of the base \[rad\].
    pub(super) fn base_tilt(&self) -> Vector2<f64> {
        Vector2::new(self.value[3], self.value[4])
    }

    /// Estimated pivot of the base about the entry \[rad\].
    pub(super) const fn base_pivot(&self) -> Vector2<f64> {
        self.pivot
    }

    /// Takes over what a sensor of the tip alone has told; changes the bed's stiffness.
    pub(super) fn adopt(&mut self, constants: &mut RodConstants, told: &Unseen) {
        let (shift, pivot) = told.support();
        let (log, sigma) = told.log_stiffness();
        self.value[0] = (self.prior[0] + log).clamp(BOUNDS.0.ln(), BOUNDS.1.ln());
        self.value.fixed_rows_mut::<2>(1).copy_from(&shift);
        self.pivot = pivot;
        self.sigma = sigma;
        constants.bed = self.value[0].exp();
    }

    /// One step with the shaft's points (insertion frame); changes the bed's stiffness.
    pub(super) fn fit(
        &mut self,
        constants: &mut RodConstants,
        moment: &Moment,
        shaft: impl Iterator<Item = (Point3<f64>, f64)>,
    ) {
        // Columns of the rod: actual x, y, unit tilt about the base, unit shift.
        let mut clamp = moment.clamp;
        clamp.w[2] = 0.0;
        let (mut rod, mut stiffer) = (Rod::default(), Rod::default());
        rod.solve(constants, &clamp, &moment.path);
        let more = RodConstants {
            bed: constants.bed * 1.05,
            ..*constants
        };
        stiffer.solve(&more, &clamp, &moment.path);
        let mut information = Information::zeros();
        let mut right = SVector::<f64, 5>::zeros();
        let mut count = 0.0;
        for (p, sigma) in shaft {
            let usable = p.iter().all(|x| x.is_finite()) && sigma > 0.0;
            if !usable || p.z > moment.path.tip_depth() || p.z < clamp.z {
                continue;
            }
            count += 1.0;
            let (w, w_more) = (rod.lateral(p.z), stiffer.lateral(p.z));
            let weight = 1.0 / (sigma * sigma + MODEL_SIGMA * MODEL_SIGMA);
            for (plane, measured) in [(X, p.x), (Y, p.y)] {
                let mut j = SVector::<f64, 5>::zeros();
                j[0] = (w_more[plane] - w[plane]) / 1.05_f64.ln();
                j[1 + plane] = w[3];
                j[3 + plane] = w[2];
                let residual = measured - w[plane] + j.dot(&self.value);
                information += j * j.transpose() * weight;
                right += j * (residual * weight);
            }
        }
        if count < 4.0 {
            return;
        }
        self.information = self.information * 0.8 + information;
        self.right = self.right * 0.8 + right;
        let total = self.information + self.prior_information;
        let Some(cholesky) = total.cholesky() else {
            return;
        };
        let wish = cholesky.solve(&(self.right + self.prior_information * self.prior));
        if !wish.iter().all(|x| x.is_finite()) {
            return;
        }
        let step = (wish[0] - self.value[0]).clamp(-LARGEST_STEP, LARGEST_STEP);
        let log = (self.value[0] + step).clamp(BOUNDS.0.ln(), BOUNDS.1.ln());
        // The base's error follows slowly: a jump of the base would look like a motion.
        self.value = self.value + (wish - self.value) * 0.3;
        self.value[0] = log;
        self.sigma = cholesky.inverse()[(0, 0)].sqrt();
        constants.bed = log.exp();
    }
}
