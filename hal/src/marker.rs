//! A marker that tissue carries, and the contract of a sensor that sees it.

use serde::{Deserialize, Serialize};

use crate::frame::LeftCamera;
use crate::{Error, Position, Stamp};

/// A marker of the moving tissue as a sensor saw it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensedMarker {
    /// Middle of the exposure.
    pub stamp: Stamp,
    /// Where it was, in the stereo frame \[m\].
    pub position: Position<LeftCamera>,
    /// Standard deviation per axis \[m\].
    pub sigma: f64,
}

/// A sensor of a marker's place: a tracker of a laboratory's own, or a simulated one.
///
/// # Contract
/// `poll` never blocks; it returns the newest measurement that was not yet returned, and skips
/// older ones. Stamps are of the exposure, on the rig's clock.
pub trait MarkerSensor: Send {
    /// The newest measurement, if there is a new one.
    ///
    /// # Errors
    /// The sensor is gone.
    fn poll(&mut self) -> Result<Option<SensedMarker>, Error>;
}
