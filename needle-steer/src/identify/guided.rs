//! Identification from motions of the support with a tip sensor alone: wave length, distance of a
//! guide, place of the sensor, drifts.

use nalgebra::{Matrix3, Vector2, Vector3};
use serde::Serialize;

use super::bed::Bed;
use super::fit::{IdentifyError, Parameter};
use super::recording::{Recording, Support};
use super::response::{Change, Response, measured};
use super::steps::{LeftOut, Steps, advance, is_moved};
use crate::config::Config;
use crate::springs;

/// Prior of the wave length where the configuration has none \[m\], and the standard deviation of its
/// logarithm: needles of 18 to 25 G in gels and tissue have 15 to 50 mm.
const WAVE_LENGTH: f64 = 28e-3;
const WAVE_LENGTH_SIGMA: f64 = 0.5;
/// Prior of how far a coil sits behind the tip, and its standard deviation \[m\].
const SETBACK: f64 = 3.5e-3;
const SETBACK_SIGMA: f64 = 1.5e-3;
/// Standard deviation of a measured change of slope at the start of the fit \[rad\]; then the
/// residuals say it.
const SLOPE_SIGMA: f64 = 12e-3;
/// Standard deviation of the drift of the measured slope \[rad/m\]: 70 mrad over 100 mm in air.
const DRIFT: f64 = 1.0;
/// Errors of the model along one insertion belong together: so many of them count as one.
const TOGETHER: f64 = 3.0;
/// Spread of ln(wave length) between insertions in one tissue beyond that.
const BETWEEN: f64 = 0.10;
/// Least advance of a step that is fitted \[m\].
const LEAST_ADVANCE: f64 = 3e-3;
/// Least number of steps with a motion of the support.
const LEAST_STEPS: usize = 5;
/// Standard deviation of ln(wave length) above which it is called not identified.
const IDENTIFIED: f64 = 0.3;
/// Half width of a 95 % interval in standard deviations.
const NORMAL: f64 = 1.96;
const ITERATIONS: usize = 25;
/// Stiffness that the laws' estimator takes \[N/m2\]; a thick needle's wave length may say more.
const STIFFNESS: (f64, f64) = (5e2, 3e5);
/// Steps of the numerical derivatives: of ln(wave length), of the distances \[m\].
const DELTA: [f64; 3] = [0.03, 0.5e-3, 0.5e-3];

/// A value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interval {
    /// Best value.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// What a tip sensor says of needle and tissue. Lateral pairs are along x and y of the first row's
/// support.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TipIdentified {
    /// Wave length (4 EI/K_T)^(1/4) \[mm\].
    pub wave_length_mm: Option<Interval>,
    /// Stiffness of the tissue per length with the configuration's needle \[N/m2\].
    pub stiffness_n_m2: Option<Parameter>,
    /// Distance of the guide's exit from the surface in the first row \[mm\].
    pub guide_gap_mm: Option<Interval>,
    /// Natural curvature of the path \[1/m\].
    pub natural_curvature_per_m: Option<Interval>,
    /// Cut angle: a tip sensor does not see it apart from the sensor's drift.
    pub cut_angle_deg: Option<Parameter>,
    /// Tip load: as the cut angle.
    pub tip_load_scale: Option<Parameter>,
    /// How far the sensor sits behind the tip \[mm\].
    pub sensor_setback_mm: Interval,
    /// Change of the measured slope by bevel and sensor \[rad/m\].
    pub axis_drift_rad_per_m: [f64; 2],
    /// Change of the measured position by bevel and sensor \[mm/m\].
    pub tip_drift_mm_per_m: [f64; 2],
    /// What is not identified, and which motion would.
    pub not_identified: Vec<String>,
    /// Parts of recordings that do not count.
    pub left_out: Vec<LeftOut>,
    /// Insertions used.
    pub recordings: usize,
    /// Measurements used.
    pub measurements: usize,
}

