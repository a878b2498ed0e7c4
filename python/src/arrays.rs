//! Numbers to numpy and back.

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};
use numpy::{AllowTypeChange, PyArray1, PyArray2, PyArrayLike1, PyArrayLike2, PyArrayMethods};
use pyo3::prelude::*;

use crate::errors::input;

/// Deviation from a rotation that is taken for rounding.
const ORTHONORMAL: f64 = 1e-6;

/// A vector of numbers.
pub(crate) fn vector<'py>(py: Python<'py>, values: &[f64]) -> Bound<'py, PyArray1<f64>> {
    PyArray1::from_slice(py, values)
}

/// Rows of numbers, row by row in `values`.
pub(crate) fn matrix(
    py: Python<'_>,
    values: Vec<f64>,
    columns: usize,
) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let rows = values.len() / columns.max(1);
    PyArray1::from_vec(py, values).reshape([rows, columns])
}

/// A pose as a homogeneous matrix (4, 4).
pub(crate) fn pose<'py>(
    py: Python<'py>,
    pose: &Isometry3<f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    // Column by column in memory: transposed it is row by row.
    let rows = pose.to_homogeneous().transpose();
    matrix(py, rows.as_slice().to_vec(), 4)
}

/// Places in rows (n, 3).
pub(crate) fn places<'py, 'a>(
    py: Python<'py>,
    places: impl Iterator<Item = &'a Vector3<f64>>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let flat: Vec<f64> = places.flat_map(|p| [p.x, p.y, p.z]).collect();
    matrix(py, flat, 3)
}

/// `N` finite numbers; `what` is what errors call them.
pub(crate) fn numbers<const N: usize>(value: &Bound<'_, PyAny>, what: &str) -> PyResult<[f64; N]> {
    let wrong = |found: String| {
        input(format!(
            "{what}: expected {N} finite numbers, found {found}"
        ))
    };
    let array: PyArrayLike1<'_, f64, AllowTypeChange> =
        value.extract().map_err(|_| wrong(shown(value)))?;
    let array = array.as_array();
    let mut numbers = [0.0; N];
    if array.len() != N || !array.iter().all(|x| x.is_finite()) {
        return Err(wrong(shown(value)));
    }
    for (number, x) in numbers.iter_mut().zip(array) {
        *number = *x;
    }
    Ok(numbers)
}

/// Rows of three numbers (n, 3); they may be anything.
pub(crate) fn rows_of_three(value: &Bound<'_, PyAny>, what: &str) -> PyResult<Vec<[f64; 3]>> {
    let wrong = || {
        input(format!(
            "{what}: expected an array (n, 3) of numbers, found {}",
            shown(value)
        ))
    };
    let array: PyArrayLike2<'_, f64, AllowTypeChange> = value.extract().map_err(|_| wrong())?;
    let array = array.as_array();
    if array.ncols() != 3 {
        return Err(wrong());
    }
    Ok(array
        .rows()
        .into_iter()
        .map(|row| [row[0], row[1], row[2]])
        .collect())
}

/// A pose from a homogeneous matrix (4, 4).
pub(crate) fn isometry(value: &Bound<'_, PyAny>, what: &str) -> PyResult<Isometry3<f64>> {
    let wrong = |why: &str| {
        input(format!(
            "{what}: expected a homogeneous transform (4, 4), {why}; found {}",
            shown(value)
        ))
    };
    let array: PyArrayLike2<'_, f64, AllowTypeChange> =
        value.extract().map_err(|_| wrong("rows of numbers"))?;
    let m = array.as_array();
    if m.shape() != [4, 4] || !m.iter().all(|x| x.is_finite()) {
        return Err(wrong("four rows of four finite numbers"));
    }
    let rotation = Matrix3::from_fn(|i, j| m[[i, j]]);
    let off = (rotation * rotation.transpose() - Matrix3::identity())
        .abs()
        .max();
    if off > ORTHONORMAL || rotation.determinant() < 0.0 {
        return Err(wrong("with a rotation in its upper left"));
    }
    let last = [0.0, 0.0, 0.0, 1.0];
    if (0..4).any(|k| (m[[3, k]] - last[k]).abs() > 0.0) {
        return Err(wrong("its last row 0, 0, 0, 1"));
    }
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Ok(Isometry3::from_parts(
        Vector3::new(m[[0, 3]], m[[1, 3]], m[[2, 3]]).into(),
        UnitQuaternion::new_normalize(rotation.into_inner()),
    ))
}

/// What a value looks like in a message.
pub(crate) fn shown(value: &Bound<'_, PyAny>) -> String {
    /// Longest text of a message \[characters\].
    const LONGEST: usize = 120;
    let kind = value
        .get_type()
        .name()
        .map_or_else(|_| "an object".into(), |name| name.to_string());
    let shape = value
        .getattr("shape")
        .ok()
        .filter(|shape| !shape.is_callable())
        .map_or_else(String::new, |shape| format!(" of shape {shape}"));
    let text: String = value
        .repr()
        .map_or_else(|_| String::new(), |text| text.to_string())
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
        .chars()
        .take(LONGEST)
        .collect();
    format!("{kind}{shape}: {text}")
}
