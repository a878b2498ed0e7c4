//! A plant in Python.

use hal::Stamp;
use nalgebra::Isometry3;
use phantom::ShapeSource;
use pyo3::prelude::*;

use crate::arrays::{pose, rows_of_three, shown};
use crate::errors::input;
use crate::work::Failure;

/// A needle whose shape a Python object computes.
pub(crate) struct OwnPlant {
    object: Py<PyAny>,
    failure: Failure,
}

impl OwnPlant {
    pub(crate) fn new(object: &Bound<'_, PyAny>, failure: Failure) -> PyResult<Self> {
        for method in ["advance", "shape"] {
            if !object.getattr(method).is_ok_and(|m| m.is_callable()) {
                return Err(input(format!(
                    "argument `plant`: expected \"phantom\", \"model\" or an object with \
                     advance(world_from_base, time) and shape(), found {}",
                    shown(object)
                )));
            }
        }
        Ok(Self {
            object: object.clone().unbind(),
            failure,
        })
    }

    /// The exception comes out of the call; the world hears its words.
    fn told<T>(&self, result: PyResult<T>) -> Result<T, String> {
        result.map_err(|raised| {
            let words = raised.to_string();
            self.failure.note(raised);
            words
        })
    }
}

impl ShapeSource for OwnPlant {
    fn advance(&mut self, world_from_base: &Isometry3<f64>, stamp: Stamp) -> Result<(), String> {
        let done = Python::attach(|py| {
            let base = pose(py, world_from_base)?;
            self.object
                .bind(py)
                .call_method1("advance", (base, stamp.as_secs()))
                .map(drop)
        });
        self.told(done)
    }

    fn shape(&mut self) -> Result<Vec<[f64; 3]>, String> {
        let shape = Python::attach(|py| {
            let shape = self.object.bind(py).call_method0("shape")?;
            rows_of_three(&shape, "the plant's shape() in World [m]")
        });
        self.told(shape)
    }

    fn refused(&mut self, why: &str) {
        self.failure
            .note(input(format!("the plant's shape(): {why}")));
    }
}
