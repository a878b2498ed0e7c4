//! The sensor of the tip alone.

use hybrid_control::TipSensor;
use serde::{Deserialize, Serialize};

use crate::distortion::DistortionMap;

/// The electromagnetic tip, for the sensor `em`, whoever measures it: what its field is known to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Em {
    /// Map of the field's distortion (`calibrate distortion`), taken off every measurement; empty: none.
    pub map: String,
    /// Standard deviation of the lasting error of the tip's place, per axis \[mm\]; with a map what
    /// that leaves counts in its place.
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
            map: String::new(),
            bias_mm: 0.6,
            axis_bias_mrad: 7.5,
            bias_length_mm: 25.0,
        }
    }
}

impl Em {
    /// What the estimator is told, with the map that is used.
    pub fn tip_sensor(&self, map: Option<&DistortionMap>) -> TipSensor {
        let told = (self.bias_mm * 1e-3, self.axis_bias_mrad * 1e-3);
        let (place_bias, axis_bias) = map.map_or(told, DistortionMap::left);
        TipSensor {
            place_bias,
            axis_bias,
            length: self.bias_length_mm * 1e-3,
        }
    }
}
