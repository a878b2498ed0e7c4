//! The product's errors as Python's exceptions.

use std::path::Path;

use pyo3::{PyErr, import_exception};

import_exception!(needle_steer._errors, Error);
import_exception!(needle_steer._errors, InputError);
import_exception!(needle_steer._errors, InternalError);

/// What the caller gave cannot be used.
pub(crate) fn input(error: impl std::fmt::Display) -> PyErr {
    InputError::new_err(error.to_string())
}

/// A file cannot be used; the message names it.
pub(crate) fn of_file(file: &Path, error: impl std::fmt::Display) -> PyErr {
    let (text, name) = (error.to_string(), file.display().to_string());
    input(if text.contains(&name) {
        text
    } else {
        format!("{name}: {text}")
    })
}

/// As [`input`], with all causes.
pub(crate) fn with_causes(error: &dyn std::error::Error) -> PyErr {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(because) = cause {
        text = format!("{text}: {because}");
        cause = because.source();
    }
    input(text)
}

/// What was asked for failed.
pub(crate) fn failed(error: impl std::fmt::Display) -> PyErr {
    Error::new_err(error.to_string())
}
