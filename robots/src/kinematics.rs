//! Geometry of serial arms, read from a URDF.

mod chain;
mod coupled;
mod inverse;
mod line;
mod numeric;
mod opw;
mod parallel;
mod rates;
mod redundant;
mod rigid;
mod solver;
mod spin;
mod turns;
mod urdf;

pub use chain::{Chain, ENDLESS, Jacobian, JointKind, SLIDE_OF_A_RADIAN};
pub use inverse::Turns;
pub use opw::OpwParameters;
pub use rates::{RateSettings, TwistRates};
pub use spin::Spin;
pub use turns::{RemainingTravel, TurnBudget};
pub use urdf::error::UrdfError;
pub use urdf::{Section, arm_sections};
