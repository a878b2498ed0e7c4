//! What sees the marker that the tissue carries.

use core::time::Duration;

use hal::{Error, MarkerSensor, SensedMarker};

use super::{Rig, RigBuildError, TICK};
use crate::config::{Config, TargetKind};

/// Longest wait for the first place of a marker.
const FIRST: Duration = Duration::from_secs(2);

/// A marker's sensor, where there is one, and the newest it saw.
#[derive(Default)]
pub struct MarkerEyes {
    sensor: Option<Box<dyn MarkerSensor>>,
    newest: Option<SensedMarker>,
}

impl MarkerEyes {
    /// Eyes with this sensor.
    pub fn new(sensor: Box<dyn MarkerSensor>) -> Self {
        Self {
            sensor: Some(sensor),
            newest: None,
        }
    }

    /// The newest measurement, if there is a new one.
    ///
    /// # Errors
    /// The sensor is gone.
    pub fn poll(&mut self) -> Result<Option<SensedMarker>, Error> {
        let seen = match &mut self.sensor {
            Some(sensor) => sensor.poll()?,
            None => None,
        };
        self.newest = seen.or(self.newest);
        Ok(seen)
    }

    /// The newest measurement, new or not.
    pub const fn newest(&self) -> Option<&SensedMarker> {
        self.newest.as_ref()
    }
}

impl core::fmt::Debug for MarkerEyes {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("MarkerEyes")
            .field("newest", &self.newest)
            .finish_non_exhaustive()
    }
}

impl Rig {
    /// Waits for a target that is a marker to be seen; one that a simulated laboratory has
    /// attached is there.
    ///
    /// # Errors
    /// Nothing sees it.
    pub(crate) fn await_marker(&mut self, config: &Config) -> Result<(), RigBuildError> {
        let attached = self.world.as_ref().and_then(|world| world.marker());
        if config.target.kind != TargetKind::Marker || attached.is_some() {
            return Ok(());
        }
        let patience = self.clock.now() + FIRST;
        while self.marker.poll()?.is_none() {
            if self.clock.now() > patience {
                return Err(RigBuildError::NoMarker);
            }
            let next = self.clock.now() + TICK;
            self.clock.wait_until(next);
        }
        Ok(())
    }
}
