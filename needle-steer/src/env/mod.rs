//! Environments to learn steering in: the phantom, moved by base twists, without an arm.
//!
//! [`Hand`] moves a phantom by hand. [`Episode`] adds a protocol around it (a straight start, a
//! target, an end), what a policy sees and what it earns; [`Settings`] says from which worlds
//! episodes are drawn. [`Envs`] steps many of them on threads. An episode is a function of its seed
//! and the actions.

mod action;
mod episode;
mod hand;
mod many;
mod observation;
mod settings;

pub use action::{Action, Actions};
pub use episode::{Episode, Outcome, Step};
pub use hand::{Hand, HandError};
pub use many::{Envs, Steps};
pub use observation::OBSERVATION;
pub use settings::{EnvError, Reward, Settings};
