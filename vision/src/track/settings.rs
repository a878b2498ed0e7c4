//! What the tracker is told about the needle and how careful it is.

use nalgebra::{Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

use super::polynomial::MAX_POINTS;

/// A plane in the stereo frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Surface {
    /// A point of it \[m\].
    pub point: Point3<f64>,
    /// Its normal, out of the gel.
    pub normal: Unit<Vector3<f64>>,
}

/// Settings of the tracker.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackSettings {
    /// Control points of the curves: 4 (a cubic) to 6.
    pub control_points: usize,
    /// Normals along each image's curve.
    pub normals: usize,
    /// Outer diameter of the needle \[m\].
    pub needle_diameter: f64,
    /// Length of the bevel along the axis \[m\]; 0 is a flat tip.
    pub bevel_length: f64,
    /// Greatest distance of the shaft from its prediction, in needle widths.
    pub search_widths: f64,
    /// Greatest distance of the tip from its prediction, in needle widths.
    pub tip_search_widths: f64,
    /// Unpredicted motion of the shaft across itself, 1 sigma per image \[px\].
    pub lateral_drift_px: f64,
    /// Unpredicted motion of the tip along the needle, 1 sigma per image \[px\].
    pub tip_drift_px: f64,
    /// Errors common to a whole curve (uneven light, highlights, pixels), 1 sigma \[px\].
    pub systematic_px: f64,
    /// Share of the normals that must show the needle.
    pub min_survivors: f64,
    /// Images in a row without a measurement after which the needle is lost.
    pub lost_after: u32,
    /// Greatest time between the two exposures of a pair \[s\].
    pub max_skew: f64,
    /// The gel's surface; the shaft is followed below it only. Without it the curve begins at
    /// the guess's first point, or where the visible shaft begins.
    pub surface: Option<Surface>,
}

impl Default for TrackSettings {
    fn default() -> Self {
        let needle_diameter = 0.7e-3;
        Self {
            control_points: 4,
            normals: 60,
            needle_diameter,
            bevel_length: needle_diameter / 20f64.to_radians().tan(),
            search_widths: 3.5,
            tip_search_widths: 6.0,
            lateral_drift_px: 0.3,
            tip_drift_px: 0.12,
            systematic_px: 0.025,
            min_survivors: 0.4,
            lost_after: 3,
            max_skew: 2e-3,
            surface: None,
        }
    }
}

/// A setting outside its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("track.{name} = {value}: must be within {min} and {max}")]
pub struct TrackSettingsError {
    /// The setting.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Smallest allowed value.
    pub min: f64,
    /// Greatest allowed value.
    pub max: f64,
}

impl TrackSettings {
    /// Checks every setting against its range.
    ///
    /// # Errors
    /// The first setting outside its range (NaN is outside every range).
    pub fn validate(&self) -> Result<(), TrackSettingsError> {
        for (name, value, min, max) in [
            (
                "control_points",
                self.control_points as f64,
                4.0,
                MAX_POINTS as f64,
            ),
            ("normals", self.normals as f64, 20.0, 200.0),
            ("needle_diameter", self.needle_diameter, 1e-4, 5e-3),
            ("bevel_length", self.bevel_length, 0.0, 2e-2),
            ("search_widths", self.search_widths, 1.0, 10.0),
            ("tip_search_widths", self.tip_search_widths, 1.0, 20.0),
            ("lateral_drift_px", self.lateral_drift_px, 0.0, 10.0),
            ("tip_drift_px", self.tip_drift_px, 0.0, 10.0),
            ("systematic_px", self.systematic_px, 0.0, 5.0),
            ("min_survivors", self.min_survivors, 0.1, 0.95),
            ("lost_after", f64::from(self.lost_after), 1.0, 100.0),
            ("max_skew", self.max_skew, 0.0, 1.0),
        ] {
            if !(min..=max).contains(&value) {
                return Err(TrackSettingsError {
                    name,
                    value,
                    min,
                    max,
                });
            }
        }
        Ok(())
    }
}
