//! Mechanics of a flexible bevel-tip needle in soft tissue.
//!
//! A needle whose tip is cut at an angle bends as it is pushed. Where it lies is the equilibrium of an
//! elastic rod with the tissue around it, which remembers where the tip has cut. In reading order:
//!
//! * The problem: [`Needle`], [`Bevel`], [`Tissue`]; tissue acts by [`Spring`]s along the shaft and a
//!   [`TipLoad`] on the bevel.
//! * The solver: [`Equilibrium`], with [`Residuals`] that say how well it balances, the shape as
//!   [`Segment`]s, the paper's Jacobian by [`jacobian_in_frames`], and [`Sensitivities`] of everything.
//! * An insertion: [`Insertion`] moves the base, lets the tip cut and springs be born.
//! * From measurements: [`Estimator`] fits stiffness and tip load to a measured shape.
//! * Where the tip will be: [`Prediction`] lays the path on; [`KinematicTip`] is the model without mechanics.
//! * One state given as numbers, solved and described: [`Case`].
//!
//! Everything is in World, SI units and radians; twists are \[linear; angular\] of a frame's origin.
//!
//! **Architecture invariant:** no time, no hardware: a shape is a function of base pose, springs and load.

#![expect(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "a negated comparison also refuses NaN"
)]

// The problem.
mod bevel;
mod needle;
mod spring;
mod tip_piece;
mod tissue;

// The equilibrium: its unknowns, its equations, the solver.
mod assembly;
mod block;
mod equilibrium;
mod equilibrium_error;
mod frame;
mod newton;
mod piece;
mod segment;

// What is read off an equilibrium.
mod balance;
mod jacobian;
mod measures;
mod sensitivity;
mod shape;

// Insertion, estimation, prediction, single cases.
mod bed;
mod case;
mod estimation;
mod insertion;
mod insertion_error;
mod kinematic;
mod predictive;
mod tip_law;

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

/// The example of the README, as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
