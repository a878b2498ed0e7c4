//! Ground truth: needle, tissue, cameras and their flaws.

pub mod camera;
pub mod draw;
pub mod needle;
pub mod plant;
pub mod settings;
pub mod truth;
pub mod view;

mod field;
mod medium;
mod motion;
mod path;
mod rod;
mod tissue;
mod twist;

pub use draw::Draw;
pub use needle::RodPlant;
pub use plant::Plant;
pub use settings::{Settings, SettingsError};
pub use truth::{Event, Miss, Truth, Wrench};
pub use view::NeedleView;
