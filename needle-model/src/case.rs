//! One given state, solved and described: what `needle-steer shape` prints.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use thiserror::Error;

use crate::equilibrium::Equilibrium;
use crate::equilibrium_error::EquilibriumError;
use crate::jacobian::{TangentError, jacobian_in_frames};
use crate::needle::{Needle, NeedleError};
use crate::spring::Spring;
use crate::tip_piece::TipLoad;

/// Largest defect of a rotation matrix that is taken for rounding.
const ROTATION_TOLERANCE: f64 = 1e-6;
/// Spacing of the samples of the shape \[m\].
const SPACING: f64 = 2e-3;

/// A state as the reference data give it (SI).
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Needle length \[m\].
    pub length_m: f64,
    /// Outer diameter \[m\].
    pub outer_diameter_m: f64,
    /// Inner diameter \[m\].
    pub inner_diameter_m: f64,
    /// Young's modulus \[Pa\].
    pub young_modulus_pa: f64,
    /// Pose of the base, 4x4 by rows; the shaft is +z of the base.
    pub world_from_base: [[f64; 4]; 4],
    /// Tip force \[N\]; it acts on the needle along **minus** `y_tip`.
    pub tip_force_n: f64,
    /// Tip moment \[N m\]: E I S''(L) along plus `y_tip`.
    pub tip_moment_nm: f64,
    /// Rest points \[m\] and stiffnesses \[N/m\], from the surface to the tip.
    pub springs: Vec<([f64; 3], f64)>,
}

/// A solved [`Case`], in World.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct CaseShape {
    /// Position of O \[m\].
    pub tip_m: [f64; 3],
    /// Unit tip axis.
    pub tip_direction: [f64; 3],
    /// Where the needle crosses each spring's plane \[m\].
    pub spring_points_m: Vec<[f64; 3]>,
    /// (s, x, y, z) every 2 mm of arc length from the base, then the tip \[m\].
    pub shape: Vec<[f64; 4]>,
    /// Base twist in base axes to tip twist in tip axes, linear first, by rows; rest points and
    /// stiffnesses held, the load turning with the tip.
    pub j_tip_base: [[f64; 6]; 6],
    /// Iterations of the solver.
    pub iterations: usize,
    /// Length of the last one \[m\].
    pub residual: f64,
}

/// Why a case was refused or has no equilibrium.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum CaseError {
    /// A needle value out of range.
    #[error(transparent)]
    Needle(#[from] NeedleError),
    /// An entry of the pose that is not finite.
    #[error("world_from_base[{row}][{column}] must be finite, got {value}")]
    PoseEntry {
        /// Row.
        row: usize,
        /// Column.
        column: usize,
        /// Offending value.
        value: f64,
    },
    /// The last row of the pose is not (0, 0, 0, 1).
    #[error("world_from_base: the last row must be 0, 0, 0, 1")]
    PoseLastRow,
    /// The rotation part is no rotation.
    #[error("world_from_base: the upper left 3x3 is no rotation (defect {defect})")]
    Rotation {
        /// Largest entry of R R^T - I, or 2 for a reflection.
        defect: f64,
    },
    /// A spring stiffness that is not finite and positive.
    #[error("springs[{index}]: stiffness_n_per_m must be finite and positive, got {value}")]
    Stiffness {
        /// Offending spring.
        index: usize,
        /// Offending stiffness \[N/m\].
        value: f64,
    },
    /// A rest point that is not finite.
    #[error("springs[{index}]: rest_m[{axis}] must be finite, got {value}")]
    RestPoint {
        /// Offending spring.
        index: usize,
        /// Coordinate.
        axis: usize,
        /// Offending value.
        value: f64,
    },
    /// A tip load that is not finite.
    #[error("{name} must be finite, got {value}")]
    TipLoad {
        /// `tip_force_n` or `tip_moment_nm`.
        name: &'static str,
        /// Offending value.
        value: f64,
    },
    /// No equilibrium.
    #[error(transparent)]
    Equilibrium(#[from] EquilibriumError),
    /// No derivative.
    #[error(transparent)]
    Tangent(#[from] TangentError),
}

impl Case {
    /// Solves and describes the case.
    ///
    /// # Errors
    /// [`CaseError`] names the offending field, index and value.
    pub fn solve(&self) -> Result<CaseShape, CaseError> {
        let needle = Needle::new(
            self.length_m,
            self.outer_diameter_m,
            self.inner_diameter_m,
            self.young_modulus_pa,
        )?;
        let base = self.base()?;
        for (name, value) in [
            ("tip_force_n", self.tip_force_n),
            ("tip_moment_nm", self.tip_moment_nm),
        ] {
            if !value.is_finite() {
                return Err(CaseError::TipLoad { name, value });
            }
        }
        let mut springs = Vec::with_capacity(self.springs.len());
        for (index, (rest, stiffness)) in self.springs.iter().enumerate() {
            for (axis, &value) in rest.iter().enumerate() {
                if !value.is_finite() {
                    return Err(CaseError::RestPoint { index, axis, value });
                }
            }
            if !(stiffness.is_finite() && *stiffness > 0.0) {
                return Err(CaseError::Stiffness {
                    index,
                    value: *stiffness,
                });
            }
            springs.push(Spring {
                rest: Vector3::from(*rest),
                stiffness: *stiffness,
            });
        }
        let load = TipLoad {
            force: -self.tip_force_n,
            bending: self.tip_moment_nm,
        };
        let mut equilibrium = Equilibrium::new(needle, base);
        let convergence = equilibrium.solve(&base, &springs, load)?;
        let jacobian = equilibrium.tip_jacobian()?;
        let axes = |pose: &Isometry3<f64>| *pose.rotation.to_rotation_matrix().matrix();
        let jacobian = jacobian_in_frames(
            &jacobian,
            &axes(&base),
            &axes(&equilibrium.world_from_tip()),
        );
        Ok(CaseShape {
            tip_m: equilibrium.tip_position().into(),
            tip_direction: equilibrium.tip_axis().into(),
            spring_points_m: equilibrium.spring_points().map(|(p, _)| p.into()).collect(),
            shape: equilibrium
                .samples(SPACING)
                .into_iter()
                .map(|(s, p)| [s, p.x, p.y, p.z])
                .collect(),
            j_tip_base: std::array::from_fn(|r| std::array::from_fn(|c| jacobian[(r, c)])),
            iterations: convergence.iterations,
            residual: convergence.residual,
        })
    }

    fn base(&self) -> Result<Isometry3<f64>, CaseError> {
        let m = &self.world_from_base;
        for (row, values) in m.iter().enumerate() {
            for (column, &value) in values.iter().enumerate() {
                if !value.is_finite() {
                    return Err(CaseError::PoseEntry { row, column, value });
                }
            }
        }
        if m[3]
            .iter()
            .zip([0.0, 0.0, 0.0, 1.0])
            .any(|(v, w)| (v - w).abs() > ROTATION_TOLERANCE)
        {
            return Err(CaseError::PoseLastRow);
        }
        let rotation = Matrix3::from_fn(|r, c| m[r][c]);
        let mut defect = (rotation * rotation.transpose() - Matrix3::identity()).amax();
        if rotation.determinant() < 0.0 {
            defect = 2.0;
        }
        if defect > ROTATION_TOLERANCE {
            return Err(CaseError::Rotation { defect });
        }
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        // The nearest rotation: the matrix may be rounded.
        let rotation = UnitQuaternion::new_normalize(rotation.into_inner());
        Ok(Isometry3::from_parts(
            Translation3::new(m[0][3], m[1][3], m[2][3]),
            rotation,
        ))
    }
}
