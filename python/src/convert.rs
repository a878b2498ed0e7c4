//! Configurations from Python, documents to Python.

use std::path::PathBuf;

use needle_steer::config::{self, Base, Config};
use needle_steer::series::{COLUMNS, Cell, Row};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyMapping, PySequence, PyString};
use serde::Serialize;

use crate::arrays::shown;
use crate::errors::{failed, input};

/// A configuration: `base` is nothing, a path or a mapping as a file has it; `set` maps dotted keys
/// to values; `more` are overrides that stand behind both.
pub(crate) fn config_of(
    base: Option<&Bound<'_, PyAny>>,
    set: Option<&Bound<'_, PyAny>>,
    more: &[(&str, Option<toml::Value>)],
) -> PyResult<Config> {
    let file: PathBuf;
    let base = match base {
        None => Base::Default,
        Some(given) => {
            if let Ok(mapping) = given.cast::<PyMapping>() {
                Base::Table(table(mapping, "config")?)
            } else if let Ok(path) = given.extract::<PathBuf>() {
                file = path;
                Base::File(&file)
            } else {
                return Err(input(format!(
                    "argument `config`: expected a dict, a path or None, found {}",
                    shown(given)
                )));
            }
        }
    };
    let mut overrides = Vec::new();
    if let Some(set) = set {
        let mapping = set.cast::<PyMapping>().map_err(|_| {
            input(format!(
                "argument `set`: expected a dict of dotted keys, for instance {{\"run.seed\": 7}}, found {}",
                shown(set)
            ))
        })?;
        overrides.extend(table(mapping, "set")?);
    }
    overrides.extend(
        more.iter()
            .filter_map(|(key, value)| Some(((*key).to_owned(), value.clone()?))),
    );
    config::assemble(base, &overrides).map_err(input)
}

/// A mapping as TOML; `at` is where it stands, for messages.
pub(crate) fn table(mapping: &Bound<'_, PyMapping>, at: &str) -> PyResult<toml::Table> {
    let mut table = toml::Table::new();
    for item in mapping.items()?.iter() {
        let (key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>) = item.extract()?;
        let key: String = key.extract().map_err(|_| {
            input(format!(
                "{at}: expected keys of text, found {}",
                shown(&key)
            ))
        })?;
        let place = format!("{at}.{key}");
        table.insert(key, value_of(&value, &place)?);
    }
    Ok(table)
}

fn value_of(value: &Bound<'_, PyAny>, at: &str) -> PyResult<toml::Value> {
    let wrong =
        |expected: &str| input(format!("{at}: expected {expected}, found {}", shown(value)));
    if let Ok(flag) = value.cast::<PyBool>() {
        Ok(flag.is_true().into())
    } else if let Ok(text) = value.cast::<PyString>() {
        Ok(text.to_string().into())
    } else if value.is_instance_of::<PyInt>() {
        let number: i64 = value
            .extract()
            .map_err(|_| wrong(&format!("an integer from {} to {}", i64::MIN, i64::MAX)))?;
        Ok(number.into())
    } else if value.is_instance_of::<PyFloat>() {
        Ok(value.extract::<f64>()?.into())
    } else if let Ok(mapping) = value.cast::<PyMapping>() {
        Ok(table(mapping, at)?.into())
    } else if let Ok(items) = value.cast::<PySequence>() {
        let items: PyResult<Vec<toml::Value>> = (0..items.len()?)
            .map(|k| value_of(&items.get_item(k)?, &format!("{at}[{k}]")))
            .collect();
        Ok(toml::Value::Array(items?))
    } else if let Ok(path) = value.extract::<PathBuf>() {
        Ok(path.display().to_string().into())
    } else if value.hasattr("tolist")? {
        // Numbers and arrays of numpy.
        value_of(&value.call_method0("tolist")?, at)
    } else {
        Err(wrong(
            "a number, text, a list or a dict; a key that is left out has its default",
        ))
    }
}

/// A document as Python's dicts and lists: exactly what its JSON says.
pub(crate) fn document<'py>(
    py: Python<'py>,
    document: &impl Serialize,
) -> PyResult<Bound<'py, PyAny>> {
    json(py, &serde_json::to_value(document).map_err(failed)?)
}

/// JSON as Python's dicts and lists.
pub(crate) fn json<'py>(py: Python<'py>, value: &serde_json::Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        serde_json::Value::Null => py.None().into_bound(py),
        serde_json::Value::Bool(flag) => PyBool::new(py, *flag).to_owned().into_any(),
        serde_json::Value::Number(number) => match (number.as_i64(), number.as_u64()) {
            (Some(number), _) => number.into_pyobject(py)?.into_any(),
            (_, Some(number)) => number.into_pyobject(py)?.into_any(),
            _ => PyFloat::new(py, number.as_f64().unwrap_or(f64::NAN)).into_any(),
        },
        serde_json::Value::String(text) => PyString::new(py, text).into_any(),
        serde_json::Value::Array(items) => {
            let list = PyList::empty(py);
            for item in items {
                list.append(json(py, item)?)?;
            }
            list.into_any()
        }
        serde_json::Value::Object(entries) => {
            let dict = PyDict::new(py);
            for (key, entry) in entries {
                dict.set_item(key, json(py, entry)?)?;
            }
            dict.into_any()
        }
    })
}

/// A time series by columns: arrays of numbers, lists of words.
pub(crate) fn series<'py>(py: Python<'py>, rows: &[Row]) -> PyResult<Bound<'py, PyDict>> {
    let mut numbers: Vec<Vec<f64>> = vec![Vec::new(); COLUMNS.len()];
    let mut words: Vec<Vec<String>> = vec![Vec::new(); COLUMNS.len()];
    for row in rows {
        for (k, cell) in row.cells().into_iter().enumerate() {
            match cell {
                Cell::Number(number) => numbers[k].push(number),
                Cell::Words(text) => words[k].push(text),
            }
        }
    }
    let dict = PyDict::new(py);
    for ((name, numbers), words) in COLUMNS.iter().zip(numbers).zip(words) {
        if words.is_empty() {
            dict.set_item(name, PyArray1::from_vec(py, numbers))?;
        } else {
            dict.set_item(name, words)?;
        }
    }
    Ok(dict)
}
