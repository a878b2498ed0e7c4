//! Curvature at a few areas to the needle's shape, with what is not known of it.
//!
//! Between its areas the curvature is a Gaussian process along the needle (Matern, 5/2), which interpolates
//! it and says how well; towards the tip, which nothing bends, it fades. All is linear in the measured
//! curvatures but the last step, the integration of turns. Errors are carried through that to first
//! order in the slope: small turns at an arc length shift what lies beyond by their lever.

use hybrid_control::TipSensor;
use nalgebra::{DMatrix, DVector, Point3, Rotation2, Unit, UnitQuaternion, Vector2, Vector3};

use super::{Calibration, FibreError};
use crate::config::{Config, Fbg};

/// Steps of the integration \[m\]: curvature hardly changes over a millimetre.
const STEP: f64 = 1e-3;
/// Spacing of the points that are told \[m\].
const SPACING: f64 = 5e-3;
/// Standard deviation of the curvature at the tip about its natural one \[1/m\]: a load on the bevel acts
/// less than 2 mm ahead.
const TIP: f64 = 0.1;

/// What is told of one point of the needle, or of its tip's direction.
#[derive(Clone, Debug)]
struct Told {
    /// By the curvature of each area: offset across \[m2\], or slope \[m\].
    by: DVector<f64>,
    /// Variance that the curvature between the areas leaves \[m2\], \[rad2\].
    between: f64,
}

/// Fibres and what is between them.
#[derive(Clone, Debug)]
pub struct FibreShape {
    calibration: Calibration,
    /// Length of a step \[m\].
    step: f64,
    /// Curvature beside the natural one at the ends of the steps, by that of the areas.
    weights: DMatrix<f64>,
    /// Points that are told, by the number of their step, and the tip.
    points: Vec<(usize, Told)>,
    tip: Told,
    slope: Told,
    natural: Vector2<f64>,
    /// Standard deviation of the curvature, and the way over which it changes \[1/m, m\].
    curvature: (f64, f64),
    /// Whether lasting errors are estimated beside the tip, and stated in no measurement of it.
    lasting: bool,
    /// Turn of the fibres' frame in the needle's \[rad\], and its standard deviation.
    roll: (f64, f64),
    /// Variance of each area's curvature by noise and by lasting errors of wavelengths \[1/m2\].
    noise: Vec<f64>,
    drift: Vec<f64>,
    /// Standard deviation of each area's factor.
    gain: Vec<f64>,
}

/// A bent needle in the base's frame; kept to be filled again.
#[derive(Clone, Debug)]
pub struct Bent {
    /// Points from the base on, each with its standard deviation across \[m\].
    pub points: Vec<(Point3<f64>, f64)>,
    /// O, the shaft's end.
    pub tip: Point3<f64>,
    /// Standard deviation of O across \[m\].
    pub tip_sigma: f64,
    /// The tip's axis.
    pub direction: Unit<Vector3<f64>>,
    /// Its standard deviation, per axis \[rad\].
    pub direction_sigma: f64,
    curvature: Vec<Vector2<f64>>,
    square: Vec<f64>,
}

impl Default for Bent {
    fn default() -> Self {
        Self {
            points: Vec::new(),
            tip: Point3::origin(),
            tip_sigma: 0.0,
            direction: Vector3::z_axis(),
            direction_sigma: 0.0,
            curvature: Vec::new(),
            square: Vec::new(),
        }
    }
}

/// Matern's correlation (5/2) over a distance in units of its length.
fn correlation(distance: f64) -> f64 {
    let x = 5.0_f64.sqrt() * distance.abs();
    (1.0 + x + x * x / 3.0) * (-x).exp()
}

impl FibreShape {
    /// What `config` says of the fibres in its needle.
    ///
    /// # Errors
    /// The calibration cannot be used, or is of another needle.
    pub fn of(config: &Config) -> Result<Self, FibreError> {
        let calibration = Calibration::of(&config.fbg)?;
        Self::new(calibration, &config.fbg, config.needle.length_mm * 1e-3)
    }

