//! Why there is no equilibrium, and the check of what is given.

use nalgebra::{Isometry3, Vector3};
use thiserror::Error;

use crate::spring::Spring;
use crate::tip_piece::TipLoad;

/// Why there is no equilibrium.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum EquilibriumError {
    /// The base pose has a coordinate that is not finite.
    #[error("the base pose is not finite")]
    BasePose,
    /// The tip load is not finite.
    #[error("the tip load is not finite: force {force_n} N, moment {moment_nm} N m")]
    TipLoad {
        /// Force \[N\].
        force_n: f64,
        /// End moment \[N m\].
        moment_nm: f64,
    },
    /// A rest point has a coordinate that is not finite.
    #[error("spring {index}: the rest point is not finite")]
    RestPoint {
        /// Offending spring, from 0 at the surface.
        index: usize,
    },
    /// A stiffness that is not finite and positive (0 is accepted for a newborn spring).
    #[error(
        "spring {index}: stiffness must be finite and not negative, got {stiffness_n_per_m} N/m"
    )]
    Stiffness {
        /// Offending spring.
        index: usize,
        /// Offending stiffness \[N/m\].
        stiffness_n_per_m: f64,
    },
    /// A rest point not in front of the base.
    #[error("spring {index} lies {ahead_m} m ahead of the base along its axis: behind the base")]
    BehindBase {
        /// Offending spring.
        index: usize,
        /// Distance along the base axis \[m\].
        ahead_m: f64,
    },
    /// Rest points not in order from the base to the tip.
    #[error(
        "spring {index} is out of order: {ahead_m} m ahead of the one before along the base axis"
    )]
    Order {
        /// Offending spring.
        index: usize,
        /// Distance along the base axis \[m\].
        ahead_m: f64,
    },
    /// The needle does not reach its last spring.
    #[error("the needle is too short: {needed_m} m to its last spring, needle length_m {length_m}")]
    TooShort {
        /// Arc length up to the last spring \[m\].
        needed_m: f64,
        /// Needle length \[m\].
        length_m: f64,
    },
    /// Newton's method did not reach the tolerance.
    #[error("no equilibrium after {iterations} iterations (last step {last_step_m} m)")]
    NotConverged {
        /// Iterations done.
        iterations: usize,
        /// Last step \[m\].
        last_step_m: f64,
    },
    /// The tangent is singular: the needle buckles or folds back.
    #[error("the needle is unstable: singular tangent at iteration {iteration}")]
    Unstable {
        /// Iteration at which it happened.
        iteration: usize,
    },
}

/// Checks pose, springs and load.
pub(crate) fn validate(
    base: &Isometry3<f64>,
    springs: &[Spring],
    load: TipLoad,
) -> Result<(), EquilibriumError> {
    let position = base.translation.vector;
    if !position
        .iter()
        .chain(base.rotation.coords.iter())
        .all(|v| v.is_finite())
    {
        return Err(EquilibriumError::BasePose);
    }
    if !(load.force.is_finite() && load.bending.is_finite()) {
        return Err(EquilibriumError::TipLoad {
            force_n: load.force,
            moment_nm: load.bending,
        });
    }
    let z = base * Vector3::z();
    let mut before = position;
    for (index, spring) in springs.iter().enumerate() {
        if !spring.rest.iter().all(|v| v.is_finite()) {
            return Err(EquilibriumError::RestPoint { index });
        }
        if !(spring.stiffness.is_finite() && spring.stiffness >= 0.0) {
            let stiffness_n_per_m = spring.stiffness;
            return Err(EquilibriumError::Stiffness {
                index,
                stiffness_n_per_m,
            });
        }
        let ahead_m = z.dot(&(spring.rest - before));
        if !(ahead_m > 0.0) {
            return Err(if index == 0 {
                EquilibriumError::BehindBase { index, ahead_m }
            } else {
                EquilibriumError::Order { index, ahead_m }
            });
        }
        before = spring.rest;
    }
    Ok(())
}
