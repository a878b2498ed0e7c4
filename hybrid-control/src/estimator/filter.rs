//! The filter over the tip: position on the path, direction disturbance, bevel vector, and how
//! the tip answers a lateral force.

use nalgebra::{Matrix2, Rotation2, SMatrix, SVector, Vector2};

use super::unseen::{SlopeBy, Unseen};
use crate::settings::EstimatorSettings;

/// Numbers in the state.
pub(super) const N: usize = 8;
/// Where the tip's compliance stands in the state.
const COMPLIANCE: usize = 6;
/// Where the tip's yielding stands in the state.
const YIELDING: usize = 7;

/// Largest compliance \[rad/N\]: a tip that no force holds, as far as steps of millimetres show.
const MOST_COMPLIANT: f64 = 1.5;

/// What the rod says of the tip where it stands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct TipState {
    /// Slope of the shaft at the tip.
    pub(crate) slope: Vector2<f64>,
    /// Its derivative by the tip's position \[1/m\].
    pub(crate) slope_by: SlopeBy,
    /// Force of the path on the tip \[N\].
    pub(crate) force: Vector2<f64>,
    /// Its derivative by the tip's position \[N/m\].
    pub(crate) force_by_position: f64,
    /// What the base's motion across changed of the force, tip held \[N\].
    pub(crate) force_by_base: Vector2<f64>,
    /// Lateral force on a tip that bends a needle as much as one radian of cut angle does \[N\].
    pub(crate) force_of_angle: f64,
}

/// What a filter takes the tip for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Behaviour {
    /// Uncut tissue holds it: the path's force turns the cut by a compliance that is told, and the
    /// base moves it by cutting alone.
    Held,
    /// It answers forces, by how much is estimated.
    Free,
}

/// Gaussian state: lateral tip position c \[m\], slow direction disturbance b \[rad\], bevel
/// vector g in the frame of the bevel (along, across) \[rad\], compliance C \[rad/N\], yielding y.
///
/// A tip that uncut tissue holds cuts on where it points; a compliant one is turned by the force
/// F on it; one that yields (1: all) moves aside at once when the base does. The direction of
/// cutting is `slope + b + g - C F`; of a free tip `slope + b + (1 + C S) g - C F`, with S as
/// [`TipState::force_of_angle`], so that g means the same curvature, 2 g / lambda, for every C.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Filter {
    pub(crate) x: SVector<f64, N>,
    pub(crate) p: SMatrix<f64, N, N>,
    prior_size: f64,
    behaviour: Behaviour,
    /// What a sensor of the tip alone leaves open beside that.
    unseen: Option<Unseen>,
}

impl Filter {
    pub(crate) fn new(
        position: Vector2<f64>,
        behaviour: Behaviour,
        s: &EstimatorSettings,
        unseen: Option<Unseen>,
    ) -> Self {
        let size = s.cut_angle_deg.to_radians();
        let c = (s.start_sigma_mm * 1e-3).powi(2);
        let b = s.start_disturbance_deg.to_radians().powi(2);
        let along = (size * s.cut_angle_sigma).powi(2);
        let across = (size * s.cut_across_sigma).powi(2);
        let compliance = s.tip_compliance_deg_n.to_radians();
        let (by_force, by_base) = match behaviour {
            Behaviour::Held => (0.0, 0.0),
            Behaviour::Free => (
                s.tip_compliance_sigma_deg_n.to_radians(),
                s.tip_yielding_sigma,
            ),
        };
        let c = unseen.as_ref().map_or(c, Unseen::start_variance);
        Self {
            x: SVector::from([position.x, position.y, 0.0, 0.0, size, 0.0, compliance, 0.0]),
            p: SMatrix::from_diagonal(&SVector::from([
                c,
                c,
                b,
                b,
                along,
                across,
                by_force.powi(2),
                by_base.powi(2),
            ])),
            prior_size: size,
            behaviour,
            unseen,
        }
    }

    /// What a sensor of the tip alone leaves open.
    pub(crate) const fn unseen(&self) -> Option<&Unseen> {
        self.unseen.as_ref()
    }

    pub(crate) fn position(&self) -> Vector2<f64> {
        self.x.fixed_rows::<2>(0).into_owned()
    }

    pub(crate) fn disturbance(&self) -> Vector2<f64> {
        self.x.fixed_rows::<2>(2).into_owned()
    }

    pub(crate) fn bevel(&self) -> Vector2<f64> {
        self.x.fixed_rows::<2>(4).into_owned()
    }

    /// Turn of the cut by a lateral force on the tip \[rad/N\].
    pub(crate) fn compliance(&self) -> f64 {
        self.x[COMPLIANCE]
    }

