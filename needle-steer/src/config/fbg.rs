//! Fibres in the needle.

use serde::{Deserialize, Serialize};

use super::check::{positive, within};
use super::{Backend, Config, Invalid, SensorKind};

/// From where a calibration's file counts the places of its areas.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LocationsFrom {
    /// From the needle's base.
    #[default]
    Base,
    /// From its tip.
    Tip,
}

/// Fibre Bragg gratings, for the sensor `fbg`: how shifts of wavelengths make a shape, and how well.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Fbg {
    /// Calibration of the needle as packages for shape sensing write it, JSON; empty: `fibres` evenly around
    /// it, without a flaw that is known.
    pub calibration: String,
    /// From where its file counts places.
    pub locations_from: LocationsFrom,
    /// Without a file: places of the active areas, from the tip \[mm\].
    pub areas_mm: Vec<f64>,
    /// Without a file: number of fibres.
    pub fibres: usize,
    /// Without a file: distance of the fibres from the needle's axis \[mm\].
    pub radius_mm: f64,
    /// Without a file: wavelength of the gratings \[nm\].
    pub wavelength_nm: f64,
    /// Turn of the fibres' frame in the needle's, about its z \[deg\].
    pub roll_deg: f64,
    /// Standard deviation of that \[deg\].
    pub roll_sigma_deg: f64,
    /// By how much the needle follows its encoders late: with a needle that spins, fibres turn meanwhile \[ms\].
    pub lag_ms: f64,
    /// Standard deviation of that \[ms\].
    pub lag_sigma_ms: f64,
    /// White noise of a wavelength \[pm\].
    pub noise_pm: f64,
    /// Lasting error of a wavelength \[pm\].
    pub drift_pm: f64,
    /// Standard deviation of the factor by which an area's curvature is wrong.
    pub gain_sigma: f64,
    /// Standard deviation of the curvature that the needle may have between its areas \[1/m\].
    pub curvature_sigma_per_m: f64,
    /// Way over which it changes \[mm\].
    pub curvature_length_mm: f64,
    /// Feature switch: estimate lasting errors of the tip's place and axis beside the tip, as of an electromagnetic
    /// one; else each measurement counts for its whole error.
    pub lasting: bool,
    /// Turn of the needle per length about x and y of the fibres' frame where the wavelengths are not shifted
    /// \[1/m\].
    pub natural_curvature_per_m: [f64; 2],
}

impl Default for Fbg {
    fn default() -> Self {
        Self {
            calibration: String::new(),
            locations_from: LocationsFrom::Base,
            areas_mm: vec![100.0, 65.0, 30.0, 10.0],
            fibres: 3,
            radius_mm: 0.25,
            wavelength_nm: 1550.0,
            roll_deg: 0.0,
            roll_sigma_deg: 1.4,
            lag_ms: 12.0,
            lag_sigma_ms: 4.0,
            noise_pm: 2.0,
            drift_pm: 2.0,
            gain_sigma: 0.03,
            curvature_sigma_per_m: 2.0,
            curvature_length_mm: 30.0,
            lasting: true,
            natural_curvature_per_m: [0.0, 0.0],
        }
    }
}

impl Config {
    pub(super) fn validate_fbg(&self) -> Result<(), Invalid> {
        let fbg = &self.fbg;
        positive("fbg.radius_mm", fbg.radius_mm, 5.0)?;
        within("fbg.fibres", fbg.fibres as f64, 3.0, 16.0)?;
        within("fbg.wavelength_nm", fbg.wavelength_nm, 400.0, 2500.0)?;
        within("fbg.roll_deg", fbg.roll_deg, -360.0, 360.0)?;
        within("fbg.roll_sigma_deg", fbg.roll_sigma_deg, 0.0, 90.0)?;
        within("fbg.lag_ms", fbg.lag_ms, 0.0, 200.0)?;
        within("fbg.lag_sigma_ms", fbg.lag_sigma_ms, 0.0, 200.0)?;
        positive("fbg.noise_pm", fbg.noise_pm, 1000.0)?;
        within("fbg.drift_pm", fbg.drift_pm, 0.0, 1000.0)?;
        within("fbg.gain_sigma", fbg.gain_sigma, 0.0, 0.5)?;
        positive(
            "fbg.curvature_sigma_per_m",
            fbg.curvature_sigma_per_m,
            100.0,
        )?;
        within(
            "fbg.curvature_length_mm",
            fbg.curvature_length_mm,
            1.0,
            1000.0,
        )?;
        for value in fbg.natural_curvature_per_m {
            within("fbg.natural_curvature_per_m", value, -50.0, 50.0)?;
        }
        let refused = |key: &str, problem: String| {
            Err(Invalid {
                key: key.to_owned(),
                problem,
            })
        };
        let mut areas = fbg.areas_mm.clone();
        areas.sort_by(f64::total_cmp);
        if areas.is_empty() || areas.windows(2).any(|pair| pair[1] - pair[0] < 1.0) {
            return refused(
                "fbg.areas_mm",
                "expected one place or more, at least 1 mm apart".to_owned(),
            );
        }
        if self.run.sensor != SensorKind::Fbg {
            return Ok(());
        }
        if fbg.calibration.is_empty() {
            for place in areas {
                within("fbg.areas_mm", place, 0.0, self.needle.length_mm)?;
            }
        }
        if self.run.backend == Backend::Ros
            || (self.run.backend == Backend::Viper && !self.viper.emulate)
        {
            return refused(
                "run.sensor",
                "gratings are read in simulation alone (backend sim, or viper with viper.emulate): over ROS send \
                 the shape that they make, and set run.sensor = \"shape\""
                    .to_owned(),
            );
        }
        Ok(())
    }
}
