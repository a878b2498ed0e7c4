//! Scale of the tip load in the paper's springs model.

use nalgebra::{Translation3, Vector3};
use needle_model::{Bevel, EstimationSettings, Estimator, Insertion, InsertionSettings, Tissue};

use super::recording::Recording;
use crate::springs;

/// Depth between fits \[m\].
const SPACING: f64 = 5e-3;
/// Depth of the first fit \[m\].
const FIRST: f64 = 25e-3;
/// Shortest piece of needle beyond the last spring for a fit \[m\].
const LEAST: f64 = 0.2e-3;
/// Distance of the model's start from the surface \[m\].
const CLEARANCE: f64 = 1e-3;

/// One fit's logarithm of the tip-load factor and its variance.
pub(super) type LogLoad = (f64, f64);

/// The fits of one insertion, and why there are not more.
#[derive(Debug, Default)]
pub(super) struct Fits {
    /// In order of depth.
    pub(super) loads: Vec<LogLoad>,
    /// Where and why the model did not follow the insertion to its end.
    pub(super) stopped: Option<String>,
}

/// Fits of the tip-load factor along an insertion, with the stiffness `k_t` \[N/m2\] given. The
/// springs are born at the measured tips.
pub(super) fn along(recording: &Recording, k_t: f64, k_sigma: f64) -> Fits {
    let mut fits = Fits::default();
    if let Err(why) = collect(recording, k_t, k_sigma, &mut fits.loads) {
        fits.stopped = Some(why);
    }
    fits
}

/// Adds fits up to the first depth to which the model does not follow; an error names it.
fn collect(
    recording: &Recording,
    k_t: f64,
    k_sigma: f64,
    found: &mut Vec<LogLoad>,
) -> Result<(), String> {
    fn words(error: impl std::fmt::Display) -> String {
        error.to_string()
    }
    let config = &recording.config;
    let Some(first) = recording.seen.first() else {
        return Ok(());
    };
    // Cameras see the needle only when it is some way in: its straight start is made up for.
    let unseen = (first.tip - config.entry()).dot(&config.inward()).max(0.0);
    let pulled_back = |by: f64| first.world_from_support * Translation3::new(0.0, 0.0, -by);
    let pitch = config.tissue.spring_spacing_mm * 1e-3;
    let mut insertion = Insertion::new(
        springs::needle(config).map_err(words)?,
        Bevel::plane_cut(
            config.needle.bevel_deg.to_radians(),
            config.needle.outer_diameter_mm * 1e-3,
        )
        .map_err(words)?,
        Tissue::uniform(config.entry().coords, config.inward().into_inner(), k_t).map_err(words)?,
        InsertionSettings {
            pitch,
            ..InsertionSettings::default()
        },
        &pulled_back(unseen + CLEARANCE),
    )
    .map_err(words)?;
    let mut left = unseen - pitch;
    while left > 0.0 {
        insertion
            .insert(&pulled_back(left), None)
            .map_err(|error| format!("on its unseen start: {error}"))?;
        left -= pitch;
    }
    let mut next = FIRST;
    for seen in &recording.seen {
        let depth_mm = insertion.equilibrium().inserted_length() * 1e3;
        insertion
            .insert(&seen.world_from_support, Some(seen.tip.coords))
            .map_err(|error| format!("{depth_mm:.0} mm deep: {error}"))?;
        // A spring just born at the tip leaves no needle behind it to fit.
        let free = insertion.equilibrium().segment_lengths().last();
        let settled = free.is_some_and(|length| length > LEAST);
        if insertion.equilibrium().inserted_length() < next || seen.shaft.len() < 4 || !settled {
            continue;
        }
        next = insertion.equilibrium().inserted_length() + SPACING;
        let points: Vec<Vector3<f64>> = seen
            .shaft
            .iter()
            .map(|(point, _)| point.coords)
            .chain([seen.tip.coords])
            .collect();
        let settings = EstimationSettings {
            point_sigma: seen.tip_sigma.max(0.05e-3),
            prior_sigma: [k_sigma.max(1e-3), 1.0],
            ..EstimationSettings::joint()
        };
        let Ok(mut estimator) = Estimator::new(settings, insertion.equilibrium()) else {
            continue;
        };
        if let Ok(estimate) = estimator.fit(insertion.equilibrium(), k_t, &points)
            && estimate.observability[1] > 0.5
        {
            found.push((estimate.load_factor.ln(), estimate.covariance[(1, 1)]));
        }
    }
    Ok(())
}
