//! A map of what a field does to an electromagnetic tip: smooth in space, taken off every
//! measurement before anything looks at it.
//!
//! Errors of place and axis are Chebyshev polynomials of the measured place in a box: up to one
//! total degree across the insertion and up to another along it. Beyond the box they stay what they are at its
//! edge. `calibrate distortion` fits them ([`crate::identify::distortion`]).

use std::path::{Path, PathBuf};
use std::sync::Arc;

use hal::frame::{LeftCamera, World};
use hal::{Error, Position, SensedShape, ShapeSensor, Transform};
use nalgebra::{Matrix3, Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

/// Highest degree of a polynomial that is read.
const HIGHEST: usize = 20;

/// A map that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is no map.
    #[error("{}: not a map of `calibrate distortion`: {problem}", file.display())]
    Text {
        /// The file.
        file: PathBuf,
        /// What is wrong, with its line.
        problem: String,
    },
    /// A value.
    #[error("{}: key `{key}`: {problem}; make the map anew with `calibrate distortion`", file.display())]
    Value {
        /// The file.
        file: PathBuf,
        /// The key.
        key: &'static str,
        /// What was found and what was expected.
        problem: String,
    },
}

/// A vector field in a box.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Smooth {
    /// Highest total degree across the insertion.
    pub degree_across: usize,
    /// Highest degree along it.
    pub degree_along: usize,
    /// Root mean square per axis before the correction.
    pub before: f64,
    /// The same at places that were left out of the fit: what the map leaves.
    pub left: f64,
    /// Coefficients, in the order of [`terms`].
    pub coefficients: Vec<[f64; 3]>,
}

/// Errors of place and axis of a tip, by the measured place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DistortionMap {
    /// Coordinate along the insertion: 0, 1 or 2 for x, y or z.
    pub along: usize,
    /// Lowest coordinates of the box \[mm\].
    pub min_mm: [f64; 3],
    /// Highest coordinates of the box \[mm\].
    pub max_mm: [f64; 3],
    /// Measured places.
    pub places: usize,
    /// Noise of a single measurement per axis, as far as the table says \[mm\].
    pub noise_mm: f64,
    /// Error of the place \[mm\].
    pub place_mm: Smooth,
    /// Error of the axis \[mrad\].
    pub axis_mrad: Smooth,
}

/// Degrees of the terms of a polynomial: two across, one along.
pub fn terms(across: usize, along: usize) -> impl Iterator<Item = [usize; 3]> {
    (0..=across)
        .flat_map(move |i| (0..=across - i).flat_map(move |j| (0..=along).map(move |k| [i, j, k])))
}

/// Chebyshev's polynomials of the first kind at `x`, up to `degree`.
fn chebyshev(x: f64, degree: usize) -> Vec<f64> {
    let mut values = vec![1.0, x];
    for k in 2..=degree {
        values.push(2.0 * x * values[k - 1] - values[k - 2]);
    }
    values
}

/// Values of the terms at a place scaled to the box, coordinates across first.
pub(crate) fn basis(scaled: &[f64; 3], across: usize, along: usize) -> Vec<f64> {
    let [x, y] = [scaled[0], scaled[1]].map(|x| chebyshev(x, across));
    let z = chebyshev(scaled[2], along);
    terms(across, along)
        .map(|[i, j, k]| x[i] * y[j] * z[k])
        .collect()
}

/// A place \[mm\] scaled to a box, coordinates across first; held at its edge.
pub(crate) fn scaled(
    at_mm: &Vector3<f64>,
    min: &[f64; 3],
    max: &[f64; 3],
    along: usize,
) -> [f64; 3] {
    [(along + 1) % 3, (along + 2) % 3, along].map(|i| {
        let width = (max[i] - min[i]).max(f64::MIN_POSITIVE);
        (2.0 * (at_mm[i] - min[i]) / width - 1.0).clamp(-1.0, 1.0)
    })
}

impl Smooth {
    fn at(&self, scaled: &[f64; 3]) -> Vector3<f64> {
        basis(scaled, self.degree_across, self.degree_along)
            .iter()
            .zip(&self.coefficients)
            .map(|(value, by)| Vector3::from(*by) * *value)
            .sum()
    }

    fn check(&self, key: &'static str) -> Result<(), (&'static str, String)> {
        let most = self.degree_across.max(self.degree_along);
        if most > HIGHEST {
            return Err((
                key,
                format!("expected degrees up to {HIGHEST}, found {most}"),
            ));
        }
        let expected = terms(self.degree_across, self.degree_along).count();
        let found = self.coefficients.len();
        if found != expected {
            let problem = format!("expected {expected} coefficients, found {found}");
            return Err((key, problem));
        }
        let mut numbers = self.coefficients.iter().flatten();
        if !(numbers.all(|x| x.is_finite()) && self.left.is_finite() && self.left >= 0.0) {
            return Err((key, "expected finite numbers".to_owned()));
        }
        Ok(())
    }
}

