//! Settings of the tracker.

use serde::{Deserialize, Serialize};

use super::curve::MOST;

/// The needle as cameras see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Appearance {
    /// Outer diameter \[m\].
    pub diameter: f64,
    /// Length of the bevel along the axis \[m\]; 0 for a flat tip.
    pub bevel_length: f64,
}

/// What may be known of the images beforehand; without, it is found in them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hints {
    /// Blur, as a Gaussian, of images as they are \[px\].
    pub blur_px: Option<f64>,
    /// Whether the needle is brighter than what is behind it.
    pub bright: Option<bool>,
}

/// Settings of the tracker. Lengths in pixels are for images 640 px wide and grow with the
/// width.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackSettings {
    /// Control points of the curve: 4 (a cubic), 5 or 6.
    pub control_points: usize,
    /// Normals along which the shaft is measured.
    pub normals: usize,
    /// Farthest distance from the prediction at which shaft and tip are searched \[px\].
    pub search_px: f64,
    /// Shortest visible shaft that can be tracked \[px\].
    pub visible_px: f64,
    /// Images in a row without a good shaft or tip before the needle counts as lost.
    pub lost_after: u32,
    /// Change of the shaft between images that odometry does not explain \[px\].
    pub shaft_walk_px: f64,
    /// Error of the odometry's advance of the tip between images \[px\].
    pub advance_sigma_px: f64,
    /// Standard deviation of one measured normal that no noise explains: sampling, highlights
    /// \[px\].
    pub normal_floor_px: f64,
    /// The same of the tip along its axis \[px\].
    pub tip_floor_px: f64,
    /// Error of the tip's direction that stays from image to image, across the whole visible
    /// length \[px\].
    pub direction_floor_px: f64,
    /// Blur of the images, as a Gaussian \[px\].
    pub blur_px: f64,
}

impl Default for TrackSettings {
    fn default() -> Self {
        Self {
            control_points: 4,
            normals: 48,
            search_px: 12.0,
            visible_px: 12.0,
            lost_after: 3,
            shaft_walk_px: 0.10,
            advance_sigma_px: 0.15,
            normal_floor_px: 0.05,
            tip_floor_px: 0.06,
            direction_floor_px: 1.0,
            blur_px: 0.9,
        }
    }
}

/// Settings that make no tracker.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{key} = {value}: must be from {lowest} to {highest}")]
pub struct TrackSettingsError {
    /// Key of the setting.
    pub key: &'static str,
    /// The refused value.
    pub value: f64,
    /// Lowest allowed value.
    pub lowest: f64,
    /// Highest allowed value.
    pub highest: f64,
}

impl TrackSettings {
    /// Checks every range.
    ///
    /// # Errors
    /// The first setting outside its range.
    pub fn validate(&self) -> Result<(), TrackSettingsError> {
        within(
            "control_points",
            self.control_points as f64,
            4.0,
            MOST as f64,
        )?;
        within("normals", self.normals as f64, 20.0, 200.0)?;
        within("search_px", self.search_px, 4.0, 24.0)?;
        within("visible_px", self.visible_px, 6.0, 200.0)?;
        within("lost_after", f64::from(self.lost_after), 1.0, 30.0)?;
        within("shaft_walk_px", self.shaft_walk_px, 1e-3, 5.0)?;
        within("advance_sigma_px", self.advance_sigma_px, 1e-3, 5.0)?;
        within("normal_floor_px", self.normal_floor_px, 1e-3, 1.0)?;
        within("tip_floor_px", self.tip_floor_px, 1e-3, 2.0)?;
        within("direction_floor_px", self.direction_floor_px, 0.0, 10.0)?;
        within("blur_px", self.blur_px, 0.3, 5.0)
    }
}

impl Appearance {
    /// Checks every range.
    ///
    /// # Errors
    /// The first value outside its range.
    pub fn validate(&self) -> Result<(), TrackSettingsError> {
        within("diameter", self.diameter, 5e-5, 1e-2)?;
        within("bevel_length", self.bevel_length, 0.0, 2e-2)
    }
}

fn within(
    key: &'static str,
    value: f64,
    lowest: f64,
    highest: f64,
) -> Result<(), TrackSettingsError> {
    if value >= lowest && value <= highest {
        return Ok(());
    }
    Err(TrackSettingsError {
        key,
        value,
        lowest,
        highest,
    })
}
