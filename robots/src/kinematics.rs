//! Geometry of serial arms with six or seven revolute joints, read from a URDF.

mod chain;
mod inverse;
mod line;
mod numeric;
mod opw;
mod parallel;
mod rates;
mod solver;
mod turns;
mod urdf;
mod urdf_error;

pub use chain::{Chain, Jacobian};
pub use inverse::Turns;
pub use opw::OpwParameters;
pub use rates::{RateSettings, TwistRates};
pub use turns::{NotEnoughTravel, RemainingTravel, TurnBudget};
pub use urdf_error::UrdfError;
