//! Presets of the rig's flaws.

use super::settings::{
    BacklightSettings, BubbleSettings, CalibrationSettings, CameraSettings, DeliverySettings,
    NoiseSettings, OpticsSettings,
};
use crate::settings::merge;

impl CameraSettings {
    /// The cameras that belong to a preset of the phantom ([`crate::settings::PRESETS`]).
    ///
    /// # Errors
    /// No preset has this name.
    pub fn preset(name: &str) -> Result<Self, crate::SettingsError> {
        match name {
            "ideal" => Ok(Self::ideal()),
            "paper" | "paper-compliant" | "gel-guide" | "ex-vivo-guide" | "kinked" => {
                Ok(Self::paper())
            }
            "harsh" => Ok(Self::harsh()),
            _ => Err(crate::SettingsError::UnknownPreset {
                name: name.to_owned(),
            }),
        }
    }

    /// These settings with the keys of `changes` replaced; tables are merged, arrays replaced.
    /// The values are checked where a rig is built from them.
    ///
    /// # Errors
    /// An unknown key or a wrong type.
    pub fn overridden(&self, changes: toml::Table) -> Result<Self, crate::SettingsError> {
        // Settings are plain numbers, so they always make a table.
        let mut table = toml::Table::try_from(self).unwrap_or_default();
        merge(&mut table, changes);
        Ok(table.try_into()?)
    }

    /// The default rig with every flaw off.
    pub fn ideal() -> Self {
        Self::default()
    }

    /// The flaws of a careful laboratory. All assumed; corners at 0.1 px per axis are what a
    /// sub-pixel refinement reaches on sharp boards.
    pub fn paper() -> Self {
        Self {
            principal_offset_px: [[6.3, -4.1], [-5.2, 3.7]],
            distortion: [
                [-0.12, 0.10, 4e-4, -3e-4, 0.0],
                [-0.10, 0.08, -3e-4, 5e-4, 0.0],
            ],
            backlight: BacklightSettings {
                gradient: 0.15,
                vignetting: 0.10,
                moire: 0.008,
                clouds: 0.01,
                outline: true,
                ..BacklightSettings::default()
            },
            optics: OpticsSettings {
                blur_sigma_px: 0.8,
                haze: 0.08,
                specular_grey: 60.0,
                ..OpticsSettings::default()
            },
            bubbles: BubbleSettings {
                count: 40,
                ..BubbleSettings::default()
            },
            noise: NoiseSettings {
                gaussian_grey: 1.0,
                poisson_grey: 0.02,
            },
            delivery: DeliverySettings {
                latency_min_ms: 30.0,
                latency_max_ms: 60.0,
                drop_probability: 0.02,
            },
            calibration: CalibrationSettings {
                views: 20,
                corner_sigma_px: 0.1,
                drift_mrad: 0.2,
                container_mm: 0.2,
                container_deg: 0.1,
                gel_index: 0.003,
                registration_mm: 0.3,
                registration_deg: 0.05,
            },
            ..Self::default()
        }
    }

    /// A poor day: low contrast, blur, noise, clutter, drops. All assumed.
    pub fn harsh() -> Self {
        let paper = Self::paper();
        Self {
            backlight: BacklightSettings {
                gradient: 0.3,
                vignetting: 0.2,
                moire: 0.02,
                clouds: 0.03,
                ..paper.backlight
            },
            optics: OpticsSettings {
                blur_sigma_px: 1.5,
                haze: 0.5,
                ..paper.optics
            },
            bubbles: BubbleSettings {
                count: 300,
                ..paper.bubbles
            },
            noise: NoiseSettings {
                gaussian_grey: 4.0,
                poisson_grey: 0.05,
            },
            delivery: DeliverySettings {
                latency_min_ms: 60.0,
                latency_max_ms: 100.0,
                drop_probability: 0.30,
            },
            calibration: CalibrationSettings {
                corner_sigma_px: 0.2,
                ..paper.calibration
            },
            ..paper
        }
    }

    /// The same scene on a sensor of 1280 x 960 with pixels of half the size: what is measured
    /// in pixels doubles.
    #[must_use]
    pub fn at_1280(mut self) -> Self {
        let scale = 1280.0 / self.width_px as f64;
        (self.width_px, self.height_px) = (1280, 960);
        self.focal_px *= scale;
        self.principal_offset_px = self.principal_offset_px.map(|o| o.map(|v| v * scale));
        self.optics.blur_sigma_px *= scale;
        self.backlight.moire_period_px *= scale;
        self
    }
}
