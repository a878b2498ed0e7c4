//! Parameters with intervals, and what the data do not identify.

use hybrid_control::{Estimator, EstimatorError, EstimatorSettings, Observation, Start};
use nalgebra::{Point3, Vector2, Vector3};
use needle_model::NeedleError;
use serde::Serialize;

use super::guided::Interval;
use super::recording::Recording;
use super::steps::LeftOut;
use super::tip_load;
use crate::config::Config;
use crate::springs;

/// Passes over the recordings: each starts from the stiffness that the one before found.
const PASSES: usize = 4;
/// Prior standard deviation of the logarithm of the stiffness: hardly any knowledge.
const WIDE: f64 = 1.5;
/// Depth from which the estimates count \[m\].
const SETTLED: f64 = 45e-3;
/// What the model lacks (relaxation, friction, the tissue's own variation along the path), as
/// standard deviations of logarithms: with the estimator's own they make the root mean square
/// errors on the phantom `paper`, seeds 1001 to 1024, which were 0.32 for the stiffness and 0.12
/// for the cut angle. `examples/identification.rs` measures them.
const MODEL_SIGMA: Sigmas = Sigmas {
    stiffness: 0.30,
    cut_angle: 0.14,
    tip_load: 0.3,
};
/// Half width of a 95 % interval in standard deviations.
const NORMAL: f64 = 1.96;
/// A parameter is called identified when its logarithm's standard deviation is below this.
const IDENTIFIED: f64 = 0.45;
/// Spread of the bevel's direction below which its effect cannot be distinguished from another bias.
const TURNED: f64 = 0.3;

struct Sigmas {
    stiffness: f64,
    cut_angle: f64,
    tip_load: f64,
}

/// Recordings that identify nothing.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// No recording was given.
    #[error("no recording of an insertion was given")]
    NoRecording,
    /// The needle of a recording.
    #[error("{name}: {source}")]
    Needle {
        /// The recording.
        name: String,
        /// Why.
        source: NeedleError,
    },
    /// The start of a recording.
    #[error("{name}: {source}")]
    Start {
        /// The recording.
        name: String,
        /// Why.
        source: EstimatorError,
    },
    /// Recordings of a base and of a guide.
    #[error("{name}: held otherwise than {first}; estimate from guides and from bases apart")]
    Mixed {
        /// The recording.
        name: String,
        /// The first recording.
        first: String,
    },
    /// No tip axis.
    #[error(
        "{name}: the tip's axis is not in every row (axis_x, axis_y, axis_z): without it the tip sensor shows no wave length"
    )]
    NoAxis {
        /// The recording.
        name: String,
    },
    /// The support hardly moved.
    #[error(
        "{found} steps with a motion of the support of 0.3 mm and an advance of 3 mm, {needed} are needed (deepest tip: {deepest_mm:.1} mm); move the support while the tip is 5 to 40 mm deep, and check `tissue.entry_mm` and `tissue.inward`"
    )]
    Still {
        /// Steps needed.
        needed: usize,
        /// Steps found.
        found: usize,
        /// Depth of the deepest tip \[mm\].
        deepest_mm: f64,
    },
    /// No step counts.
    #[error(
        "no step has 3 to 8 mm of advance and a motion of the support of 0.3 mm: there is nothing to hold the model against"
    )]
    NoSteps,
    /// No recording is deep enough.
    #[error(
        "no recording is deeper than {needed_mm} mm (the deepest: {found_mm:.1} mm); are `tissue.entry_mm` and `tissue.inward` those of the recordings?"
    )]
    Shallow {
        /// Depth needed \[mm\].
        needed_mm: f64,
        /// Depth of the deepest recording \[mm\].
        found_mm: f64,
    },
}

/// A parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Parameter {
    /// Best value.
    pub value: f64,
    /// 95 % interval.
    pub interval: [f64; 2],
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
    /// Standard deviation of the logarithm.
    pub log_sigma: f64,
    /// Whether the data identify it.
    pub identified: bool,
    /// Why they do not.
    pub reason: Option<String>,
}

