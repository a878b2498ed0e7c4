//! The stereo pair: what two cameras see of the needle, through the container's wall and the
//! gel, and what the controller is told about them.
//!
//! Independent of crate `vision`: the projection, the distortion and the refraction are written
//! here a second time, from the laws of optics.
//!
//! [`StereoRig`] is the device; [`View`] the exact projection of one camera; [`RigParameters`]
//! its parameters, once true and once as given by a calibration; [`CameraSettings`] every flaw.

mod background;
mod blur;
mod board;
mod calibration;
mod covariance;
mod coverage;
mod geometry;
mod lens;
mod noise;
mod parameters;
mod presets;
mod refraction;
mod renderer;
mod settings;
mod silhouette;
mod stereo;
mod stereo_frame;
#[cfg(test)]
mod tests;
mod view;

pub use board::{BoardError, BoardView};
pub use covariance::{CalibrationSigma, Undetermined, calibration_boards, calibration_sigma};
pub use lens::{Lens, Pixel};
pub use parameters::{Container, Plane, RigParameters, Side};
pub use settings::{
    BacklightSettings, BubbleSettings, CalibrationSettings, CameraSettings, ContainerSettings,
    DeliverySettings, NoiseSettings, OpticsSettings,
};
pub use stereo::{RigError, StereoRig};
pub use view::{Ray, Through, View};