    /// Fibres in a needle of `length` from its base to O \[m\].
    ///
    /// # Errors
    /// An area that is not in the needle.
    pub fn new(calibration: Calibration, fbg: &Fbg, length: f64) -> Result<Self, FibreError> {
        for area in &calibration.areas {
            if !(0.0..=length).contains(&area.from_tip) {
                return Err(FibreError::Config {
                    key: "needle.length_mm",
                    problem: format!(
                        "an active area lies {:.1} mm from the tip of a needle of {:.1} mm: expected the needle of \
                         fbg.calibration, or fbg.areas_mm of this one",
                        area.from_tip * 1e3,
                        length * 1e3
                    ),
                });
            }
        }
        let areas = &calibration.areas;
        let square = |sigma_pm: f64| -> Vec<f64> {
            let of = |area| calibration.variance(area, sigma_pm * 1e-3);
            areas.iter().map(of).collect()
        };
        let (noise, drift) = (square(fbg.noise_pm), square(fbg.drift_pm));
        let steps = (length / STEP).round().max(1.0);
        let step = length / steps;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some hundred steps"
        )]
        let steps = steps as usize;
        let field = Field::new(&calibration, fbg, length, step, steps, &noise, &drift);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a few steps"
        )]
        let every = (SPACING / step).round().max(1.0) as usize;
        let points = (every..steps)
            .step_by(every)
            .map(|k| (k, field.told(|s| (k as f64 * step - s).max(0.0))))
            .collect();
        Ok(Self {
            tip: field.told(|s| length - s),
            slope: field.told(|_| 1.0),
            points,
            weights: field.weights,
            step,
            natural: Vector2::from(fbg.natural_curvature_per_m),
            curvature: (fbg.curvature_sigma_per_m, fbg.curvature_length_mm * 1e-3),
            lasting: fbg.lasting,
            roll: (fbg.roll_deg.to_radians(), fbg.roll_sigma_deg.to_radians()),
            noise,
            drift,
            gain: areas
                .iter()
                .map(|area| fbg.gain_sigma / area.weight.sqrt())
                .collect(),
            calibration,
        })
    }

    /// How shifts make curvature.
    pub const fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// What the estimator is told of lasting errors: those of a needle that bends as it may.
    pub fn tip_sensor(&self) -> TipSensor {
        let (curvature, length) = self.curvature;
        let square = self.drift.iter().zip(&self.gain);
        let square: Vec<f64> = square
            .map(|(d, gain)| d + (gain * curvature).powi(2))
            .collect();
        let turn = curvature * length;
        TipSensor {
            place_bias: self.tip.sigma(&square, self.roll.1 * turn * length),
            axis_bias: self.slope.sigma(&square, self.roll.1 * turn),
            length,
        }
    }

    /// The shape by a reading's shifts \[nm\], where the fibres' frame is turned by what has a standard deviation
    /// of `turned` \[rad\] in this reading; nothing where a grating was not read.
    pub fn bend(&self, shifts_nm: &[f64], turned: f64, bent: &mut Bent) -> Option<()> {
        let areas = self.calibration.areas.len();
        if shifts_nm.len() != areas * self.calibration.channels {
            return None;
        }
        bent.curvature.clear();
        bent.square.clear();
        for area in 0..areas {
            let turn = self.calibration.curvature(area, shifts_nm)?;
            bent.square.push(
                self.noise[area] + self.drift[area] + self.gain[area].powi(2) * turn.norm_squared(),
            );
            bent.curvature.push(turn);
        }
        self.integrate(turned, bent);
        Some(())
    }

    /// Turns step by step from the base to the tip.
    fn integrate(&self, turned: f64, bent: &mut Bent) {
        let into_needle = Rotation2::new(self.roll.0);
        let at = |k: usize| -> Vector2<f64> {
            let row = self.weights.row(k);
            let beside: Vector2<f64> = row.iter().zip(&bent.curvature).map(|(w, c)| c * *w).sum();
            into_needle * (self.natural + beside)
        };
        let (mut rotation, mut place) = (UnitQuaternion::identity(), Vector3::zeros());
        let mut told = self.points.iter().peekable();
        bent.points.clear();
        let mut before = at(0);
        for k in 1..self.weights.nrows() {
            let after = at(k);
            let half = (before + after) * (0.25 * self.step);
            let half = UnitQuaternion::from_scaled_axis(Vector3::new(half.x, half.y, 0.0));
            rotation *= half;
            place += rotation * Vector3::z() * self.step;
            rotation *= half;
            before = after;
            if let Some((_, point)) = told.next_if(|(at, _)| *at == k) {
                let roll = self.roll.1.hypot(turned);
                let sigma = point.sigma(&bent.square, roll * place.xy().norm());
                bent.points.push((place.into(), sigma));
            }
        }
        let direction = rotation * Vector3::z();
        // What turns the frame in this reading alone does not last.
        let by_turn = [place, direction].map(|v| v.xy().norm());
        (bent.tip_sigma, bent.direction_sigma) = if self.lasting {
            (
                self.tip.white(&self.noise).hypot(turned * by_turn[0]),
                self.slope.white(&self.noise).hypot(turned * by_turn[1]),
            )
        } else {
            let roll = self.roll.1.hypot(turned);
            (
                self.tip.sigma(&bent.square, roll * by_turn[0]),
                self.slope.sigma(&bent.square, roll * by_turn[1]),
            )
        };
        (bent.tip, bent.direction) = (place.into(), Unit::new_normalize(direction));
    }
}