impl Parameter {
    pub(super) fn from_log(log: f64, sigma: f64, reason: Option<String>) -> Self {
        let (low, high) = ((log - NORMAL * sigma).exp(), (log + NORMAL * sigma).exp());
        Self {
            value: log.exp(),
            interval: [low, high],
            low,
            high,
            log_sigma: sigma,
            identified: reason.is_none(),
            reason,
        }
    }

    /// Whether a value lies in the interval.
    pub fn covers(&self, value: f64) -> bool {
        (self.interval[0]..=self.interval[1]).contains(&value)
    }
}

/// What the recordings say of needle and tissue.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Identified {
    /// Stiffness of the tissue per length, K_T \[N/m2\].
    pub stiffness_n_m2: Parameter,
    /// Cut angle of the bevel \[deg\]: by how much the path leaves the tip's axis.
    pub cut_angle_deg: Parameter,
    /// Natural curvature of the path at full bevel effect, K_nat \[1/m\].
    pub natural_curvature_per_m: Parameter,
    /// Tip load of the springs model (eq. 3), relative to what the bevel's angle and K_T say.
    pub tip_load_scale: Parameter,
    /// Wave length (4 EI/K_T)^(1/4) \[mm\], where the stiffness is identified.
    pub wave_length_mm: Option<Interval>,
    /// None: there is no guide.
    pub guide_gap_mm: Option<Interval>,
    /// What is not identified, and why.
    pub not_identified: Vec<String>,
    /// Parts of recordings that do not count: none, a base's recording counts as a whole.
    pub left_out: Vec<LeftOut>,
    /// Insertions used.
    pub recordings: usize,
    /// Measurements used.
    pub measurements: usize,
}

/// Identifies from one or several recordings of the same needle in the same tissue.
///
/// # Errors
/// See [`IdentifyError`]. Data that do not identify a parameter are no error: see
/// [`Parameter::identified`].
pub fn identify(recordings: &[Recording]) -> Result<Identified, IdentifyError> {
    let mut stiffness = Mean::default();
    let mut cut_angle = Mean::default();
    let mut load = Mean::default();
    let (mut turned, mut deepest, mut measurements) = (0.0_f64, 0.0_f64, 0);
    let mut shaft = false;
    let mut stopped = None;
    let Some(first) = recordings.first() else {
        return Err(IdentifyError::NoRecording);
    };
    for recording in recordings {
        let found = along(recording)?;
        deepest = deepest.max(found.depth);
        measurements += recording.seen.len();
        shaft |= recording.seen.iter().any(|seen| seen.shaft.len() >= 4);
        let (Some(log_k), Some(log_g)) = (found.stiffness, found.cut_angle) else {
            continue;
        };
        stiffness.add(log_k, found.stiffness_sigma);
        cut_angle.add(log_g, found.cut_angle_sigma);
        turned = turned.max(found.turned);
        // The springs of one insertion err together: its fits are one.
        let mut fits = Mean::default();
        let along = tip_load::along(recording, log_k.exp(), MODEL_SIGMA.stiffness);
        for (log, variance) in along.loads {
            fits.add(log, variance.sqrt());
        }
        if let (None, Some(why)) = (&stopped, along.stopped) {
            stopped = Some(format!("{}, {why}", recording.name));
        }
        if let Some((log, _)) = fits.result() {
            load.add(log, fits.spread().max(0.05));
        }
    }
    let (Some((log_k, k_sigma)), Some((log_g, g_sigma))) = (stiffness.result(), cut_angle.result())
    else {
        return Err(IdentifyError::Shallow {
            needed_mm: SETTLED * 1e3,
            found_mm: deepest * 1e3,
        });
    };
    let k_sigma = k_sigma.hypot(MODEL_SIGMA.stiffness);
    let g_sigma = g_sigma.hypot(MODEL_SIGMA.cut_angle);
    let unclear = |sigma: f64, why: &str| (sigma > IDENTIFIED).then(|| why.to_owned());
    let no_shaft = (!shaft).then(|| "no points of the shaft were measured".to_owned());
    let no_turn = (turned < TURNED).then(|| {
        "the bevel was hardly turned: its effect cannot be distinguished from another bias of the path"
            .to_owned()
    });
    let k_reason = no_shaft.or_else(|| unclear(k_sigma, "the needle was hardly pushed sideways"));
    let g_reason = no_turn.or_else(|| unclear(g_sigma, "the estimates scatter too much"));
    let (log_load, load_sigma) = load.result().unwrap_or((0.0, 1.0));
    let load_sigma = load_sigma.hypot(MODEL_SIGMA.tip_load);
    let load_reason = load
        .result()
        .is_none()
        .then(|| match &stopped {
            Some(why) => format!("the springs model did not follow any recording ({why})"),
            None => "no piece of shaft beyond a spring tells it".to_owned(),
        })
        .or_else(|| {
            unclear(
                load_sigma,
                "shape and stiffness leave it open; prior only in part",
            )
        });
    // K_nat = 2 gamma / lambda, lambda ~ K_T^(-1/4).
    let needle = needle(first)?;
    let lambda = (4.0 * needle.bending_stiffness() / log_k.exp()).powf(0.25);
    let mut found = Identified {
        wave_length_mm: None,
        guide_gap_mm: None,
        not_identified: Vec::new(),
        left_out: Vec::new(),
        natural_curvature_per_m: Parameter::from_log(
            log_g + (2.0 / lambda).ln(),
            g_sigma.hypot(k_sigma / 4.0),
            g_reason.clone(),
        ),
        stiffness_n_m2: Parameter::from_log(log_k, k_sigma, k_reason),
        cut_angle_deg: Parameter::from_log(log_g + 1_f64.to_degrees().ln(), g_sigma, g_reason),
        tip_load_scale: Parameter::from_log(log_load, load_sigma, load_reason),
        recordings: recordings.len(),
        measurements,
    };
    found.name_unidentified(needle.bending_stiffness());
    Ok(found)
}

