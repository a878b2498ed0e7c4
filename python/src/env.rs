//! Learning environments, many at once.

use std::num::NonZeroUsize;
use std::sync::{Mutex, PoisonError};

use needle_steer::env::{Actions, Envs, OBSERVATION, Outcome, Reward, Settings, Step, Steps};
use numpy::{
    AllowTypeChange, PyArray1, PyArray2, PyArrayLike2, PyArrayMethods, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::shown;
use crate::convert::config_of;
use crate::errors::input;
use crate::work::detached;

/// Environments that are stepped together in Rust threads.
#[pyclass(frozen, module = "needle_steer")]
pub(crate) struct EnvPool {
    envs: Mutex<Envs>,
    count: usize,
    width: usize,
    phantoms: Vec<String>,
}

/// Observations, rewards, ends by the task, ends by time, truth.
type Answer<'py> = (
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyDict>,
);

#[pymethods]
impl EnvPool {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "the keywords of an environment")]
    #[pyo3(signature = (config, set, phantoms, depth_mm, offset_mm, angle_deg, actions, reward, repeat, count, threads, seed))]
    fn new(
        py: Python<'_>,
        config: Option<&Bound<'_, PyAny>>,
        set: Option<&Bound<'_, PyAny>>,
        phantoms: Option<Vec<String>>,
        depth_mm: Option<[f64; 2]>,
        offset_mm: Option<[f64; 2]>,
        angle_deg: Option<[f64; 2]>,
        actions: &str,
        reward: &str,
        repeat: u32,
        count: usize,
        threads: Option<usize>,
        seed: u64,
    ) -> PyResult<Self> {
        let mut settings = Settings::new(config_of(config, set, &[])?);
        let unknown = |key: &str, found: &str, known: &[&str]| {
            input(format!(
                "{key}: expected one of {}, found {found}",
                known.join(", ")
            ))
        };
        settings.actions =
            Actions::named(actions).ok_or_else(|| unknown("actions", actions, &Actions::NAMES))?;
        settings.reward =
            Reward::named(reward).ok_or_else(|| unknown("reward", reward, &Reward::NAMES))?;
        settings.repeat = repeat;
        settings.phantoms = phantoms.unwrap_or(settings.phantoms);
        settings.depth_mm = depth_mm.unwrap_or(settings.depth_mm);
        settings.offset_mm = offset_mm.unwrap_or(settings.offset_mm);
        settings.angle_deg = angle_deg.unwrap_or(settings.angle_deg);
        let threads = threads
            .map(|n| NonZeroUsize::new(n).ok_or_else(|| input("threads: expected at least 1")))
            .transpose()?;
        let (width, phantoms) = (settings.actions.len(), settings.phantoms.clone());
        let envs = detached(py, || Envs::new(settings, count, threads, seed))?.map_err(input)?;
        Ok(Self {
            envs: Mutex::new(envs),
            count,
            width,
            phantoms,
        })
    }

    /// Numbers of an observation, of an action.
    #[getter]
    const fn sizes(&self) -> (usize, usize) {
        (OBSERVATION, self.width)
    }

    /// Begins episodes where `chosen` says so, or everywhere: the first of a seed, or the next.
    fn reset<'py>(
        &self,
        py: Python<'py>,
        seeds: Vec<Option<u64>>,
        chosen: Option<Vec<bool>>,
    ) -> PyResult<Answer<'py>> {
        let lengths = [Some(seeds.len()), chosen.as_ref().map(Vec::len)];
        if lengths.into_iter().flatten().any(|n| n != self.count) {
            return Err(input(format!(
                "seeds and mask: expected one for each of {} environments",
                self.count
            )));
        }
        self.answer(py, |envs, into| envs.reset(&seeds, chosen.as_deref(), into))
    }

    /// Steps all; one that has ended begins its next episode instead.
    fn step<'py>(&self, py: Python<'py>, actions: &Bound<'py, PyAny>) -> PyResult<Answer<'py>> {
        let wrong = || {
            input(format!(
                "actions: expected an array ({}, {}) of finite numbers, found {}",
                self.count,
                self.width,
                shown(actions)
            ))
        };
        let array: PyArrayLike2<'_, f32, AllowTypeChange> =
            actions.extract().map_err(|_| wrong())?;
        if array.shape() != [self.count, self.width] {
            return Err(wrong());
        }
        let actions: Vec<f32> = array.as_array().iter().copied().collect();
        if !actions.iter().all(|x| x.is_finite()) {
            return Err(wrong());
        }
        self.answer(py, |envs, into| envs.step(&actions, into))
    }
}

impl EnvPool {
    fn answer<'py>(
        &self,
        py: Python<'py>,
        work: impl FnOnce(&mut Envs, Steps<'_>) -> Result<(), needle_steer::env::EnvError> + Send,
    ) -> PyResult<Answer<'py>> {
        let mut observations = vec![0.0; self.count * OBSERVATION];
        let mut steps = vec![Step::default(); self.count];
        let mut outcomes = vec![Outcome::default(); self.count];
        detached(py, || {
            let mut envs = self.envs.lock().unwrap_or_else(PoisonError::into_inner);
            let into = Steps {
                observations: &mut observations,
                steps: &mut steps,
                outcomes: &mut outcomes,
            };
            work(&mut envs, into)
        })?
        .map_err(input)?;
        let column = |of: fn(&Outcome) -> f64| {
            let values: Vec<f64> = outcomes.iter().map(of).collect();
            PyArray1::from_vec(py, values)
        };
        let flags = |of: fn(&Outcome) -> bool| {
            let values: Vec<bool> = outcomes.iter().map(of).collect();
            PyArray1::from_vec(py, values)
        };
        let infos = PyDict::new(py);
        infos.set_item("true_error_mm", column(|o| o.lateral * 1e3))?;
        infos.set_item("axial_error_mm", column(|o| o.axial * 1e3))?;
        infos.set_item("max_stretch_mm", column(|o| o.max_stretch * 1e3))?;
        infos.set_item("passed", flags(|o| o.passed))?;
        infos.set_item("spoilt", flags(|o| o.spoilt))?;
        let seeds: Vec<u64> = outcomes.iter().map(|o| o.seed).collect();
        infos.set_item("phantom_seed", PyArray1::from_vec(py, seeds))?;
        let phantoms: Vec<&str> = outcomes
            .iter()
            .map(|o| self.phantoms.get(o.phantom).map_or("", String::as_str))
            .collect();
        infos.set_item("phantom", phantoms)?;
        let each = |of: fn(&Step) -> bool| steps.iter().map(of).collect::<Vec<bool>>();
        let rewards: Vec<f64> = steps.iter().map(|s| s.reward).collect();
        Ok((
            PyArray1::from_vec(py, observations).reshape([self.count, OBSERVATION])?,
            PyArray1::from_vec(py, rewards),
            PyArray1::from_vec(py, each(|s| s.terminated)),
            PyArray1::from_vec(py, each(|s| s.truncated)),
            infos,
        ))
    }
}
