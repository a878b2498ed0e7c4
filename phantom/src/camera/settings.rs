//! Settings of the stereo rig. Defaults are the default rig with every flaw off.
//!
//! "Assumed" values have no source in \[Chevrie2016\]; they are typical of machine-vision cameras
//! before a gelatin phantom.

use documented::DocumentedFields;
use serde::{Deserialize, Serialize};

use crate::settings::{SettingsError, within};

/// The stereo rig: two cameras, each square to its own wall of the gel's container.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(default, deny_unknown_fields)]
pub struct CameraSettings {
    /// Width of both images \[px\].
    pub width_px: usize,
    /// Height of both images \[px\].
    pub height_px: usize,
    /// Focal length of both cameras \[px\].
    pub focal_px: f64,
    /// Principal points from the images' centres, left and right \[px\].
    pub principal_offset_px: [[f64; 2]; 2],
    /// Brown-Conrady coefficients k1, k2, p1, p2, k3, left and right.
    pub distortion: [[f64; 5]; 2],
    /// From each camera's centre to the gel's centre \[mm\].
    pub distance_mm: f64,
    /// Angle between the cameras' axes \[deg\].
    pub separation_deg: f64,
    /// Azimuth of the middle between the cameras about the phantom's z axis, from its x \[deg\].
    pub azimuth_deg: f64,
    /// Exposures per second \[Hz\].
    pub rate_hz: f64,
    /// Container and gel.
    pub container: ContainerSettings,
    /// White screen behind the gel.
    pub backlight: BacklightSettings,
    /// Lens and needle's surface.
    pub optics: OpticsSettings,
    /// Bubbles in the gel.
    pub bubbles: BubbleSettings,
    /// The sensor's noise.
    pub noise: NoiseSettings,
    /// Latency and drops.
    pub delivery: DeliverySettings,
    /// Errors of what the controller is told about the rig.
    pub calibration: CalibrationSettings,
}

impl CameraSettings {
    /// What a key means, `key` or `table.key`: its documentation.
    pub fn meaning(key: &str) -> Option<&'static str> {
        let Some((table, key)) = key.split_once('.') else {
            return Self::get_field_docs(key).ok();
        };
        match table {
            "container" => ContainerSettings::get_field_docs(key),
            "backlight" => BacklightSettings::get_field_docs(key),
            "optics" => OpticsSettings::get_field_docs(key),
            "bubbles" => BubbleSettings::get_field_docs(key),
            "noise" => NoiseSettings::get_field_docs(key),
            "delivery" => DeliverySettings::get_field_docs(key),
            "calibration" => CalibrationSettings::get_field_docs(key),
            _ => return None,
        }
        .ok()
    }
}

/// Container and gel. Indices are assumed: 1.49 is acrylic glass; gelatin has 1.34-1.36.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(default, deny_unknown_fields)]
pub struct ContainerSettings {
    /// From the gel's centre to the inner faces of the walls \[mm\].
    pub gel_half_width_mm: f64,
    /// Depth of the gel; its centre, at which the cameras aim, lies at half of it \[mm\].
    pub gel_depth_mm: f64,
    /// Thickness of the walls \[mm\].
    pub wall_mm: f64,
    /// Refractive index of the walls.
    pub wall_index: f64,
    /// Refractive index of the gel.
    pub gel_index: f64,
}

/// White screen behind the gel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(default, deny_unknown_fields)]
pub struct BacklightSettings {
    /// Grey level of the screen at the image's centre.
    pub level_grey: f64,
    /// Change of brightness across the image's width, as a fraction of the level, in a random
    /// direction.
    pub gradient: f64,
    /// Loss of brightness in the image's corners, as a fraction.
    pub vignetting: f64,
    /// Amplitude of the moire of the screen's pixels, as a fraction.
    pub moire: f64,
    /// Period of the moire \[px\].
    pub moire_period_px: f64,
    /// Uneven transmission of the gel on a scale of a ninth of the image, 1 sigma, as a fraction.
    pub clouds: f64,
    /// Whether to draw the gel's outline: the container's edges, its floor, the meniscus, and
    /// the gel's absorption.
    pub outline: bool,
}

/// Lens and needle's surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(default, deny_unknown_fields)]
pub struct OpticsSettings {
    /// Standard deviation of the Gaussian point-spread function \[px\].
    pub blur_sigma_px: f64,
    /// Grey level of the needle's dark side.
    pub needle_grey: f64,
    /// Light scattered by the gel, as a fraction: what it takes from the needle's contrast.
    pub haze: f64,
    /// Grey levels that the highlight along the shaft adds at its brightest.
    pub specular_grey: f64,
}