/// Whether recordings are for this identification: through a guide, or without points of the shaft
/// from a base that was moved across.
pub fn is_for_tip(recordings: &[Recording]) -> bool {
    let moved = |recording: &Recording| {
        let rows = Steps::of(recording).rows;
        rows.windows(2).filter(|w| is_moved(&w[0], &w[1])).count() >= LEAST_STEPS
    };
    let blind = |recording: &Recording| {
        recording.seen.iter().all(|seen| seen.shaft.is_empty())
            && recording.seen.iter().all(|s| s.direction_sigma.is_finite())
    };
    recordings.iter().any(|r| r.support == Support::Guide)
        || (recordings.iter().all(blind) && recordings.iter().any(moved))
}

/// Identifies from one or several recordings of the same needle in the same tissue.
///
/// # Errors
/// See [`IdentifyError`].
pub fn identify_tip(recordings: &[Recording]) -> Result<TipIdentified, IdentifyError> {
    let first = recordings.first().ok_or(IdentifyError::NoRecording)?;
    if let Some(other) = recordings.iter().find(|r| r.support != first.support) {
        return Err(IdentifyError::Mixed {
            name: other.name.clone(),
            first: first.name.clone(),
        });
    }
    let insertions: Vec<Steps> = recordings.iter().map(Steps::of).collect();
    for (recording, steps) in recordings.iter().zip(&insertions) {
        if !steps.has_axis {
            return Err(IdentifyError::NoAxis {
                name: recording.name.clone(),
            });
        }
    }
    let config = &first.config;
    let fit = Fit::new(config, first.support, &insertions);
    if fit.count() < LEAST_STEPS {
        let deepest = insertions.iter().map(Steps::depth).fold(0.0, f64::max);
        return Err(IdentifyError::Still {
            needed: LEAST_STEPS,
            found: fit.count(),
            deepest_mm: deepest * 1e3,
        });
    }
    let found = fit.solve();
    let bending = springs::needle(config)
        .map_err(|source| IdentifyError::Needle {
            name: first.name.clone(),
            source,
        })?
        .bending_stiffness();
    let mut not_identified = Vec::new();
    let sigma = found.sigma[0];
    let identified = sigma < IDENTIFIED;
    if !identified {
        not_identified.push(
            "wave_length_mm, stiffness_n_m2: the support hardly moved while the tip was 5 to 40 mm deep; move it by 2 mm or more there".to_owned(),
        );
    }
    let log = found.at[0];
    let wave_length = Interval {
        value: log.exp() * 1e3,
        low: (log - NORMAL * sigma).exp() * 1e3,
        high: (log + NORMAL * sigma).exp() * 1e3,
    };
    let stiffness = Parameter::from_log((4.0 * bending).ln() - 4.0 * log, 4.0 * sigma, None);
    let gap = insertions
        .iter()
        .filter_map(|steps| steps.rows.first().map(|row| row.place.gap))
        .sum::<f64>()
        / insertions.len() as f64;
    let gap_prior = config.needle.guide_gap_sigma_mm * 1e-3;
    if fit.gap_sigma.is_some() && found.sigma[1] > 0.8 * gap_prior {
        not_identified.push(
            "guide_gap_mm: nearly the prior; move the guide while the tip is less than 20 mm deep"
                .to_owned(),
        );
    }
    not_identified.push(
        "natural_curvature_per_m, cut_angle_deg, tip_load_scale: the bevel was not turned, and its effect is in the drift of the measured axis; turn the needle by half a turn between insertions".to_owned(),
    );
    Ok(TipIdentified {
        wave_length_mm: identified.then_some(wave_length),
        stiffness_n_m2: identified.then_some(stiffness),
        guide_gap_mm: (first.support == Support::Guide)
            .then(|| millimetres(gap + found.at[1], found.sigma[1])),
        natural_curvature_per_m: None,
        cut_angle_deg: None,
        tip_load_scale: None,
        sensor_setback_mm: millimetres(found.at[2], found.sigma[2]),
        axis_drift_rad_per_m: found.response.axis_drift.into(),
        tip_drift_mm_per_m: (found.response.tip_drift * 1e3).into(),
        not_identified,
        left_out: insertions
            .iter()
            .filter_map(|s| s.left_out.clone())
            .collect(),
        recordings: recordings.len(),
        measurements: insertions.iter().map(|steps| steps.rows.len()).sum(),
    })
}

