//! A phantom that is stepped by hand.

use std::sync::{Mutex, MutexGuard, PoisonError};

use hal::Stamp;
use nalgebra::Vector3;
use needle_steer::env::Hand;
use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{isometry, places, pose, shown, vector};
use crate::convert::config_of;
use crate::errors::input;
use crate::run::seed_of;
use crate::work::detached;

/// A needle in tissue that goes where its base is put: the world that controllers are judged in, with
/// robot flaws and the fast sensor, in World and SI units. `help(needle_steer.Phantom.truth)` says
/// what is hidden from a controller.
#[pyclass(frozen, module = "needle_steer")]
pub(crate) struct Phantom(Mutex<Hand>);

impl Phantom {
    fn hand(&self) -> MutexGuard<'_, Hand> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Phantom {
    /// The phantom of a configuration: `run.phantom` is its preset, `[phantom]` changes that, `seed`
    /// says which of the population; the tip on the surface.
    #[new]
    #[pyo3(signature = (config=None, *, seed=None, set=None))]
    fn new(
        config: Option<&Bound<'_, PyAny>>,
        seed: Option<&Bound<'_, PyAny>>,
        set: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let seed = seed.map(|seed| seed_of(seed)).transpose()?;
        let config = config_of(config, set, &[("run.seed", seed.map(Into::into))])?;
        let settings = config.phantom_settings().map_err(input)?;
        let hand = Hand::new(&config, &settings, config.run.seed).map_err(input)?;
        Ok(Self(Mutex::new(hand)))
    }

    /// Moves the base to `world_from_base` (4, 4), reached at `time` [s], on a straight screw. The
    /// needle is simulated at the exposures of the sensor, 30 a second.
    fn advance(
        &self,
        py: Python<'_>,
        world_from_base: &Bound<'_, PyAny>,
        time: f64,
    ) -> PyResult<()> {
        /// Latest time [s]: a year.
        const LATEST: f64 = 3.2e7;
        let pose = isometry(world_from_base, "world_from_base")?;
        if !(0.0..=LATEST).contains(&time) {
            return Err(input(format!(
                "time {time}: expected seconds from 0 to {LATEST}"
            )));
        }
        detached(py, || self.hand().advance(&pose, Stamp::from_secs(time)))?.map_err(input)
    }

    /// The newest measurement that has arrived and was not yet taken, or None: `time` [s] of the
    /// exposure, `tip` (3,), `direction` (3,), `points` (n, 3) of the shaft from the surface on, `sequence`.
    fn sense<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let Some(shape) = self.hand().sense() else {
            return Ok(None);
        };
        let points: Vec<Vector3<f64>> = shape.points.iter().map(|p| p.position.coords()).collect();
        let sensed = PyDict::new(py);
        sensed.set_item("time", shape.stamp.as_secs())?;
        sensed.set_item("tip", vector(py, shape.tip.position.coords().as_slice()))?;
        sensed.set_item("direction", vector(py, shape.tip.direction.as_slice()))?;
        sensed.set_item("points", places(py, points.iter())?)?;
        sensed.set_item("sequence", shape.sequence)?;
        Ok(Some(sensed))
    }

    /// Ground truth at the last exposure: `time` [s], `tip` (4, 4) (bevel direction -y),
    /// `centreline` (n, 3), `base` (4, 4), `depth` along the cut path [m], `cut_path` (n, 3),
    /// `mean_stretch`, `max_stretch`, `entry_stretch` [m], `entry_force` (3,) [N], `events`.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let hand = self.hand();
        let now = hand.truth();
        let truth = PyDict::new(py);
        truth.set_item("time", now.stamp.as_secs())?;
        truth.set_item("tip", pose(py, now.world_from_tip().isometry())?)?;
        truth.set_item("centreline", places(py, now.needle.centreline.iter())?)?;
        truth.set_item("base", pose(py, now.world_from_base.isometry())?)?;
        truth.set_item("depth", now.depth)?;
        truth.set_item("cut_path", places(py, now.cut_path.iter())?)?;
        truth.set_item("mean_stretch", now.mean_stretch)?;
        truth.set_item("max_stretch", now.max_stretch)?;
        truth.set_item("entry_stretch", now.entry_stretch)?;
        truth.set_item("entry_force", vector(py, now.entry_force.as_slice()))?;
        let events: Vec<&str> = now
            .events
            .iter()
            .map(|event| needle_steer::world::kind(event).name())
            .collect();
        truth.set_item("events", events)?;
        Ok(truth)
    }

    /// Pose of the base (4, 4) as it was asked for.
    #[getter]
    fn base<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        pose(py, self.hand().base())
    }

    /// The phantom's clock [s].
    #[getter]
    fn time(&self) -> f64 {
        self.hand().now().as_secs()
    }
}

/// The rows of an array (m, n) of finite numbers.
pub(crate) fn rows_of(
    value: &Bound<'_, PyAny>,
    columns: usize,
    what: &str,
) -> PyResult<Vec<Vec<f64>>> {
    let wrong = || {
        input(format!(
            "{what}: expected an array (m, {columns}) of finite numbers, found {}",
            shown(value)
        ))
    };
    let array: numpy::PyArrayLike2<'_, f64, numpy::AllowTypeChange> =
        value.extract().map_err(|_| wrong())?;
    let array = array.as_array();
    if array.ncols() != columns || !array.iter().all(|x| x.is_finite()) {
        return Err(wrong());
    }
    Ok(array.rows().into_iter().map(|row| row.to_vec()).collect())
}
