//! Mechanics of a flexible bevel-tip needle in soft tissue.
//!
//! Modules in reading order. Everything is in World, SI units and radians; twists are
//! \[linear; angular\] of a frame's origin.

#![expect(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "a negated comparison also refuses NaN"
)]

mod needle;

mod bevel;

mod tissue;

mod spring;

mod segment;

mod frame;

mod piece;

mod tip_piece;

mod block;

mod equilibrium_error;

mod assembly;

mod equilibrium;

mod newton;

mod balance;

mod shape;

mod jacobian;

mod sensitivity;

mod measures;

mod estimation;

mod bed;

mod predictive;

mod kinematic;

mod case;

mod tip_law;

mod insertion;
mod insertion_error;

pub use balance::{Residuals, normal_force, shear_residual, tip_moment_residual};
pub use bevel::{Bevel, BevelError, BevelLoad, cut_angle};
pub use case::{Case, CaseError, CaseShape};
pub use equilibrium::{Convergence, Equilibrium};
pub use equilibrium_error::EquilibriumError;
pub use estimation::{Estimate, EstimationError, EstimationSettings, Estimator, Unknowns};
pub use insertion::{Insertion, InsertionSettings, RestPoint};
pub use insertion_error::InsertionError;
pub use jacobian::{TangentError, jacobian_in_frames};
pub use kinematic::{
    KinematicError, KinematicTip, TipPath, effective_curvature, natural_curvature,
};
pub use measures::mean_tissue_displacement;
pub use needle::{Needle, NeedleError, second_moment_of_area};
pub use predictive::{Authority, PathLaw, Prediction, PredictionError, Rollout, prediction_frame};
pub use segment::{Segment, curvature_gap, derivative_gap, position_gap};
pub use sensitivity::{
    Gradient, LOAD, PARAMETERS, STIFFNESS, Sensitivities, TwistRates, VectorRates,
};
pub use spring::{Spring, spring_force, spring_stiffness, supported_lengths};
pub use tip_piece::TipLoad;
pub use tissue::{Layer, Tissue, TissueError};
