//! Settings of moving tissue.

use serde::{Deserialize, Serialize};

/// Tissue that moves, with a marker or without.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotionSettings {
    /// Expected rate of breathing \[Hz\] (assumed).
    pub breathing_hz: f64,
    /// Its relative standard deviation.
    pub breathing_sigma: f64,
    /// Expected amplitude of mean and first harmonic \[mm\] (assumed).
    pub amplitude_mm: f64,
    /// Motion at the entry over motion at the marker, before the needle tells (assumed).
    pub surface_ratio: f64,
    /// Its standard deviation.
    pub surface_sigma: f64,
    /// Drift of the mean, standard deviation in one second \[mm\].
    pub mean_walk_mm: f64,
    /// Change of the harmonics, standard deviation in one second \[mm\].
    pub amplitude_walk_mm: f64,
    /// Time from a command to the arm's motion, over which the feed-forward looks ahead \[ms\]
    /// (assumed).
    pub lead_ms: f64,
    /// Feature switch: without a marker, tell breathing from the needle's own tip.
    pub sway: bool,
}

impl Default for MotionSettings {
    fn default() -> Self {
        Self {
            breathing_hz: 0.2,
            breathing_sigma: 0.2,
            amplitude_mm: 4.0,
            surface_ratio: 0.2,
            surface_sigma: 0.3,
            mean_walk_mm: 0.03,
            amplitude_walk_mm: 0.07,
            lead_ms: 50.0,
            sway: true,
        }
    }
}