impl TipIdentified {
    /// The configuration of `base` with what was identified; the rest stays as it was.
    pub fn apply(&self, base: &Config) -> Config {
        let mut config = base.clone();
        if let (Some(wave_length), Some(stiffness)) = (&self.wave_length_mm, &self.stiffness_n_m2) {
            config.estimator.wave_length_mm = wave_length.value;
            config.estimator.stiffness_n_m2 = stiffness.value.clamp(STIFFNESS.0, STIFFNESS.1);
            config.estimator.stiffness_sigma = stiffness.log_sigma;
        }
        if let Some(gap) = self.guide_gap_mm
            && base.needle.guide_gap_sigma_mm > 0.0
        {
            config.needle.guide_gap_mm = gap.value.max(0.0);
            config.needle.guide_gap_sigma_mm = (gap.high - gap.low) / (2.0 * NORMAL);
        }
        config.needle.sensor_setback_mm = self.sensor_setback_mm.value;
        config.needle.axis_drift_rad_per_m = self.axis_drift_rad_per_m;
        config.needle.tip_drift_mm_per_m = self.tip_drift_mm_per_m;
        config
    }
}

fn millimetres(value: f64, sigma: f64) -> Interval {
    Interval {
        value: value * 1e3,
        low: (value - NORMAL * sigma) * 1e3,
        high: (value + NORMAL * sigma) * 1e3,
    }
}

/// Least squares in ln(wave length), distance of the guide beyond its pose, setback of the sensor.
struct Fit<'a> {
    insertions: &'a [Steps],
    prior: Vector3<f64>,
    sigma: Vector3<f64>,
    /// None where the pose is right.
    gap_sigma: Option<f64>,
}

struct Found {
    at: Vector3<f64>,
    sigma: Vector3<f64>,
    response: Response,
}

impl<'a> Fit<'a> {
    fn new(config: &Config, support: Support, insertions: &'a [Steps]) -> Self {
        let given = |value: f64, otherwise: f64| if value > 0.0 { value * 1e-3 } else { otherwise };
        let gap_sigma = Some(config.needle.guide_gap_sigma_mm * 1e-3)
            .filter(|sigma| support == Support::Guide && *sigma > 0.0);
        Self {
            insertions,
            prior: Vector3::new(
                given(config.estimator.wave_length_mm, WAVE_LENGTH).ln(),
                0.0,
                given(config.needle.sensor_setback_mm, SETBACK),
            ),
            sigma: Vector3::new(
                WAVE_LENGTH_SIGMA,
                gap_sigma.unwrap_or(f64::MIN_POSITIVE.sqrt()),
                SETBACK_SIGMA,
            ),
            gap_sigma,
        }
    }

    /// Steps that are fitted.
    fn count(&self) -> usize {
        self.pairs().count()
    }

    fn pairs(&self) -> impl Iterator<Item = (usize, usize)> {
        self.insertions.iter().enumerate().flat_map(|(n, steps)| {
            let fitted = |w: &[super::steps::Row]| {
                advance(&w[0], &w[1]) >= LEAST_ADVANCE && is_moved(&w[0], &w[1])
            };
            let windows = steps.rows.windows(2).enumerate();
            windows
                .filter(move |(_, w)| fitted(w))
                .map(move |(k, _)| (n, k))
        })
    }

    fn response(at: &Vector3<f64>) -> Response {
        Response {
            bed: Bed {
                wave_length: at[0].clamp(1e-3_f64.ln(), 1_f64.ln()).exp(),
                farther: at[1],
                setback: at[2].max(0.0),
            },
            axis_drift: Vector2::zeros(),
            tip_drift: Vector2::zeros(),
        }
    }

    /// Errors of the predicted changes with the drifts that fit best, and these.
    fn errors(&self, at: &Vector3<f64>) -> (Vec<f64>, Response) {
        let mut response = Self::response(at);
        let predicted: Vec<Vec<Change>> = self
            .insertions
            .iter()
            .map(|s| response.predict(s))
            .collect();
        let seen: Vec<Vec<Change>> = self.insertions.iter().map(measured).collect();
        let (mut axis, mut tip, mut weight) = (Vector2::zeros(), Vector2::zeros(), 0.0);
        for (n, k) in self.pairs() {
            let rows = &self.insertions[n].rows;
            let way = advance(&rows[k], &rows[k + 1]);
            axis += (seen[n][k].axis - predicted[n][k].axis) * way;
            tip += (seen[n][k].tip - predicted[n][k].tip) * way;
            weight += way * way;
        }
        response.axis_drift = axis / (weight + (SLOPE_SIGMA / DRIFT).powi(2));
        response.tip_drift = tip / weight;
        let mut errors = Vec::new();
        for (n, k) in self.pairs() {
            let rows = &self.insertions[n].rows;
            let way = advance(&rows[k], &rows[k + 1]);
            let error = seen[n][k].axis - predicted[n][k].axis - response.axis_drift * way;
            errors.extend([error.x, error.y]);
        }
        (errors, response)
    }

