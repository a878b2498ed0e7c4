//! Settings of the plant `continuum`.

use documented::DocumentedFields;
use serde::{Deserialize, Serialize};

use super::{SettingsError, within};

/// The bevel and the surface of [`ContinuumPlant`](crate::ContinuumPlant). All assumed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct ContinuumSettings {
    /// Pressure of the tissue on the bevel's face while it cuts, over its shear modulus (makes the
    /// paper's uncontrolled miss; tens are what a punch needs in a soft, tough solid).
    pub face_pressure_ratio: f64,
    /// Stiffness of the tissue against the edge that presses on it before it cuts, along and aside
    /// (assumed; 100-1000).
    pub indent_n_m: f64,
    /// Force to puncture the surface (assumed; gel 0.1-1).
    pub puncture_n: f64,
    /// Distance of the slit from the needle's axis over its radius: 2/pi for the front half of the
    /// rim, 1 for its foremost point alone; less where the heel widens it (assumed).
    pub edge_offset_ratio: f64,
    /// Length of cut over which the slit remembers the bevel's directions (by the curvature that
    /// photographed needles keep while they spin).
    pub slit_memory_mm: f64,
}

impl Default for ContinuumSettings {
    fn default() -> Self {
        Self {
            face_pressure_ratio: 14.0,
            indent_n_m: 200.0,
            puncture_n: 0.5,
            edge_offset_ratio: 0.3,
            slit_memory_mm: 4.0,
        }
    }
}

impl ContinuumSettings {
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        let ratio = self.face_pressure_ratio;
        within("continuum.face_pressure_ratio", ratio, 0.0, 300.0)?;
        within("continuum.indent_n_m", self.indent_n_m, 50.0, 1e5)?;
        within("continuum.puncture_n", self.puncture_n, 0.0, 5.0)?;
        let offset = self.edge_offset_ratio;
        within("continuum.edge_offset_ratio", offset, 0.0, 1.0)?;
        within("continuum.slit_memory_mm", self.slit_memory_mm, 0.1, 30.0)
    }
}
