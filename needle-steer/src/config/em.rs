//! The sensor of the tip alone.

use hybrid_control::TipSensor;
use serde::{Deserialize, Serialize};

/// The electromagnetic tip, for the sensor `em`, whoever measures it: what its field is known to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Em {
    /// Standard deviation of the lasting error of the tip's place, per axis \[mm\].
    pub bias_mm: f64,
    /// The same of its axis \[mrad\].
    pub axis_bias_mrad: f64,
    /// Way over which these errors change \[mm\].
    pub bias_length_mm: f64,
}

impl Default for Em {
    /// The field of Bernardes et al. (Brigham and Women's Hospital, 2022), as phantom/data/em.toml has
    /// it.
    fn default() -> Self {
        Self {
            bias_mm: 0.6,
            axis_bias_mrad: 7.5,
            bias_length_mm: 25.0,
        }
    }
}

impl Em {
    /// What the estimator is told.
    pub fn tip_sensor(&self) -> TipSensor {
        TipSensor {
            place_bias: self.bias_mm * 1e-3,
            axis_bias: self.axis_bias_mrad * 1e-3,
            length: self.bias_length_mm * 1e-3,
        }
    }
}
