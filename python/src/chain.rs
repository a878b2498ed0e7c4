//! Kinematics of arms.

use std::collections::BTreeMap;
use std::path::PathBuf;

use hal::Joints;
use nalgebra::Matrix4;
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use pyo3::prelude::*;
use robots::kinematics::{Chain, Section, Turns};

use crate::arrays::{isometry, matrix};
use crate::errors::{failed, input};
use crate::hand::rows_of;
use crate::work::detached;

/// The chain of a URDF from its root, or a base link, to a tip link.
#[pyclass(frozen, module = "needle_steer")]
pub(crate) struct ArmChain(Chain);

#[pymethods]
impl ArmChain {
    #[new]
    fn new(
        urdf: PathBuf,
        tip: &str,
        base: Option<&str>,
        hold: BTreeMap<String, f64>,
        mechanism: bool,
    ) -> PyResult<Self> {
        let bytes = std::fs::read(&urdf)
            .map_err(|e| input(format!("{}: cannot be read: {e}", urdf.display())))?;
        let mut section = if mechanism {
            Section::mechanism(tip)
        } else {
            Section::arm(tip)
        };
        if let Some(base) = base {
            section = section.from(base);
        }
        for (joint, position) in &hold {
            section = section.holding(joint, *position);
        }
        let chain = Chain::from_section(&bytes, &section);
        chain.map(Self).map_err(|e| input(e.in_file(&urdf)))
    }

    /// Names of the joints.
    #[getter]
    fn names(&self) -> Vec<String> {
        self.0.names().to_vec()
    }

    /// Lower and upper limits (n, 2) [rad, m].
    #[getter]
    fn limits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let ends = self.0.limits().iter().flat_map(|l| [l.lower, l.upper]);
        matrix(py, ends.collect(), 2)
    }

    /// Whether `ik` finds every solution.
    #[getter]
    fn exhaustive(&self) -> bool {
        self.0.is_exhaustive()
    }

    /// Poses (m, 4, 4) of the tip in the base.
    fn fk<'py>(
        &self,
        py: Python<'py>,
        joints: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let joints = self.joints(joints)?;
        let flat = detached(py, || {
            let poses = joints.iter().map(|q| self.0.forward(q).to_homogeneous());
            poses.flat_map(|pose| rows(&pose)).collect::<Vec<f64>>()
        })?;
        PyArray1::from_vec(py, flat).reshape([joints.len(), 4, 4])
    }

    /// Jacobians (m, 6, n): joint rates to the tip's twist, linear above angular, in the base's axes.
    fn jacobian<'py>(
        &self,
        py: Python<'py>,
        joints: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let joints = self.joints(joints)?;
        let n = self.0.len();
        let flat = detached(py, || {
            let mut flat = Vec::with_capacity(joints.len() * 6 * n);
            for q in &joints {
                let jacobian = self.0.jacobian(q);
                flat.extend(
                    (0..6)
                        .flat_map(|i| (0..n).map(move |j| (i, j)))
                        .map(|at| jacobian[at]),
                );
            }
            flat
        })?;
        PyArray1::from_vec(py, flat).reshape([joints.len(), 6, n])
    }

    /// Joint vectors (k, n) within the limits that reach a pose (4, 4); none if it is out of reach.
    fn ik<'py>(
        &self,
        py: Python<'py>,
        pose: &Bound<'py, PyAny>,
        all_turns: bool,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let pose = isometry(pose, "pose")?;
        let turns = if all_turns { Turns::All } else { Turns::One };
        let found = detached(py, || self.0.inverse(&pose, turns))?;
        let flat: Vec<f64> = found.iter().flat_map(|q| q.iter().copied()).collect();
        PyArray1::from_vec(py, flat).reshape([found.len(), self.0.len()])
    }
}

impl ArmChain {
    fn joints(&self, value: &Bound<'_, PyAny>) -> PyResult<Vec<Joints>> {
        rows_of(value, self.0.len(), "joints")?
            .iter()
            .map(|row| Joints::from_slice(row).map_err(failed))
            .collect()
    }
}

/// Row by row.
fn rows(matrix: &Matrix4<f64>) -> Vec<f64> {
    matrix.transpose().as_slice().to_vec()
}
