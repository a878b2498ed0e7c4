//! Arms behind the hal traits.
//!
//! [`kinematics`] reads a URDF and knows the arm's geometry: forward and inverse kinematics,
//! Jacobians, joint rates from twists. [`sim`] is an arm that needs no hardware.
//!
//! **Architecture invariant:** nothing here knows of needles, tissue, cameras or laws.

pub mod arms;
pub mod kinematics;
pub mod meshes;
pub mod sim;
pub mod viper;
