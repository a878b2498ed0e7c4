//! Ground truth: needle, tissue, cameras and their flaws.
//!
//! The world in which a controller is judged. It is made of other physics, another
//! discretisation and other parameters than the controller's model, and it may not see that
//! model: **architecture invariant:** this crate depends on `hal` alone of ours.
//!
//! In reading order:
//!
//! * [`Settings`]: what there is, by presets; [`Draw`]: what a seed makes of it for one run.
//! * [`Plant`]: what a needle in a world is; [`RodPlant`] is the rod in its tissue,
//!   [`ContinuumPlant`] another needle in another tissue, [`GivenPlant`] one whose shape another program
//!   computes.
//! * [`Truth`]: everything about the needle at one moment; [`Event`]: what ends its regular course.
//! * [`Bench`]: a plant with the robot's flaws, the cameras and the sensors, moved by one clock.
//! * [`experiment`]: the laboratory's places ([`Setup`]), and the paper's uncontrolled insertion scored.
//!
//! `docs/PHANTOM.md` of the project explains the physics.

pub mod camera;
pub mod experiment;
pub mod settings;

mod bench;
mod continuum;
mod draw;
mod em;
mod fbg;
mod field;
mod given;
mod guide;
mod hand;
mod marker;
mod medium;
mod motion;
mod needle;
mod path;
mod plant;
mod resistance;
mod robot;
mod rod;
mod sensor;
mod skin;
mod tissue;
mod truth;
mod twist;
mod view;

pub use bench::{Bench, Setup};
pub use continuum::ContinuumPlant;
pub use draw::Draw;
pub use em::{InAir, in_air};
pub use fbg::FibreArea;
pub use given::{GivenPlant, ShapeSource};
pub use hand::Hand;
pub use marker::SensedMarker;
pub use needle::RodPlant;
pub use plant::Plant;
pub use settings::{Settings, SettingsError};
pub use truth::{Event, Miss, Truth, Wrench};
pub use view::NeedleView;

/// The example of the README, as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