impl Identified {
    fn name_unidentified(&mut self, bending_stiffness: f64) {
        for (name, parameter) in [
            ("stiffness_n_m2", &self.stiffness_n_m2),
            ("cut_angle_deg", &self.cut_angle_deg),
            ("natural_curvature_per_m", &self.natural_curvature_per_m),
            ("tip_load_scale", &self.tip_load_scale),
        ] {
            if let Some(reason) = &parameter.reason {
                self.not_identified.push(format!("{name}: {reason}"));
            }
        }
        let k = &self.stiffness_n_m2;
        let length = |k: f64| (4.0 * bending_stiffness / k).powf(0.25) * 1e3;
        self.wave_length_mm = k.identified.then(|| Interval {
            value: length(k.value),
            low: length(k.high),
            high: length(k.low),
        });
    }

    /// The configuration of `base` with what was identified; the rest stays as it was.
    pub fn apply(&self, base: &Config) -> Config {
        let mut config = base.clone();
        if self.stiffness_n_m2.identified {
            config.estimator.stiffness_n_m2 = self.stiffness_n_m2.value;
            config.estimator.stiffness_sigma = self.stiffness_n_m2.log_sigma;
        }
        if self.cut_angle_deg.identified {
            config.estimator.cut_angle_deg = self.cut_angle_deg.value;
            config.estimator.cut_angle_sigma = self.cut_angle_deg.log_sigma;
            config.law.paper.natural_curvature_per_m = self.natural_curvature_per_m.value;
        }
        config
    }
}

fn needle(recording: &Recording) -> Result<needle_model::Needle, IdentifyError> {
    springs::needle(&recording.config).map_err(|source| IdentifyError::Needle {
        name: recording.name.clone(),
        source,
    })
}

/// What one recording says.
#[derive(Debug, Default)]
struct Found {
    stiffness: Option<f64>,
    stiffness_sigma: f64,
    cut_angle: Option<f64>,
    cut_angle_sigma: f64,
    /// How far the bevel's directions spread, 0 to 1.
    turned: f64,
    depth: f64,
}

fn along(recording: &Recording) -> Result<Found, IdentifyError> {
    let needle = needle(recording)?;
    let config = &recording.config;
    let mut settings = EstimatorSettings {
        stiffness_sigma: WIDE,
        ..config.estimator.clone()
    };
    let mut found = Found::default();
    for _ in 0..PASSES {
        let start = start(recording, &needle);
        let mut estimator =
            Estimator::new(&settings, &start).map_err(|source| IdentifyError::Start {
                name: recording.name.clone(),
                source,
            })?;
        found = pass(recording, &mut estimator);
        let Some(log) = found.stiffness else { break };
        settings.stiffness_n_m2 = log.exp();
    }
    Ok(found)
}

