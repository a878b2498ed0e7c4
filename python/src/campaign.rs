//! Campaigns: plans, rows, conclusions. Who computes the rows is Python's affair.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use needle_steer::campaign::compare::conclude;
use needle_steer::campaign::execute::each;
use needle_steer::campaign::table::table as campaign_table;
use needle_steer::campaign::{Plan, Row};
use needle_steer::controls::Controls;
use pyo3::prelude::*;
use pyo3::types::PyMapping;

use crate::arrays::shown;
use crate::convert::{document, table};
use crate::errors::{failed, input};
use crate::work::interruptible;

/// The text of a plan (TOML), checked, its name for messages, and the number of its runs.
#[pyfunction]
pub(crate) fn campaign_plan(plan: &Bound<'_, PyAny>) -> PyResult<(String, String, u64)> {
    let (text, name) = if let Ok(mapping) = plan.cast::<PyMapping>() {
        let text = toml::to_string(&table(mapping, "plan")?).map_err(input)?;
        (text, "argument `plan`".to_owned())
    } else if let Ok(file) = plan.extract::<std::path::PathBuf>() {
        let text = std::fs::read_to_string(&file)
            .map_err(|e| input(format!("{}: cannot be read: {e}", file.display())))?;
        (text, file.display().to_string())
    } else {
        return Err(input(format!(
            "argument `plan`: expected a dict or a path, found {}",
            shown(plan)
        )));
    };
    let runs = parsed(&text, &name)?.len();
    Ok((text, name, runs))
}

fn parsed(text: &str, name: &str) -> PyResult<Plan> {
    Plan::parse(text, Path::new(name)).map_err(input)
}

/// Lines of the table for the given runs, in their order, by `jobs` threads; `step` is called after
/// each.
#[pyfunction]
pub(crate) fn campaign_lines(
    py: Python<'_>,
    text: String,
    name: String,
    runs: Vec<u64>,
    jobs: usize,
    step: Option<Py<PyAny>>,
) -> PyResult<Vec<String>> {
    let plan = parsed(&text, &name)?;
    if let Some(beyond) = runs.iter().find(|run| **run >= plan.len()) {
        return Err(input(format!("run {beyond}: the plan has {}", plan.len())));
    }
    let controls = Controls::default();
    let lines = Mutex::new(vec![String::new(); runs.len()]);
    let keep = |place: usize, row: Row| {
        let line = row.text().map_err(failed)?;
        lines.lock().unwrap_or_else(PoisonError::into_inner)[place] = line;
        step.as_ref()
            .map_or(Ok(()), |step| Python::attach(|py| step.call0(py).map(drop)))
    };
    let done = interruptible(py, &controls, || each(&plan, &runs, jobs, &controls, keep))?;
    done?;
    Ok(lines.into_inner().unwrap_or_else(PoisonError::into_inner))
}

/// The table, its rows and the conclusions of a campaign's lines.
#[pyfunction]
pub(crate) fn campaign_conclude<'py>(
    py: Python<'py>,
    text: String,
    name: String,
    lines: Vec<String>,
) -> PyResult<(String, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let plan = parsed(&text, &name)?;
    let rows: Result<Vec<Row>, _> = lines.iter().map(|line| Row::parse(line)).collect();
    let rows = rows.map_err(input)?;
    Ok((
        campaign_table(lines.iter().map(String::as_str)),
        document(py, &rows)?,
        document(py, &conclude(&plan, &rows))?,
    ))
}