impl Told {
    /// Standard deviation by noise alone, of these variances of the areas' curvatures.
    fn white(&self, noise: &[f64]) -> f64 {
        let by_areas: f64 = self
            .by
            .iter()
            .zip(noise)
            .map(|(by, square)| by * by * square)
            .sum();
        by_areas.sqrt()
    }

    /// Standard deviation, by the variances of the areas' curvatures and by what the roll does.
    fn sigma(&self, square: &[f64], roll: f64) -> f64 {
        let by_areas: f64 = self
            .by
            .iter()
            .zip(square)
            .map(|(by, square)| by * by * square)
            .sum();
        (by_areas + self.between + roll * roll).sqrt()
    }
}

/// The curvature along the needle by that of its areas.
struct Field {
    weights: DMatrix<f64>,
    /// Covariance at the ends of the steps \[1/m2\].
    left: DMatrix<f64>,
    step: f64,
}

impl Field {
    fn new(
        calibration: &Calibration,
        fbg: &Fbg,
        length: f64,
        step: f64,
        steps: usize,
        noise: &[f64],
        drift: &[f64],
    ) -> Self {
        let areas = &calibration.areas;
        let (variance, reach) = (
            fbg.curvature_sigma_per_m.powi(2),
            fbg.curvature_length_mm * 1e-3,
        );
        // The last is the tip.
        let at: Vec<f64> = (areas.iter().map(|area| length - area.from_tip))
            .chain([length])
            .collect();
        let own: Vec<f64> = (noise.iter().zip(drift).map(|(a, b)| a + b))
            .chain([TIP * TIP])
            .collect();
        let covariance = |a: f64, b: f64| variance * correlation((a - b) / reach);
        let n = at.len();
        let between = DMatrix::from_fn(n, n, |i, j| {
            covariance(at[i], at[j]) + if i == j { own[i] } else { 0.0 }
        });
        let nodes = steps + 1;
        let node = |k: usize| k as f64 * step;
        let cross = DMatrix::from_fn(n, nodes, |i, k| covariance(at[i], node(k)));
        // Positive definite: a covariance and noise, or else nothing is told.
        let told = between
            .cholesky()
            .map_or_else(|| DMatrix::zeros(n, nodes), |c| c.solve(&cross));
        let prior = DMatrix::from_fn(nodes, nodes, |i, j| covariance(node(i), node(j)));
        Self {
            left: prior - cross.transpose() * &told,
            weights: told.rows(0, n - 1).transpose(),
            step,
        }
    }

