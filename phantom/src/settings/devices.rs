//! Settings of the devices that a needle may have besides the arm that holds it.

use documented::DocumentedFields;
use serde::{Deserialize, Serialize};

use super::{SettingsError, within};

/// A coil in the tip, tracked in a field; without flaw by default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct EmSettings {
    /// Rate of measurements.
    pub rate_hz: f64,
    /// Delay from measurement to delivery.
    pub latency_ms: f64,
    /// Fraction of measurements that are lost.
    pub drop_fraction: f64,
    /// White noise of the place, per axis.
    pub noise_mm: f64,
    /// White noise of the axis, per axis.
    pub axis_noise_mrad: f64,
    /// Distortion of the place, standard deviation per axis; constant in time.
    pub distortion_mm: f64,
    /// Distortion of the axis, standard deviation per axis; constant in time.
    pub axis_distortion_mrad: f64,
    /// Distance at which the distortion's correlation has fallen to exp(-1/2).
    pub distortion_length_mm: f64,
    /// Standard deviation of the place that the sensor states beyond its noise.
    pub stated_mm: f64,
    /// The same of the axis.
    pub stated_mrad: f64,
    /// How far the coil sits behind the tip.
    pub setback_mm: f64,
}

impl Default for EmSettings {
    fn default() -> Self {
        Self {
            rate_hz: 40.0,
            latency_ms: 0.0,
            drop_fraction: 0.0,
            noise_mm: 0.0,
            axis_noise_mrad: 0.0,
            distortion_mm: 0.0,
            axis_distortion_mrad: 0.0,
            distortion_length_mm: 20.0,
            stated_mm: 0.0,
            stated_mrad: 0.0,
            setback_mm: 0.0,
        }
    }
}

impl EmSettings {
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        within("em.rate_hz", self.rate_hz, 1.0, 1000.0)?;
        within("em.latency_ms", self.latency_ms, 0.0, 1000.0)?;
        within("em.drop_fraction", self.drop_fraction, 0.0, 0.95)?;
        within("em.noise_mm", self.noise_mm, 0.0, 5.0)?;
        within("em.axis_noise_mrad", self.axis_noise_mrad, 0.0, 300.0)?;
        within("em.distortion_mm", self.distortion_mm, 0.0, 10.0)?;
        within(
            "em.axis_distortion_mrad",
            self.axis_distortion_mrad,
            0.0,
            300.0,
        )?;
        within(
            "em.distortion_length_mm",
            self.distortion_length_mm,
            1.0,
            1000.0,
        )?;
        within("em.stated_mm", self.stated_mm, 0.0, 10.0)?;
        within("em.stated_mrad", self.stated_mrad, 0.0, 300.0)?;
        within("em.setback_mm", self.setback_mm, 0.0, 30.0)
    }

    #[cfg(test)]
    pub(crate) fn measured() -> Self {
        super::Settings::preset("paper").unwrap().em
    }
}

/// Fibre Bragg gratings in the needle; without flaw by default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct FbgSettings {
    /// Rate of readings.
    pub rate_hz: f64,
    /// Delay from reading to delivery.
    pub latency_ms: f64,
    /// Fraction of readings that are lost.
    pub drop_fraction: f64,
    /// White noise of a wavelength.
    pub noise_pm: f64,
    /// Lasting error of a wavelength, each channel's own, standard deviation.
    pub drift_pm: f64,
    /// Error of the calibration: factor on an area's curvature, standard deviation over 1.
    pub gain_error: f64,
    /// The same: turn of an area's fibres about the needle, standard deviation.
    pub azimuth_error_deg: f64,
    /// Turn of all fibres in the needle's holder, standard deviation.
    pub roll_error_deg: f64,
    /// By how much areas in the gel get warmer.
    pub warming_k: f64,
    /// Time constant of that.
    pub warming_s: f64,
    /// Shift by warmth.
    pub thermal_pm_k: f64,
    /// Difference of that between channels, standard deviation over its size.
    pub thermal_mismatch: f64,
    /// Length of a grating.
    pub grating_mm: f64,
}

impl Default for FbgSettings {
    fn default() -> Self {
        Self {
            rate_hz: 30.0,
            latency_ms: 0.0,
            drop_fraction: 0.0,
            noise_pm: 0.0,
            drift_pm: 0.0,
            gain_error: 0.0,
            azimuth_error_deg: 0.0,
            roll_error_deg: 0.0,
            warming_k: 0.0,
            warming_s: 5.0,
            thermal_pm_k: 0.0,
            thermal_mismatch: 0.0,
            grating_mm: 5.0,
        }
    }
}

impl FbgSettings {
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        within("fbg.rate_hz", self.rate_hz, 1.0, 1000.0)?;
        within("fbg.latency_ms", self.latency_ms, 0.0, 1000.0)?;
        within("fbg.drop_fraction", self.drop_fraction, 0.0, 0.95)?;
        within("fbg.noise_pm", self.noise_pm, 0.0, 1000.0)?;
        within("fbg.drift_pm", self.drift_pm, 0.0, 1000.0)?;
        within("fbg.gain_error", self.gain_error, 0.0, 0.5)?;
        within("fbg.azimuth_error_deg", self.azimuth_error_deg, 0.0, 45.0)?;
        within("fbg.roll_error_deg", self.roll_error_deg, 0.0, 45.0)?;
        within("fbg.warming_k", self.warming_k, -50.0, 50.0)?;
        within("fbg.warming_s", self.warming_s, 1e-3, 1e4)?;
        within("fbg.thermal_pm_k", self.thermal_pm_k, 0.0, 100.0)?;
        within("fbg.thermal_mismatch", self.thermal_mismatch, 0.0, 1.0)?;
        within("fbg.grating_mm", self.grating_mm, 0.1, 20.0)
    }
}

/// A guide in which the needle slides.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct GuideSettings {
    /// From its exit to the tissue; 0: there is no guide.
    pub gap_mm: f64,
}

/// A hand that pushes the needle, where no axis does. All assumed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct HandSettings {
    /// Speed of a step; short ones take half a second at least.
    pub speed_mm_s: f64,
    /// Error of a step's length over its length, standard deviation: steps of 5 mm are 1 to 3 mm off.
    pub step_error: f64,
    /// Pause before a step that is asked for; each is between half and one and a half of it.
    pub pause_s: f64,
    /// Time until the hand holds when it is asked to.
    pub reaction_s: f64,
}

impl Default for HandSettings {
    fn default() -> Self {
        Self {
            speed_mm_s: 4.0,
            step_error: 0.3,
            pause_s: 1.5,
            reaction_s: 0.3,
        }
    }
}

impl HandSettings {
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        within("hand.speed_mm_s", self.speed_mm_s, 0.1, 50.0)?;
        within("hand.step_error", self.step_error, 0.0, 1.0)?;
        within("hand.pause_s", self.pause_s, 0.0, 60.0)?;
        within("hand.reaction_s", self.reaction_s, 0.0, 5.0)
    }
}
