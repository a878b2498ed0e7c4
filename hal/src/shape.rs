//! Sensed needle shapes and the contract of a shape sensor.

use nalgebra::{Matrix3, Unit, Vector3};
use serde::{Deserialize, Serialize};

use crate::frame::LeftCamera;
use crate::{Error, Position, Stamp};

/// A point of the visible shaft.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensedPoint {
    /// Position in the stereo frame \[m\].
    pub position: Position<LeftCamera>,
    /// Standard deviation across the shaft, per axis \[m\].
    pub sigma: f64,
}

/// The tip O (shaft centre just before the bevel) and the tip axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensedTip {
    /// Position of O in the stereo frame \[m\].
    pub position: Position<LeftCamera>,
    /// Covariance of the position \[m2\].
    pub covariance: Matrix3<f64>,
    /// Tip axis in the stereo frame, pointing out of the needle.
    pub direction: Unit<Vector3<f64>>,
    /// Standard deviation of the direction, per axis \[rad\].
    pub direction_sigma: f64,
}

/// The needle as a sensor saw it at one instant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensedShape {
    /// Middle of the exposure.
    pub stamp: Stamp,
    /// Counts exposures; a gap says that measurements were dropped.
    pub sequence: u64,
    /// Points of the visible shaft, from the surface towards the tip.
    pub points: Vec<SensedPoint>,
    /// The tip.
    pub tip: SensedTip,
}

/// A sensor that delivers needle shapes: vision, or a simulated sensor without images.
///
/// # Contract
/// `poll` never blocks; it returns the newest shape that was not yet returned, and skips older
/// ones. Stamps are of the exposure, on the rig's clock.
pub trait ShapeSensor: Send {
    /// The newest shape, if there is a new one.
    ///
    /// # Errors
    /// The sensor is gone.
    fn poll(&mut self) -> Result<Option<SensedShape>, Error>;

    /// Why no shapes come, in words, from sensors that know it: before the first shape, and when the
    /// newest is old. Sensors that say nothing are taken to be ready.
    fn hindrance(&self) -> Option<String> {
        None
    }
}