    /// What the turns tell of something that follows each of them by `lever`, by its arc length.
    fn told(&self, lever: impl Fn(f64) -> f64) -> Told {
        let last = self.weights.nrows() - 1;
        let levers = DVector::from_fn(last + 1, |k, _| {
            let share = if k == 0 || k == last { 0.5 } else { 1.0 };
            lever(k as f64 * self.step) * share * self.step
        });
        Told {
            by: self.weights.tr_mul(&levers),
            between: levers.dot(&(&self.left * &levers)).max(0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    const LENGTH: f64 = 0.126;

    fn fibres(areas_mm: &[f64], change: impl Fn(&mut Fbg)) -> FibreShape {
        let mut fbg = Fbg {
            areas_mm: areas_mm.to_vec(),
            ..Fbg::default()
        };
        change(&mut fbg);
        let calibration = Calibration::of(&fbg).unwrap();
        FibreShape::new(calibration, &fbg, LENGTH).unwrap()
    }

    fn dense() -> Vec<f64> {
        (0..=12).map(|k| 3.0 + 10.0 * f64::from(k)).collect()
    }

    /// Shifts of areas with `turn` by their distance from the tip.
    fn shifts(fibres: &FibreShape, turn: impl Fn(f64) -> Vector2<f64>) -> Vec<f64> {
        let areas = fibres.calibration.simulated();
        let of = |area: &phantom::FibreArea| {
            let turn = turn(area.from_tip);
            area.sensitivity
                .iter()
                .map(|by| Vector2::from(*by).dot(&turn))
                .collect::<Vec<_>>()
        };
        areas.iter().flat_map(of).collect()
    }

    #[test]
    fn an_arc_of_dense_areas_ends_where_it_should() {
        let fibres = fibres(&dense(), |_| {});
        let (curvature, mut bent) = (2.0, Bent::default());
        // Constant but for the end, where nothing bends it.
        let turn = |from_tip: f64| Vector2::new(curvature * (from_tip / 3e-3).min(1.0), 0.0);
        fibres.bend(&shifts(&fibres, turn), 0.0, &mut bent).unwrap();
        let angle = curvature * LENGTH;
        let expected = Vector3::new(0.0, angle.cos() - 1.0, angle.sin()) / curvature;
        // The end's 3 mm turn by 3 mrad less, with a lever of 1 mm.
        assert!((bent.tip.coords - expected).norm() < 5e-5, "{}", bent.tip);
        assert!((bent.direction.y + angle.sin()).abs() < 5e-3);
        // A turned frame turns the shape.
        let quarter = self::fibres(&dense(), |fbg| fbg.roll_deg = 90.0);
        quarter
            .bend(&shifts(&quarter, turn), 0.0, &mut bent)
            .unwrap();
        assert!((bent.tip.x - -expected.y).abs() < 5e-5, "{}", bent.tip);
    }

    #[test]
    fn a_natural_curvature_bends_a_needle_that_shows_none() {
        let fibres = fibres(&dense(), |fbg| fbg.natural_curvature_per_m = [0.0, 1.0]);
        let mut bent = Bent::default();
        let shifts = shifts(&fibres, |_| Vector2::zeros());
        fibres.bend(&shifts, 0.0, &mut bent).unwrap();
        assert!((bent.tip.x - (1.0 - LENGTH.cos())).abs() < 1e-6);
        assert!(fibres.bend(&shifts[1..], 0.0, &mut bent).is_none());
        let mut unread = shifts;
        unread[4] = f64::NAN;
        assert!(fibres.bend(&unread, 0.0, &mut bent).is_none());
    }

    /// Shapes drawn from the process itself, read with noise, drift and errors of calibration as told: the
    /// errors of points and tip have the spread that is said, from the base to the tip.
    #[test]
    fn errors_are_as_large_as_is_said() {
        let fibres = fibres(&[100.0, 65.0, 30.0, 10.0], |fbg| {
            (fbg.noise_pm, fbg.lasting) = (20.0, false);
        });
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let fbg = Fbg::default();
        let step = 1e-3;
        let nodes = 127;
        let at = |k: usize| k as f64 * step;
        let covariance = DMatrix::from_fn(nodes, nodes, |i, j| {
            let distance = (at(i) - at(j)) / (fbg.curvature_length_mm * 1e-3);
            let nugget = if i == j { 1e-9 } else { 0.0 };
            fbg.curvature_sigma_per_m.powi(2) * correlation(distance) + nugget
        });
        // Given that it fades at the tip.
        let last = covariance.column(nodes - 1).into_owned();
        let known = last[nodes - 1] + TIP * TIP;
        let covariance = &covariance - &last * last.transpose() / known;
        let covariance = covariance + DMatrix::from_diagonal_element(nodes, nodes, 1e-9);
        let root = covariance.cholesky().unwrap().l();
        let runs = 400;
        let count = fibres.points.len() + 1;
        let (mut squares, mut said) = (vec![0.0; count], vec![0.0; count]);
        let mut bent = Bent::default();
        for _ in 0..runs {
            let axes = [0, 1].map(|_| &root * DVector::from_fn(nodes, |_, _| normal()));
            let gains: Vec<f64> = (0..4).map(|_| 1.0 + fbg.gain_sigma * normal()).collect();
            let turn = |from_tip: f64| {
                let k = ((LENGTH - from_tip) / step).round();
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "a rounded place on the needle"
                )]
                let k = k as usize;
                Vector2::new(axes[0][k], axes[1][k])
            };
            let area = |from_tip: f64| {
                let areas = &fibres.calibration.areas;
                let area = areas
                    .iter()
                    .position(|a| (a.from_tip - from_tip).abs() < 1e-9);
                turn(from_tip) * gains[area.unwrap()]
            };
            let mut shifts = shifts(&fibres, area);
            for shift in &mut shifts {
                *shift += 1e-3 * 20_f64.hypot(fbg.drift_pm) * normal();
            }
            fibres.bend(&shifts, 0.0, &mut bent).unwrap();
            // The roll errs too, by a turn of all.
            let roll = Rotation2::new(fbg.roll_sigma_deg.to_radians() * normal());
            let shown = bent.points.iter().map(|(p, sigma)| (p.coords, *sigma));
            let shown = shown.chain([(bent.tip.coords, bent.tip_sigma)]);
            let ends = fibres.points.iter().map(|(k, _)| *k).chain([nodes - 1]);
            for (i, ((place, sigma), end)) in shown.zip(ends).enumerate() {
                let mut truth = Vector2::zeros();
                for (axis, turns) in axes.iter().enumerate() {
                    let arm = |k: usize| at(end) - at(k);
                    let sum: f64 = (0..end)
                        .map(|k| 0.5 * step * (turns[k] * arm(k) + turns[k + 1] * arm(k + 1)))
                        .sum();
                    truth[axis] = sum;
                }
                // About x to -y, about y to x.
                let truth = roll * Vector2::new(truth.y, -truth.x);
                squares[i] += (place.xy() - truth).norm_squared() / 2.0;
                said[i] += sigma * sigma;
            }
        }
        for (i, (square, said)) in squares.iter().zip(&said).enumerate() {
            let ratio = square / said;
            // 800 components, correlated in each run: a standard error of 5 %; four of them, and what small
            // turns leave out.
            assert!((0.75..1.3).contains(&ratio), "point {i}: {ratio}");
        }
        assert!(said.windows(2).all(|pair| pair[0] < pair[1]));
    }
}