impl DistortionMap {
    /// Reads a map.
    ///
    /// # Errors
    /// See [`MapError`].
    pub fn read(file: &Path) -> Result<Self, MapError> {
        let text = std::fs::read_to_string(file).map_err(|source| MapError::Read {
            file: file.to_owned(),
            source,
        })?;
        let map: Self = toml::from_str(&text).map_err(|error| MapError::Text {
            file: file.to_owned(),
            problem: error.to_string(),
        })?;
        map.check().map_err(|(key, problem)| MapError::Value {
            file: file.to_owned(),
            key,
            problem,
        })?;
        Ok(map)
    }

    fn check(&self) -> Result<(), (&'static str, String)> {
        if self.along > 2 {
            return Err(("along", format!("expected 0, 1 or 2, found {}", self.along)));
        }
        // What is not a number is not below another.
        if !self
            .min_mm
            .iter()
            .zip(&self.max_mm)
            .all(|(low, high)| low < high)
        {
            return Err(("min_mm", "expected less than max_mm".to_owned()));
        }
        if !(self.noise_mm.is_finite() && self.noise_mm >= 0.0) {
            return Err(("noise_mm", "expected a number from 0".to_owned()));
        }
        self.place_mm.check("place_mm")?;
        self.axis_mrad.check("axis_mrad")
    }

    fn scaled(&self, measured: &Point3<f64>) -> [f64; 3] {
        scaled(
            &(measured.coords * 1e3),
            &self.min_mm,
            &self.max_mm,
            self.along,
        )
    }

    /// Error of a place that is measured at `measured` (World) \[m\].
    pub fn of_place(&self, measured: &Point3<f64>) -> Vector3<f64> {
        self.place_mm.at(&self.scaled(measured)) * 1e-3
    }

    /// Error of an axis that is measured there \[rad\].
    pub fn of_axis(&self, measured: &Point3<f64>) -> Vector3<f64> {
        self.axis_mrad.at(&self.scaled(measured)) * 1e-3
    }

    /// Standard deviations per axis of what is left: place \[m\] and axis \[rad\].
    pub fn left(&self) -> (f64, f64) {
        (self.place_mm.left * 1e-3, self.axis_mrad.left * 1e-3)
    }
}

/// A sensor of the tip whose field is known.
pub(crate) struct Corrected {
    sensor: Box<dyn ShapeSensor>,
    map: Arc<DistortionMap>,
    left_from_world: Transform<LeftCamera, World>,
}

impl Corrected {
    pub(crate) fn new(
        sensor: Box<dyn ShapeSensor>,
        map: Arc<DistortionMap>,
        left_from_world: Transform<LeftCamera, World>,
    ) -> Self {
        Self {
            sensor,
            map,
            left_from_world,
        }
    }

    fn correct(&self, mut shape: SensedShape) -> SensedShape {
        let tip = &mut shape.tip;
        let world_from_left = self.left_from_world.inverse();
        let measured = world_from_left * tip.position;
        let (of_place, of_axis) = (
            self.map.of_place(measured.point()),
            self.map.of_axis(measured.point()),
        );
        tip.position = self.left_from_world * Position::new(measured.point() - of_place);
        let axis = world_from_left.rotate(&tip.direction) - of_axis;
        tip.direction = Unit::new_normalize(self.left_from_world.rotate(&axis));
        // What a sensor states holds what its field does; the map leaves less.
        let (place, axis) = self.map.left();
        let sigma = place.hypot(self.map.noise_mm * 1e-3);
        let stated = (tip.covariance.trace() / 3.0).sqrt();
        if sigma < stated {
            tip.covariance = Matrix3::from_diagonal_element(sigma * sigma);
        }
        tip.direction_sigma = tip.direction_sigma.min(axis.max(LEAST_AXIS));
        shape
    }
}

/// No axis is taken for better for a map \[rad\]: the noise of one measurement of a good coil.
const LEAST_AXIS: f64 = 3e-3;

impl ShapeSensor for Corrected {
    fn poll(&mut self) -> Result<Option<SensedShape>, Error> {
        let shape = self.sensor.poll()?;
        Ok(shape.map(|shape| self.correct(shape)))
    }

    fn hindrance(&self) -> Option<String> {
        self.sensor.hindrance()
    }
}
