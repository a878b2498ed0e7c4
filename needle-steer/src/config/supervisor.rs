//! Bounds beyond which the arm stops, whatever the law wants.

use serde::{Deserialize, Serialize};

use super::FARTHEST_MM;

/// Bounds beyond which the supervisor stops the arm, whatever the law wants; all assumed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Supervisor {
    /// Largest tissue stretch of the model \[mm\].
    pub tissue_stretch_mm: f64,
    /// Largest lateral force at the entry \[N\].
    pub entry_force_n: f64,
    /// Largest distance of the needle's base from the nominal axis through the entry \[mm\].
    pub workspace_radius_mm: f64,
    /// Lowest coordinates in World of a box that the needle's base never leaves \[mm\].
    pub workspace_min_mm: [f64; 3],
    /// Highest coordinates of that box \[mm\].
    pub workspace_max_mm: [f64; 3],
    /// Longest time without an image before the arm holds still \[ms\].
    pub image_hold_ms: f64,
    /// Longest time without an image before the run stops \[ms\].
    pub image_stop_ms: f64,
    /// Largest age of a measurement at its arrival \[ms\]: older ones are not taken, and a sensor
    /// all of whose measurements are older ends the run.
    pub image_age_ms: f64,
    /// Longest age of the encoders' reading before the run stops \[ms\].
    pub encoder_stop_ms: f64,
    /// Longest time without a dead-man's token before the run stops \[ms\]; 0: none is asked for.
    pub dead_man_ms: f64,
}

impl Default for Supervisor {
    fn default() -> Self {
        Self {
            tissue_stretch_mm: 2.4,
            entry_force_n: 5.0,
            workspace_radius_mm: 60.0,
            workspace_min_mm: [-FARTHEST_MM; 3],
            workspace_max_mm: [FARTHEST_MM; 3],
            image_hold_ms: 200.0,
            image_stop_ms: 2000.0,
            image_age_ms: 550.0,
            encoder_stop_ms: 350.0,
            dead_man_ms: 0.0,
        }
    }
}
