//! One's own needle from recordings, and the paper's experiments.

use std::path::PathBuf;
use std::sync::Mutex;

use needle_steer::config::Config;
use needle_steer::controls::Controls;
use needle_steer::identify::{self, Findings, Recording};
use needle_steer::reproduction::{Document, Request, one};
use needle_steer::{experiments, report};
use pyo3::prelude::*;

use crate::convert::{config_of, document};
use crate::errors::{failed, input, with_causes};
use crate::work::interruptible;

fn read(files: &[PathBuf], config: &Config) -> PyResult<Vec<Recording>> {
    files
        .iter()
        .map(|file| Recording::read(file, config).map_err(|e| with_causes(&e)))
        .collect()
}

/// What `needle-steer estimate` finds, and the configuration with it.
#[pyfunction]
pub(crate) fn estimate<'py>(
    py: Python<'py>,
    files: Vec<PathBuf>,
    config: Option<&Bound<'py, PyAny>>,
    set: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let is_given = config.is_some() || set.is_some();
    let given = config_of(config, set, &[])?;
    let (found, applied) = interruptible(py, &Controls::default(), || {
        let recordings = read(&files, &given)?;
        let found = Findings::of(&recordings).map_err(input)?;
        let applied = found.apply(&given, is_given, &recordings);
        Ok::<_, PyErr>((serde_json::to_value(&found).map_err(failed)?, applied))
    })??;
    Ok((document(py, &found)?, document(py, &applied)?))
}

/// What `needle-steer validate` finds; its page where one is wanted.
#[pyfunction]
pub(crate) fn validate<'py>(
    py: Python<'py>,
    files: Vec<PathBuf>,
    config: Option<&Bound<'py, PyAny>>,
    set: Option<&Bound<'py, PyAny>>,
    html: Option<PathBuf>,
) -> PyResult<Bound<'py, PyAny>> {
    let given = config_of(config, set, &[])?;
    let found = interruptible(py, &Controls::default(), || {
        let found = identify::validate(&read(&files, &given)?, &given).map_err(input)?;
        if let Some(page) = &html {
            needle_steer::results::save_page(page, &report::validation(&found).render())
                .map_err(|e| failed(format!("{e:#}")))?;
        }
        serde_json::to_value(&found).map_err(failed)
    })??;
    document(py, &found)
}

/// The document of `needle-steer reproduce --json`.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the options of one command")]
pub(crate) fn reproduce<'py>(
    py: Python<'py>,
    experiments: Vec<String>,
    law: String,
    runs: u64,
    seed: u64,
    phantom: String,
    sensor: Option<String>,
    set: Vec<String>,
    brackets: bool,
    jobs: usize,
    step: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let request = Request {
        experiments,
        law,
        runs,
        seed,
        phantom,
        sensor,
        brackets,
        set,
    };
    let plan = request.plan().map_err(input)?;
    let controls = Controls::default();
    let raised = Mutex::new(None);
    let found = interruptible(py, &controls, || {
        let finished = |_: &experiments::Finished| {
            let told = step
                .as_ref()
                .map_or(Ok(()), |step| Python::attach(|py| step.call0(py).map(drop)));
            if let (Err(error), Ok(mut raised)) = (told, raised.lock()) {
                controls.interrupt();
                raised.get_or_insert(error);
            }
        };
        experiments::reproduce(&plan, jobs, |config| one(config, &controls), finished)
    })?;
    if let Some(raised) = raised.into_inner().ok().flatten() {
        return Err(raised);
    }
    if let Some(error) = found.error {
        return Err(failed(error));
    }
    document(
        py,
        &Document {
            experiments: &found.experiments,
            set: &request.set,
            finished: found.finished,
            planned: found.planned,
        },
    )
}