fn start(recording: &Recording, needle: &needle_model::Needle) -> Start {
    let world_from_base = recording
        .seen
        .first()
        .map_or_else(nalgebra::Isometry3::identity, |seen| {
            seen.world_from_support
        });
    let (surface, inward) = (recording.config.entry(), recording.config.inward());
    let axis = world_from_base.rotation * Vector3::z();
    let origin = Point3::from(world_from_base.translation.vector);
    let slope = axis.dot(&inward).max(0.1);
    Start {
        length: needle.length(),
        bending_stiffness: needle.bending_stiffness(),
        cutting_edge: springs::bevel_length(&recording.config),
        guide_gap: None,
        tip_sensor: None,
        advance_by_tip: false,
        entry: hybrid_control::view::Entry {
            point: origin + axis * ((surface - origin).dot(&inward) / slope),
            inward,
        },
        world_from_base,
    }
}

fn pass(recording: &Recording, estimator: &mut Estimator) -> Found {
    let (mut stiffness, mut cut_angle) = (Mean::default(), Mean::default());
    let (mut sum, mut count, mut before) = (Vector2::<f64>::zeros(), 0.0, 0.0);
    let mut sigma = f64::INFINITY;
    let mut depth = 0.0_f64;
    for seen in &recording.seen {
        estimator.observe(&Observation {
            stamp: seen.stamp,
            world_from_base: seen.world_from_support,
            position: seen.tip,
            position_sigma: seen.tip_sigma,
            direction: seen.direction,
            direction_sigma: if seen.direction_sigma.is_finite() {
                seen.direction_sigma
            } else {
                0.5
            },
            shaft: &seen.shaft,
            carried: false,
        });
        estimator.predict(seen.stamp, &seen.world_from_support);
        depth = depth.max(estimator.depth());
        if estimator.depth() > before {
            let (sin, cos) = estimator.bevel_direction().sin_cos();
            let step = estimator.depth() - before;
            sum += Vector2::new(cos, sin) * step;
            count += step;
            before = estimator.depth();
            if before > SETTLED {
                let (k, k_sigma) = estimator.stiffness();
                stiffness.add(k.ln(), k_sigma);
                sigma = sigma.min(k_sigma);
                let gamma = estimator.natural_curvature() * estimator.wave_length() / 2.0;
                cut_angle.add(gamma.ln(), 1.0);
            }
        }
    }
    // Estimates along one insertion share their errors: the best of them says how good they are.
    Found {
        stiffness: stiffness.result().map(|(log, _)| log),
        stiffness_sigma: sigma,
        cut_angle: cut_angle.result().map(|(log, _)| log),
        cut_angle_sigma: cut_angle.spread(),
        turned: if count > 0.0 {
            1.0 - sum.norm() / count
        } else {
            0.0
        },
        depth,
    }
}

/// Weighted mean of logarithms.
#[derive(Debug, Default)]
struct Mean {
    weight: f64,
    sum: f64,
    square: f64,
    count: f64,
}

impl Mean {
    fn add(&mut self, value: f64, sigma: f64) {
        let weight = sigma.max(1e-3).powi(-2);
        if value.is_finite() && weight.is_finite() && weight > 0.0 {
            self.weight += weight;
            self.sum += weight * value;
            self.square += weight * value * value;
            self.count += 1.0;
        }
    }

    /// Mean and its standard deviation: by the weights, or by the scatter where that is larger.
    fn result(&self) -> Option<(f64, f64)> {
        (self.weight > 0.0).then(|| {
            let inner = self.weight.powf(-0.5);
            let outer = self.spread() / self.count.sqrt();
            (self.sum / self.weight, inner.max(outer))
        })
    }

    /// Standard deviation of the values about their mean.
    fn spread(&self) -> f64 {
        if self.weight <= 0.0 {
            return 0.0;
        }
        let mean = self.sum / self.weight;
        (self.square / self.weight - mean * mean).max(0.0).sqrt()
    }
}