    /// Share of the way that a tip held by nothing would go aside with the base.
    pub(crate) fn yielding(&self) -> f64 {
        self.x[YIELDING]
    }

    /// The direction that a bevel gives to a tip of this behaviour, for each radian of g.
    pub(crate) fn bevel_gain(&self, force_of_angle: f64) -> f64 {
        match self.behaviour {
            Behaviour::Held => 1.0,
            Behaviour::Free => 1.0 + self.compliance() * force_of_angle,
        }
    }

    /// The base moves across, then the cut advances by `advance` \[m\] with the bevel at
    /// `azimuth` \[rad\].
    pub(crate) fn propagate(
        &mut self,
        advance: f64,
        tip: &TipState,
        azimuth: f64,
        s: &EstimatorSettings,
    ) {
        let turn = *Rotation2::new(azimuth).matrix();
        let compliance = self.compliance();
        let size = self.bevel_gain(tip.force_of_angle);
        let bevel = turn * self.bevel();
        let direction = tip.slope + self.disturbance() + bevel * size - tip.force * compliance;
        let freed = -tip.force_by_base / tip.force_by_position.max(1.0);
        let moved = self.position() + freed * self.yielding() + direction * advance;
        self.x.fixed_rows_mut::<2>(0).copy_from(&moved);
        let mut f = SMatrix::<f64, N, N>::identity();
        let by_force = match self.behaviour {
            Behaviour::Held => 0.0,
            Behaviour::Free => (compliance * tip.force_by_position).clamp(0.0, 400.0),
        };
        let back = tip.slope_by.position.clamp(-200.0, 0.0) - by_force;
        let stay = (1.0 + advance * back).max(0.0);
        f.fixed_view_mut::<2, 2>(0, 0)
            .copy_from(&(Matrix2::identity() * stay));
        f.fixed_view_mut::<2, 2>(0, 2)
            .copy_from(&(Matrix2::identity() * advance));
        f.fixed_view_mut::<2, 2>(0, 4)
            .copy_from(&(turn * (advance * size)));
        f.fixed_view_mut::<2, 1>(0, COMPLIANCE)
            .copy_from(&((bevel * tip.force_of_angle - tip.force) * advance));
        f.fixed_view_mut::<2, 1>(0, YIELDING).copy_from(&freed);
        self.p = match &mut self.unseen {
            None => f * self.p * f.transpose(),
            Some(unseen) => unseen.propagate(&self.p, &f, &tip.slope_by, advance),
        };
        let walk =
            |deg_per: f64, over_mm: f64| deg_per.to_radians().powi(2) * advance / (over_mm * 1e-3);
        let q_c = s.cut_noise_deg.to_radians().powi(2) * 5e-3 * advance;
        let q_b = walk(s.disturbance_walk_deg, 10.0);
        let q_g = (self.prior_size * s.bevel_walk).powi(2) * advance / 15e-3;
        for i in 0..2 {
            self.p[(i, i)] += q_c;
            self.p[(i + 2, i + 2)] += q_b;
            self.p[(i + 4, i + 4)] += q_g;
        }
    }

    /// Takes in the tip's lateral position \[m\]; how likely it was, as a logarithm.
    pub(crate) fn measure_position(&mut self, measured: &Vector2<f64>, sigma: f64) -> f64 {
        let mut h = SMatrix::<f64, 2, N>::zeros();
        h[(0, 0)] = 1.0;
        h[(1, 1)] = 1.0;
        let field = self
            .unseen
            .as_ref()
            .map_or_else(Vector2::zeros, Unseen::place);
        let innovation = measured - self.position() - field;
        self.update(&h, None, &innovation, sigma)
    }

    /// Takes in the difference of the measured and the model's slope.
    pub(crate) fn measure_slope(&mut self, difference: &Vector2<f64>, by: &SlopeBy, sigma: f64) {
        let mut h = SMatrix::<f64, 2, N>::zeros();
        h[(0, 0)] = by.position;
        h[(1, 1)] = by.position;
        let field = self
            .unseen
            .as_ref()
            .map_or_else(Vector2::zeros, Unseen::axis);
        self.update(&h, Some(by), &(difference - field), sigma);
    }

    /// Takes in a measurement of the tip's place, or of its slope with what that depends on.
    fn update(
        &mut self,
        h: &SMatrix<f64, 2, N>,
        slope_by: Option<&SlopeBy>,
        innovation: &Vector2<f64>,
        sigma: f64,
    ) -> f64 {
        let likelihood = match &mut self.unseen {
            None => correct(&mut self.x, &mut self.p, h, innovation, sigma),
            Some(unseen) => {
                unseen.correct((&mut self.x, &mut self.p), h, slope_by, innovation, sigma)
            }
        };
        let Some(likelihood) = likelihood else {
            return 0.0;
        };
        self.floor_bevel();
        if self.behaviour == Behaviour::Free {
            self.x[COMPLIANCE] = self.x[COMPLIANCE].clamp(0.0, MOST_COMPLIANT);
            self.x[YIELDING] = self.x[YIELDING].clamp(0.0, 1.0);
        }
        likelihood
    }

