//! The filter over the tip: position on the path, direction disturbance, bevel vector.

use nalgebra::{Matrix2, Matrix2x6, Matrix6, Rotation2, SMatrix, Vector2, Vector6};

use crate::settings::EstimatorSettings;

/// Gaussian state: lateral tip position c \[m\], slow direction disturbance b \[rad\], bevel
/// vector g in the frame of the bevel (along, across) \[rad\].
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Filter {
    pub(crate) x: Vector6<f64>,
    pub(crate) p: Matrix6<f64>,
    prior_size: f64,
}

impl Filter {
    pub(crate) fn new(position: Vector2<f64>, s: &EstimatorSettings) -> Self {
        let size = s.cut_angle_deg.to_radians();
        let c = (s.start_sigma_mm * 1e-3).powi(2);
        let b = s.start_disturbance_deg.to_radians().powi(2);
        let along = (size * s.cut_angle_sigma).powi(2);
        let across = (size * s.cut_across_sigma).powi(2);
        Self {
            x: Vector6::new(position.x, position.y, 0.0, 0.0, size, 0.0),
            p: Matrix6::from_diagonal(&Vector6::new(c, c, b, b, along, across)),
            prior_size: size,
        }
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

    /// The cut advances by `advance` \[m\] while the tip's slope is `slope`, with the bevel at
    /// `azimuth` \[rad\]; `slope_by_position` is the slope's derivative by the tip's position
    /// \[1/m\].
    pub(crate) fn propagate(
        &mut self,
        advance: f64,
        slope: &Vector2<f64>,
        slope_by_position: f64,
        azimuth: f64,
        s: &EstimatorSettings,
    ) {
        let turn = *Rotation2::new(azimuth).matrix();
        let direction = slope + self.disturbance() + turn * self.bevel();
        let moved = self.position() + direction * advance;
        self.x.fixed_rows_mut::<2>(0).copy_from(&moved);
        let mut f = Matrix6::identity();
        let stay = 1.0 + advance * slope_by_position.clamp(-200.0, 0.0);
        f.fixed_view_mut::<2, 2>(0, 0)
            .copy_from(&(Matrix2::identity() * stay));
        f.fixed_view_mut::<2, 2>(0, 2)
            .copy_from(&(Matrix2::identity() * advance));
        f.fixed_view_mut::<2, 2>(0, 4).copy_from(&(turn * advance));
        self.p = f * self.p * f.transpose();
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

    /// Takes in the tip's lateral position \[m\].
    pub(crate) fn measure_position(&mut self, measured: &Vector2<f64>, sigma: f64) {
        let mut h = Matrix2x6::zeros();
        h[(0, 0)] = 1.0;
        h[(1, 1)] = 1.0;
        let innovation = measured - self.position();
        self.update(&h, &innovation, sigma);
    }

    /// Takes in the difference of the measured and the model's slope.
    pub(crate) fn measure_slope(
        &mut self,
        difference: &Vector2<f64>,
        slope_by_position: f64,
        sigma: f64,
    ) {
        let mut h = Matrix2x6::zeros();
        h[(0, 0)] = slope_by_position;
        h[(1, 1)] = slope_by_position;
        self.update(&h, difference, sigma);
    }

    /// Measurements far outside their spread count less (Huber's weight at four sigma).
    fn update(&mut self, h: &Matrix2x6<f64>, innovation: &Vector2<f64>, sigma: f64) {
        let spread = h * self.p * h.transpose();
        let expected = (spread.trace() * 0.5 + sigma * sigma).sqrt();
        let excess = (innovation.norm() / (4.0 * expected)).max(1.0);
        let noise = Matrix2::identity() * (sigma * sigma * excess * excess);
        let Some(inverse) = (spread + noise).try_inverse() else {
            return;
        };
        let gain: SMatrix<f64, 6, 2> = self.p * h.transpose() * inverse;
        self.x += gain * innovation;
        let keep = Matrix6::identity() - gain * h;
        self.p = keep * self.p * keep.transpose() + gain * noise * gain.transpose();
        self.p = (self.p + self.p.transpose()) * 0.5;
        self.floor_bevel();
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
        let mut filter = Filter::new(Vector2::zeros(), &s);
        let (g, b) = (Vector2::new(0.022, 0.006), Vector2::new(-0.003, 0.002));
        let mut c = Vector2::zeros();
        for i in 0..1200 {
            let azimuth = if (i / 200) % 2 == 0 { 0.3 } else { 2.5 };
            let d = 0.05e-3;
            c += (Rotation2::new(azimuth) * g + b) * d;
            filter.propagate(d, &Vector2::zeros(), 0.0, azimuth, &s);
            filter.measure_position(&c, 0.05e-3);
        }
        assert!((filter.bevel() - g).norm() < 2e-3, "{}", filter.bevel());
        assert!((filter.disturbance() - b).norm() < 2e-3);
    }

    #[test]
    fn an_outlier_moves_little() {
        let s = EstimatorSettings::default();
        let mut filter = Filter::new(Vector2::zeros(), &s);
        for _ in 0..20 {
            filter.measure_position(&Vector2::zeros(), 0.05e-3);
        }
        filter.measure_position(&Vector2::new(5e-3, 0.0), 0.05e-3);
        assert!(filter.position().norm() < 0.05e-3);
    }
}
