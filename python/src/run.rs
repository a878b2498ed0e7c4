//! Runs, their logs, configurations.

use std::path::PathBuf;

use hal::telemetry::Telemetry;
use needle_steer::record::{self, Parts, RecordError};
use needle_steer::results::save_page;
use needle_steer::run::Observer;
use needle_steer::{config::Config, shape as model};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::convert::{config_of, document, series};
use crate::errors::{failed, input, of_file};
use crate::law::OwnLaw;
use crate::plant::OwnPlant;
use crate::work::{Failure, guarded, interruptible};

/// Law steps between two words of progress.
const EVERY: u64 = 15;

/// The default configuration.
#[pyfunction]
pub(crate) fn default_config(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    document(py, &Config::default())
}

/// A checked configuration, whole.
#[pyfunction]
pub(crate) fn make_config<'py>(
    py: Python<'py>,
    config: Option<&Bound<'py, PyAny>>,
    set: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    document(py, &config_of(config, set, &[])?)
}

/// One insertion: summary, series, configuration.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the keywords of one call")]
pub(crate) fn run<'py>(
    py: Python<'py>,
    config: Option<&Bound<'py, PyAny>>,
    law: Option<Bound<'py, PyAny>>,
    plant: Option<Bound<'py, PyAny>>,
    sensor: Option<String>,
    seed: Option<&Bound<'py, PyAny>>,
    set: Option<&Bound<'py, PyAny>>,
    out: Option<PathBuf>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyDict>, Bound<'py, PyAny>)> {
    let name = |given: &Option<Bound<'py, PyAny>>| -> Option<toml::Value> {
        given.as_ref()?.extract::<String>().ok().map(Into::into)
    };
    let (law_name, plant_name) = (name(&law), name(&plant));
    let seed = seed.map(|seed| seed_of(seed)).transpose()?;
    let config = config_of(
        config,
        set,
        &[
            ("run.law", law_name.clone()),
            ("run.plant", plant_name.clone()),
            ("run.sensor", sensor.map(Into::into)),
            ("run.seed", seed.map(Into::into)),
        ],
    )?;
    let failure = Failure::default();
    let mut parts = Parts {
        out,
        ..Parts::default()
    };
    if let Some(law) = law.filter(|_| law_name.is_none()) {
        parts.law = Some(Box::new(OwnLaw::new(&law, failure.clone())?));
    }
    if let Some(plant) = plant.filter(|_| plant_name.is_none()) {
        let plant = OwnPlant::new(&plant, failure.clone())?;
        parts.plant = Some(record::own_plant(&config, Box::new(plant)).map_err(failed)?);
    }
    let mut watcher = Watcher {
        progress: progress.map(Bound::unbind),
        depth_mm: 0.0,
        failure: failure.clone(),
    };
    let controls = failure.controls.clone();
    let carried_out = interruptible(py, &controls, || {
        record::carry_out(&config, parts, &mut watcher, &controls)
    })?;
    if let Some(raised) = failure.take() {
        return Err(raised);
    }
    let record = carried_out.map_err(refused)?;
    Ok((
        document(py, &record.summary)?,
        series(py, &record.rows)?,
        document(py, &config)?,
    ))
}

/// A seed that configurations can hold.
pub(crate) fn seed_of(seed: &Bound<'_, PyAny>) -> PyResult<i64> {
    let number = seed.call_method0("__index__")?.extract::<i64>().ok();
    number.filter(|n| *n >= 0).ok_or_else(|| {
        input(format!(
            "seed {seed}: expected an integer from 0 to {}",
            i64::MAX
        ))
    })
}

fn refused(error: RecordError) -> PyErr {
    match error {
        RecordError::Unattended(_) | RecordError::Folder(_) => input(error),
        _ => failed(error),
    }
}

/// Tells how deep the needle is.
struct Watcher {
    progress: Option<Py<PyAny>>,
    depth_mm: f64,
    failure: Failure,
}

impl Observer for Watcher {
    fn step(&mut self, telemetry: &Telemetry) {
        let Some(progress) = &self.progress else {
            return;
        };
        if telemetry.step % EVERY != 1 {
            return;
        }
        let depth_mm = (telemetry.depth * 1e3).max(self.depth_mm);
        let told = Python::attach(|py| {
            progress
                .bind(py)
                .call_method1("update", (depth_mm - self.depth_mm,))
                .map(drop)
        });
        self.depth_mm = depth_mm;
        if let Err(raised) = told {
            self.failure.note(raised);
        }
    }
}

/// Summary in JSON (None where the run was killed), series, configuration, whole or not.
type Logged<'py> = (Option<String>, Bound<'py, PyDict>, Bound<'py, PyAny>, bool);

/// What a log holds.
#[pyfunction]
pub(crate) fn read_log<'py>(py: Python<'py>, path: PathBuf) -> PyResult<Logged<'py>> {
    let file = if path.is_dir() {
        path.join("run.mcap")
    } else {
        path
    };
    let read = || record::read_log(&file).map_err(|e| of_file(&file, e));
    let run = interruptible(py, &needle_steer::controls::Controls::default(), read)??;
    let config = needle_steer::config::parse(&run.config, &file, &[]).map_err(input)?;
    Ok((
        run.summary,
        series(py, &run.rows)?,
        document(py, &config)?,
        run.complete,
    ))
}

/// Writes the HTML page of a log, a campaign's folder or the JSON of `reproduce`.
#[pyfunction]
pub(crate) fn report(py: Python<'_>, of: PathBuf, path: PathBuf) -> PyResult<()> {
    let write = || {
        let page = needle_steer::report::report(&of).map_err(|e| of_file(&of, e))?;
        save_page(&path, &page.render()).map_err(|e| failed(format!("{e:#}")))
    };
    interruptible(py, &needle_steer::controls::Controls::default(), write)?
}

/// The equilibrium of a case in JSON.
#[pyfunction]
pub(crate) fn shape<'py>(py: Python<'py>, case: String) -> PyResult<Bound<'py, PyAny>> {
    guarded(|| document(py, &model::solve(&case).map_err(input)?))
}
