//! Fibre Bragg gratings in a needle, and the contract of what reads them.

use serde::{Deserialize, Serialize};

use crate::{Error, Stamp};

/// Shifts of the gratings' wavelengths at one instant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WavelengthShifts {
    /// Middle of the exposure.
    pub stamp: Stamp,
    /// Counts exposures; a gap says that measurements were dropped.
    pub sequence: u64,
    /// Wavelengths less those of the straight needle at its reference temperature \[nm\]: area by
    /// area from the base to the tip, and in each channel by channel. What is not read is NaN.
    pub shifts_nm: Vec<f64>,
}

/// What reads a needle's gratings: an interrogator, or a simulated one.
///
/// # Contract
/// `poll` never blocks; it returns the newest reading that was not yet returned, and skips older
/// ones. Stamps are of the exposure, on the rig's clock.
pub trait FibreSensor: Send {
    /// The newest reading, if there is a new one.
    ///
    /// # Errors
    /// The sensor is gone.
    fn poll(&mut self) -> Result<Option<WavelengthShifts>, Error>;
}
