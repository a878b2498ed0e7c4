//! Scale of the tip load in the paper's springs model.

use nalgebra::Vector3;
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

/// Fits of the tip-load factor along an insertion, with the stiffness `k_t` \[N/m2\] given. The
/// springs are born at the measured tips. A recording that the model cannot follow gives none.
pub(super) fn along(recording: &Recording, k_t: f64, k_sigma: f64) -> Vec<LogLoad> {
    fits(recording, k_t, k_sigma).unwrap_or_default()
}

fn fits(recording: &Recording, k_t: f64, k_sigma: f64) -> Option<Vec<LogLoad>> {
    let config = &recording.config;
    let first = recording.seen.first()?;
    let outside = first.world_from_support * nalgebra::Isometry3::translation(0.0, 0.0, -CLEARANCE);
    let mut insertion = Insertion::new(
        springs::needle(config).ok()?,
        Bevel::plane_cut(
            config.needle.bevel_deg.to_radians(),
            config.needle.outer_diameter_mm * 1e-3,
        )
        .ok()?,
        Tissue::uniform(config.entry().coords, config.inward().into_inner(), k_t).ok()?,
        InsertionSettings {
            pitch: config.tissue.spring_spacing_mm * 1e-3,
            ..InsertionSettings::default()
        },
        &outside,
    )
    .ok()?;
    let mut next = FIRST;
    let mut found = Vec::new();
    for seen in &recording.seen {
        if insertion
            .insert(&seen.world_from_support, Some(seen.tip.coords))
            .is_err()
        {
            break;
        }
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
    Some(found)
}