    fn cost(&self, at: &Vector3<f64>, sigma: f64) -> f64 {
        let (errors, _) = self.errors(at);
        let data: f64 = errors.iter().map(|e| (e / sigma).powi(2)).sum();
        data + (at - self.prior).component_div(&self.sigma).norm_squared()
    }

    fn solve(&self) -> Found {
        let mut sigma = SLOPE_SIGMA;
        let mut best = (f64::INFINITY, self.prior);
        for _ in 0..2 {
            best.0 = self.cost(&best.1, sigma);
            for start in [-0.4, 0.0, 0.4] {
                let from = best.1 + Vector3::new(start, 0.0, 0.0);
                let (cost, at) = self.descend(from, sigma);
                if cost < best.0 {
                    best = (cost, at);
                }
            }
            let (errors, _) = self.errors(&best.1);
            let square: f64 = errors.iter().map(|e| e * e).sum();
            sigma = (square / errors.len() as f64).sqrt().max(1e-4);
        }
        let at = best.1;
        let (normal, _) = self.normal(&at, sigma * TOGETHER.sqrt());
        let covariance = normal.try_inverse().unwrap_or_else(Matrix3::zeros);
        let mut spread = covariance.diagonal().map(|v| v.max(0.0).sqrt());
        spread[0] = spread[0].hypot(BETWEEN);
        let (_, response) = self.errors(&at);
        Found {
            at,
            sigma: spread,
            response,
        }
    }

    /// Levenberg and Marquardt's way down from `at`.
    fn descend(&self, mut at: Vector3<f64>, sigma: f64) -> (f64, Vector3<f64>) {
        let mut cost = self.cost(&at, sigma);
        let mut damping = 1e-3;
        for _ in 0..ITERATIONS {
            let (normal, gradient) = self.normal(&at, sigma);
            let damped = normal + Matrix3::from_diagonal(&normal.diagonal()) * damping;
            let Some(step) = damped.cholesky().map(|c| c.solve(&gradient)) else {
                break;
            };
            let next = at - step;
            let lower = self.cost(&next, sigma);
            if lower < cost {
                let gained = cost - lower;
                (cost, at) = (lower, next);
                damping *= 0.2;
                if gained < 1e-4 {
                    break;
                }
            } else {
                damping *= 10.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        (cost, at)
    }

    /// Half the second derivative and half the gradient of the cost.
    fn normal(&self, at: &Vector3<f64>, sigma: f64) -> (Matrix3<f64>, Vector3<f64>) {
        let (errors, _) = self.errors(at);
        let columns: Vec<Vec<f64>> = (0..3)
            .map(|k| {
                if k == 1 && self.gap_sigma.is_none() {
                    return vec![0.0; errors.len()];
                }
                let mut ahead = *at;
                let mut behind = *at;
                ahead[k] += DELTA[k];
                behind[k] -= DELTA[k];
                let (ahead, behind) = (self.errors(&ahead).0, self.errors(&behind).0);
                let slope = |(a, b): (f64, f64)| (a - b) / (2.0 * DELTA[k]);
                ahead.into_iter().zip(behind).map(slope).collect()
            })
            .collect();
        let weight = sigma.powi(-2);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() * weight;
        let prior = self.sigma.map(|s| s.powi(-2));
        let normal =
            Matrix3::from_fn(|i, j| dot(&columns[i], &columns[j])) + Matrix3::from_diagonal(&prior);
        let gradient = Vector3::from_fn(|i, _| dot(&columns[i], &errors))
            + (at - self.prior).component_mul(&prior);
        (normal, gradient)
    }
}

#[cfg(test)]
mod tests;