/// Bubbles in the gel, at random places.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(default, deny_unknown_fields)]
pub struct BubbleSettings {
    /// Number of bubbles.
    pub count: usize,
    /// Smallest radius \[mm\].
    pub radius_min_mm: f64,
    /// Largest radius \[mm\].
    pub radius_max_mm: f64,
}

/// The sensor's noise. Shot noise is taken as Gaussian of the Poisson variance: with the
/// hundreds of electrons of even a dark pixel the two are alike.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(default, deny_unknown_fields)]
pub struct NoiseSettings {
    /// Standard deviation of the read-out noise \[grey\].
    pub gaussian_grey: f64,
    /// Variance of the shot noise per grey level of signal \[grey\]: the inverse of the number of
    /// electrons per grey level.
    pub poisson_grey: f64,
}

/// Latency and drops.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(default, deny_unknown_fields)]
pub struct DeliverySettings {
    /// Shortest time from exposure to delivery \[ms\].
    pub latency_min_ms: f64,
    /// Longest time from exposure to delivery \[ms\]; uniform in between, never out of order.
    pub latency_max_ms: f64,
    /// Probability that a pair never arrives.
    pub drop_probability: f64,
}

/// Errors of what the controller is told about the rig.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrationSettings {
    /// Number of views of the calibration whose covariance the error of intrinsics and
    /// extrinsics is drawn from.
    pub views: usize,
    /// Error of each corner in these views, per axis, 1 sigma \[px\]; 0 means a perfect
    /// calibration.
    pub corner_sigma_px: f64,
    /// Rotation of the right camera against the left one since the calibration (mounts creep),
    /// per axis, 1 sigma \[mrad\].
    pub drift_mrad: f64,
    /// Error of the container's position, per axis, 1 sigma \[mm\].
    pub container_mm: f64,
    /// Error of the container's orientation, per axis, 1 sigma \[deg\].
    pub container_deg: f64,
    /// Error of the gel's refractive index, 1 sigma.
    pub gel_index: f64,
    /// Error of the registration with the laboratory, position, per axis, 1 sigma \[mm\].
    pub registration_mm: f64,
    /// Error of the registration with the laboratory, orientation, per axis, 1 sigma \[deg\].
    pub registration_deg: f64,
}

impl Default for CameraSettings {
    fn default() -> Self {
        Self {
            width_px: 640,
            height_px: 480,
            focal_px: 2000.0,
            principal_offset_px: [[0.0; 2]; 2],
            distortion: [[0.0; 5]; 2],
            distance_mm: 500.0,
            separation_deg: 90.0,
            azimuth_deg: 0.0,
            rate_hz: 30.0,
            container: ContainerSettings::default(),
            backlight: BacklightSettings::default(),
            optics: OpticsSettings::default(),
            bubbles: BubbleSettings::default(),
            noise: NoiseSettings::default(),
            delivery: DeliverySettings::default(),
            calibration: CalibrationSettings::default(),
        }
    }
}

impl Default for ContainerSettings {
    fn default() -> Self {
        Self {
            gel_half_width_mm: 50.0,
            gel_depth_mm: 100.0,
            wall_mm: 3.0,
            wall_index: 1.49,
            gel_index: 1.35,
        }
    }
}

impl Default for BacklightSettings {
    fn default() -> Self {
        Self {
            level_grey: 200.0,
            gradient: 0.0,
            vignetting: 0.0,
            moire: 0.0,
            moire_period_px: 7.0,
            clouds: 0.0,
            outline: false,
        }
    }
}

impl Default for OpticsSettings {
    fn default() -> Self {
        Self {
            blur_sigma_px: 0.0,
            needle_grey: 20.0,
            haze: 0.0,
            specular_grey: 0.0,
        }
    }
}

impl Default for BubbleSettings {
    fn default() -> Self {
        Self {
            count: 0,
            radius_min_mm: 0.1,
            radius_max_mm: 0.6,
        }
    }
}

impl Default for NoiseSettings {
    fn default() -> Self {
        Self {
            gaussian_grey: 0.0,
            poisson_grey: 0.0,
        }
    }
}

impl Default for DeliverySettings {
    fn default() -> Self {
        Self {
            latency_min_ms: 0.0,
            latency_max_ms: 0.0,
            drop_probability: 0.0,
        }
    }
}

