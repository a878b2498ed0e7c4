//! The controller's model of the needle.

use std::sync::{Mutex, MutexGuard, PoisonError};

use hybrid_control::Springs;
use nalgebra::Vector3;
use needle_model::{Insertion, Sensitivities};
use needle_steer::springs;
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arrays::{isometry, matrix, numbers, places, pose, vector};
use crate::convert::config_of;
use crate::errors::{failed, input};
use crate::work::guarded;

/// The needle on virtual springs, as the controller models it; World, SI units.
#[pyclass(frozen, module = "needle_steer")]
pub(crate) struct NeedleModel(Mutex<State>);

struct State {
    insertion: Insertion,
    sensitivities: Sensitivities,
}

impl State {
    fn springs(&mut self) -> PyResult<Springs> {
        springs::converged(&mut self.insertion, &mut self.sensitivities).map_err(failed)
    }
}

impl NeedleModel {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl NeedleModel {
    /// The needle and the tissue of a configuration (tables `needle`, `tissue`, key
    /// `estimator.stiffness_n_m2`), straight, its tip a millimetre before the surface.
    #[new]
    #[pyo3(signature = (config=None, *, set=None))]
    fn new(config: Option<&Bound<'_, PyAny>>, set: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let config = config_of(config, set, &[])?;
        let insertion =
            springs::insertion(&config, &config.world_from_start_base()).map_err(input)?;
        Ok(Self(Mutex::new(State {
            insertion,
            sensitivities: Sensitivities::default(),
        })))
    }

    /// Moves the base to `world_from_base` (4, 4) and lets the tip cut; with `measured_tip` (3,) the
    /// springs are laid through the tip as it was measured. Without an equilibrium nothing changes.
    #[pyo3(signature = (world_from_base, measured_tip=None))]
    fn insert(
        &self,
        py: Python<'_>,
        world_from_base: &Bound<'_, PyAny>,
        measured_tip: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let base = isometry(world_from_base, "world_from_base")?;
        let tip = measured_tip
            .map(|tip| numbers::<3>(tip, "measured_tip").map(Vector3::from))
            .transpose()?;
        crate::work::detached(py, || self.state().insertion.insert(&base, tip))?.map_err(failed)
    }

    /// Moves the base without cutting: the tip may slide in its hole.
    fn move_base(&self, py: Python<'_>, world_from_base: &Bound<'_, PyAny>) -> PyResult<()> {
        let base = isometry(world_from_base, "world_from_base")?;
        crate::work::detached(py, || self.state().insertion.move_base(&base))?.map_err(failed)
    }

    /// Changes the tissue's stiffness by a factor.
    fn rescale(&self, stiffness: f64) -> PyResult<()> {
        if !(stiffness > 0.0 && stiffness.is_finite()) {
            return Err(input(format!(
                "stiffness {stiffness}: expected a factor above 0"
            )));
        }
        guarded(|| {
            self.state()
                .insertion
                .rescale(stiffness, 1.0)
                .map(drop)
                .map_err(failed)
        })
    }

    /// Pose of the tip (4, 4): origin O, z along the axis, bevel direction -y.
    #[getter]
    fn tip<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        pose(py, &self.state().insertion.equilibrium().world_from_tip())
    }

    /// Pose of the base (4, 4).
    #[getter]
    fn base<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        pose(py, self.state().insertion.equilibrium().world_from_base())
    }

    /// Base twist to tip twist (6, 6), linear above angular.
    #[getter]
    fn jacobian<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let springs = guarded(|| self.state().springs())?;
        matrix(py, springs.j_tip_base.transpose().as_slice().to_vec(), 6)
    }

    /// Derivative of the mean tissue displacement by the base twist (6,) [m per unit twist].
    #[getter]
    fn mean_stretch_jacobian<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let springs = guarded(|| self.state().springs())?;
        Ok(vector(py, springs.j_mean_stretch.transpose().as_slice()))
    }

    /// Points of the needle (count, 3) at equal arc lengths, from the base to the tip [m].
    #[pyo3(signature = (count=100))]
    fn shape<'py>(&self, py: Python<'py>, count: usize) -> PyResult<Bound<'py, PyArray2<f64>>> {
        if !(2..=100_000).contains(&count) {
            return Err(input(format!("count {count}: expected 2 to 100000 points")));
        }
        let points = guarded(|| {
            let state = self.state();
            let needle = state.insertion.equilibrium();
            let length = needle.free_length() + needle.inserted_length();
            let arc = |k: usize| length * k as f64 / (count - 1) as f64;
            Ok((0..count).map(|k| needle.point(arc(k))).collect::<Vec<_>>())
        })?;
        places(py, points.iter())
    }

    /// Where the springs rest (n, 3) [m], and their stiffness (n,) [N/m].
    #[getter]
    #[expect(clippy::type_complexity, reason = "two arrays")]
    fn springs<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)> {
        let state = self.state();
        let springs = state.insertion.equilibrium().springs();
        let stiffness: Vec<f64> = springs.iter().map(|s| s.stiffness).collect();
        Ok((
            places(py, springs.iter().map(|s| &s.rest))?,
            vector(py, &stiffness),
        ))
    }

    /// Length of needle in the tissue [m].
    #[getter]
    fn depth(&self) -> f64 {
        self.state().insertion.equilibrium().inserted_length()
    }

    /// Mean tissue displacement [m].
    #[getter]
    fn mean_stretch(&self) -> f64 {
        self.state().insertion.equilibrium().mean_stretch()
    }

    /// What the holder exerts on the needle (6,): force [N], then moment about the base [N m].
    #[getter]
    fn base_wrench<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let wrench = self.state().insertion.equilibrium().base_wrench();
        vector(py, wrench.as_slice())
    }
}