    /// The bevel never counts as weaker than 30 % of its prior: a plan would ask for curvature
    /// that it does not dare to give.
    fn floor_bevel(&mut self) {
        let g = self.bevel();
        let floor = 0.3 * self.prior_size;
        let size = g.norm();
        if size < floor {
            let along = if size > 1e-9 { g / size } else { Vector2::x() };
            self.x.fixed_rows_mut::<2>(4).copy_from(&(along * floor));
        }
    }
}

/// Kalman's correction; how likely the measurement was, as a logarithm. Measurements far outside
/// their spread count less (Huber's weight at four sigma).
pub(super) fn correct<const D: usize>(
    x: &mut SVector<f64, D>,
    p: &mut SMatrix<f64, D, D>,
    h: &SMatrix<f64, 2, D>,
    innovation: &Vector2<f64>,
    sigma: f64,
) -> Option<f64> {
    let spread = h * *p * h.transpose();
    let expected = (spread.trace() * 0.5 + sigma * sigma).sqrt();
    let excess = (innovation.norm() / (4.0 * expected)).max(1.0);
    let noise = Matrix2::identity() * (sigma * sigma * excess * excess);
    let inverse = (spread + noise).try_inverse()?;
    let likelihood = -0.5 * (innovation.dot(&(inverse * innovation)) - inverse.determinant().ln());
    let gain: SMatrix<f64, D, 2> = *p * h.transpose() * inverse;
    *x += gain * innovation;
    let keep = SMatrix::<f64, D, D>::identity() - gain * h;
    *p = keep * *p * keep.transpose() + gain * noise * gain.transpose();
    *p = (*p + p.transpose()) * 0.5;
    Some(likelihood)
}

/// Noise of the direction in one image of a shaft that is seen well \[rad\].
const IMAGE_NOISE: f64 = 0.017;
/// How long errors beyond it last \[s\].
const LASTS: f64 = 1.5;

/// Standard deviation with which a direction counts that is one of many: what is beyond the noise
/// of an image lasts as long as so short a shaft is seen, and is not averaged away.
pub(crate) fn alone(sigma: f64, elapsed: f64) -> f64 {
    let lasting = (sigma * sigma - IMAGE_NOISE * IMAGE_NOISE).max(0.0).sqrt();
    let images = (LASTS / elapsed.clamp(1e-3, LASTS)).sqrt();
    sigma.min(IMAGE_NOISE).hypot(lasting * images)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lasts_counts_once_while_it_lasts() {
        let (period, images) = (1.0 / 30.0, 45);
        let together = |sigma: f64| alone(sigma, period) / f64::from(images).sqrt();
        // White noise is averaged.
        let white = 0.0035;
        assert!((together(white) - white / f64::from(images).sqrt()).abs() < 1e-12);
        // A short shaft's error is not.
        let short = 0.1;
        assert!((together(short) / short - 1.0).abs() < 0.02);
        // Nor is a single image worth less than it is.
        assert!((alone(short, LASTS) - short).abs() < 1e-12);
    }

    /// Fed with its own process, the filter finds the bevel vector once the bevel has turned.
    #[test]
    fn bevel_and_disturbance_separate_after_a_turn() {
        let s = EstimatorSettings::default();
        let mut filter = Filter::new(Vector2::zeros(), Behaviour::Held, &s, None);
        let (g, b) = (Vector2::new(0.022, 0.006), Vector2::new(-0.003, 0.002));
        let mut c = Vector2::zeros();
        for i in 0..1200 {
            let azimuth = if (i / 200) % 2 == 0 { 0.3 } else { 2.5 };
            let d = 0.05e-3;
            c += (Rotation2::new(azimuth) * g + b) * d;
            filter.propagate(d, &TipState::default(), azimuth, &s);
            filter.measure_position(&c, 0.05e-3);
        }
        assert!((filter.bevel() - g).norm() < 2e-3, "{}", filter.bevel());
        assert!((filter.disturbance() - b).norm() < 2e-3);
    }

    #[test]
    fn an_outlier_moves_little() {
        let s = EstimatorSettings::default();
        let mut filter = Filter::new(Vector2::zeros(), Behaviour::Held, &s, None);
        for _ in 0..20 {
            filter.measure_position(&Vector2::zeros(), 0.05e-3);
        }
        filter.measure_position(&Vector2::new(5e-3, 0.0), 0.05e-3);
        assert!(filter.position().norm() < 0.05e-3);
    }
}
