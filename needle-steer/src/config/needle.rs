//! The needle, and what holds it.

use serde::{Deserialize, Serialize};

/// The needle as the controller knows it; defaults from the paper, the bevel angle assumed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Needle {
    /// Free length outside the holder \[mm\].
    pub length_mm: f64,
    /// Outer diameter \[mm\].
    pub outer_diameter_mm: f64,
    /// Inner diameter \[mm\].
    pub inner_diameter_mm: f64,
    /// Young's modulus \[GPa\].
    pub young_modulus_gpa: f64,
    /// Bevel angle \[deg\].
    pub bevel_deg: f64,
    /// What holds the needle.
    pub support: NeedleSupport,
    /// Distance of a guide's exit from the tissue \[mm\], in recordings at their start; 0: as their
    /// pose says, and no run.
    pub guide_gap_mm: f64,
    /// Its standard deviation \[mm\]; 0: the pose's is true.
    pub guide_gap_sigma_mm: f64,
    /// How far a tip sensor sits behind the tip \[mm\].
    pub sensor_setback_mm: f64,
    /// Measured turn of the tip's axis that no motion explains, along x and y of the support at the
    /// start \[rad/m\].
    pub axis_drift_rad_per_m: [f64; 2],
    /// The same of the tip's position \[mm/m\].
    pub tip_drift_mm_per_m: [f64; 2],
}

/// What holds the needle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NeedleSupport {
    /// Its base is clamped.
    #[default]
    Base,
    /// It slides through a guide that moves with its base across the insertion.
    Guide,
}

impl Default for Needle {
    fn default() -> Self {
        Self {
            length_mm: 126.0,
            outer_diameter_mm: 0.70,
            inner_diameter_mm: 0.48,
            young_modulus_gpa: 200.0,
            bevel_deg: 24.0,
            support: NeedleSupport::Base,
            guide_gap_mm: 0.0,
            guide_gap_sigma_mm: 0.0,
            sensor_setback_mm: 0.0,
            axis_drift_rad_per_m: [0.0; 2],
            tip_drift_mm_per_m: [0.0; 2],
        }
    }
}
