//! Ground truth: needle, tissue, cameras and their flaws.
//!
//! The world in which a controller is judged. It is made of other physics, another
//! discretisation and other parameters than the controller's model, and it may not see that
//! model: **architecture invariant:** this crate depends on `hal` alone of ours.
//!
//! Reading order: [`settings`] says what there is; [`needle`] steps the rod in its tissue;
//! [`continuum`] is another needle in another tissue;
//! [`mod@bench`] adds the robot's flaws and the sensors; [`experiment`] scores the paper's
//! uncontrolled insertion. `docs/PHANTOM.md` explains the physics.

pub mod settings;
pub mod view;
pub mod truth;
pub mod plant;
pub mod needle;
pub mod continuum;
pub mod given;
pub mod draw;
pub mod robot;
pub mod sensor;
pub mod em;
pub mod hand;
pub mod marker;
pub mod camera;
pub mod bench;
pub mod experiment;

mod field;
mod guide;
mod medium;
mod motion;
mod path;
mod resistance;
mod rod;
mod skin;
mod tissue;
mod twist;

pub use bench::{Bench, Setup};
pub use continuum::ContinuumPlant;
pub use draw::Draw;
pub use given::{GivenPlant, ShapeSource};
pub use hand::Hand;
pub use marker::SensedMarker;
pub use needle::RodPlant;
pub use plant::Plant;
pub use settings::{Settings, SettingsError};
pub use truth::{Event, Miss, Truth, Wrench};
pub use view::NeedleView;
