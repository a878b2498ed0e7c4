//! Geometry of serial arms with six or seven revolute joints, read from a URDF.

mod chain;
mod urdf;

pub use chain::{Chain, Jacobian};
pub use urdf::UrdfError;