impl Default for CalibrationSettings {
    fn default() -> Self {
        Self {
            views: 20,
            corner_sigma_px: 0.0,
            drift_mrad: 0.0,
            container_mm: 0.0,
            container_deg: 0.0,
            gel_index: 0.0,
            registration_mm: 0.0,
            registration_deg: 0.0,
        }
    }
}

impl CameraSettings {
    /// Checks every setting against its physical range.
    ///
    /// # Errors
    /// The first setting outside its range, with the range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let c = &self.container;
        let (b, o, k) = (&self.backlight, &self.optics, &self.calibration);
        within("width_px", self.width_px as f64, 32.0, 4096.0)?;
        within("height_px", self.height_px as f64, 32.0, 4096.0)?;
        within("focal_px", self.focal_px, 100.0, 50_000.0)?;
        for offset in self.principal_offset_px.as_flattened() {
            within("principal_offset_px", *offset, -200.0, 200.0)?;
        }
        for [k1, k2, p1, p2, k3] in self.distortion {
            within("distortion k1", k1, -1.0, 1.0)?;
            within("distortion k2", k2, -5.0, 5.0)?;
            within("distortion p1", p1, -0.02, 0.02)?;
            within("distortion p2", p2, -0.02, 0.02)?;
            within("distortion k3", k3, -50.0, 50.0)?;
        }
        within(
            "container.gel_half_width_mm",
            c.gel_half_width_mm,
            10.0,
            300.0,
        )?;
        within("container.gel_depth_mm", c.gel_depth_mm, 20.0, 500.0)?;
        within("container.wall_mm", c.wall_mm, 0.0, 30.0)?;
        within("container.wall_index", c.wall_index, 1.0, 2.0)?;
        within("container.gel_index", c.gel_index, 1.0, 1.7)?;
        let nearest = c.gel_half_width_mm + c.wall_mm + 50.0;
        within("distance_mm", self.distance_mm, nearest, 5000.0)?;
        within("separation_deg", self.separation_deg, 5.0, 120.0)?;
        within("azimuth_deg", self.azimuth_deg, -360.0, 360.0)?;
        within("rate_hz", self.rate_hz, 0.1, 1000.0)?;
        within("backlight.level_grey", b.level_grey, 10.0, 255.0)?;
        within("backlight.gradient", b.gradient, 0.0, 1.0)?;
        within("backlight.vignetting", b.vignetting, 0.0, 0.9)?;
        within("backlight.moire", b.moire, 0.0, 0.5)?;
        within("backlight.moire_period_px", b.moire_period_px, 2.0, 1000.0)?;
        within("backlight.clouds", b.clouds, 0.0, 0.2)?;
        within("optics.blur_sigma_px", o.blur_sigma_px, 0.0, 8.0)?;
        within("optics.needle_grey", o.needle_grey, 0.0, b.level_grey)?;
        within("optics.haze", o.haze, 0.0, 0.99)?;
        within("optics.specular_grey", o.specular_grey, 0.0, 255.0)?;
        within("bubbles.count", self.bubbles.count as f64, 0.0, 5000.0)?;
        within(
            "bubbles.radius_min_mm",
            self.bubbles.radius_min_mm,
            0.01,
            5.0,
        )?;
        let smallest = self.bubbles.radius_min_mm;
        within(
            "bubbles.radius_max_mm",
            self.bubbles.radius_max_mm,
            smallest,
            5.0,
        )?;
        within("noise.gaussian_grey", self.noise.gaussian_grey, 0.0, 20.0)?;
        within("noise.poisson_grey", self.noise.poisson_grey, 0.0, 1.0)?;
        let d = &self.delivery;
        within("delivery.latency_min_ms", d.latency_min_ms, 0.0, 2000.0)?;
        within(
            "delivery.latency_max_ms",
            d.latency_max_ms,
            d.latency_min_ms,
            2000.0,
        )?;
        within("delivery.drop_probability", d.drop_probability, 0.0, 1.0)?;
        within("calibration.views", k.views as f64, 3.0, 200.0)?;
        within("calibration.corner_sigma_px", k.corner_sigma_px, 0.0, 5.0)?;
        within("calibration.drift_mrad", k.drift_mrad, 0.0, 50.0)?;
        within("calibration.container_mm", k.container_mm, 0.0, 20.0)?;
        within("calibration.container_deg", k.container_deg, 0.0, 10.0)?;
        within("calibration.gel_index", k.gel_index, 0.0, 0.05)?;
        within("calibration.registration_mm", k.registration_mm, 0.0, 50.0)?;
        within(
            "calibration.registration_deg",
            k.registration_deg,
            0.0,
            20.0,
        )
    }
}
