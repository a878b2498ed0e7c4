//! What sees the needle: a sensor of shapes, or cameras.

use core::time::Duration;
use std::sync::Arc;

use hal::frame::{LeftCamera, World};
use hal::{SensedShape, ShapeSensor, Stamp, StereoCamera, StereoFrame, Transform};
use nalgebra::{Point3, Unit, Vector3};

use super::{Rig, RigBuildError, TICK};
use crate::controls::Controls;
use crate::distortion::{Corrected, DistortionMap};
use crate::hand::{AdvanceByTip, Slide};

/// Longest wait for the first pair of images.
const FIRST_PAIR: Duration = Duration::from_secs(2);
/// Longest wait for the first measurement of a tracker: its program may yet have to connect.
const FIRST_TIP: Duration = Duration::from_secs(10);

/// What sees the needle.
pub enum Eyes {
    /// A sensor of needle shapes.
    Shape(Box<dyn ShapeSensor>),
    /// A stereo camera, in whose images the needle is tracked.
    Cameras(Box<dyn StereoCamera>),
}

/// What the eyes saw since they were last asked.
#[derive(Clone, Debug, Default)]
pub enum Sighting {
    /// Nothing new.
    #[default]
    Nothing,
    /// The needle's shape.
    Shape(SensedShape),
    /// A pair of images.
    Pair(StereoFrame),
}

impl Sighting {
    /// Whether there is nothing new.
    pub const fn is_none(&self) -> bool {
        matches!(self, Self::Nothing)
    }

    /// The needle's shape, from a sensor of shapes.
    pub const fn shape(&self) -> Option<&SensedShape> {
        match self {
            Self::Shape(shape) => Some(shape),
            _ => None,
        }
    }

    /// The pair of images.
    pub const fn pair(&self) -> Option<&StereoFrame> {
        match self {
            Self::Pair(pair) => Some(pair),
            _ => None,
        }
    }

    /// When it was seen.
    pub fn stamp(&self) -> Option<Stamp> {
        match self {
            Self::Nothing => None,
            Self::Shape(shape) => Some(shape.stamp),
            Self::Pair(pair) => Some(pair.left.stamp),
        }
    }
}

/// Sees nothing.
struct Nobody;

impl ShapeSensor for Nobody {
    fn poll(&mut self) -> Result<Option<SensedShape>, hal::Error> {
        Ok(None)
    }
}

impl Eyes {
    /// Where nobody looks at the needle.
    pub fn none() -> Self {
        Self::Shape(Box::new(Nobody))
    }

    /// The same, less what the field of an electromagnetic tip does by its map.
    pub(super) fn corrected(
        self,
        map: Option<Arc<DistortionMap>>,
        left_from_world: &Transform<LeftCamera, World>,
    ) -> Self {
        match (self, map) {
            (Self::Shape(sensor), Some(map)) => {
                Self::Shape(Box::new(Corrected::new(sensor, map, *left_from_world)))
            }
            (eyes, _) => eyes,
        }
    }

    /// The same, telling how far the needle was pushed by hand.
    pub(super) fn telling_advance(
        self,
        slide: Slide,
        from: (Point3<f64>, Unit<Vector3<f64>>),
        left_from_world: &Transform<LeftCamera, World>,
    ) -> Self {
        match self {
            Self::Shape(sensor) => Self::Shape(Box::new(AdvanceByTip::new(
                sensor,
                slide,
                from,
                *left_from_world,
            ))),
            eyes @ Self::Cameras(_) => eyes,
        }
    }

    /// Why nothing is seen, in words, from what knows it.
    pub fn hindrance(&self) -> Option<String> {
        match self {
            Self::Shape(sensor) => sensor.hindrance(),
            Self::Cameras(cameras) => cameras.hindrance(),
        }
    }

    /// The newest sight.
    ///
    /// # Errors
    /// The sensor is gone.
    pub fn poll(&mut self) -> Result<Sighting, hal::Error> {
        Ok(match self {
            Self::Shape(sensor) => sensor.poll()?.map_or(Sighting::Nothing, Sighting::Shape),
            Self::Cameras(cameras) => cameras.poll()?.map_or(Sighting::Nothing, Sighting::Pair),
        })
    }
}

impl Rig {
    /// Waits until the needle is seen; in a simulated laboratory it is at once.
    ///
    /// # Errors
    /// It is not, and why.
    pub(crate) fn await_sight(&mut self, controls: &Controls) -> Result<(), RigBuildError> {
        let patience = match self.eyes {
            Eyes::Shape(_) => FIRST_TIP,
            Eyes::Cameras(_) => FIRST_PAIR,
        };
        let patience = self.clock.now() + patience;
        while let Some(blind) = self.blind() {
            if self.clock.now() > patience || controls.is_stopped() {
                return Err(blind);
            }
            let next = self.clock.now() + TICK;
            self.clock.wait_until(next);
        }
        Ok(())
    }

    /// Why an insertion cannot start for want of sight; nothing where it can.
    pub(crate) fn blind(&self) -> Option<RigBuildError> {
        let problem = self.eyes.hindrance()?;
        Some(match self.eyes {
            Eyes::Shape(_) => RigBuildError::NoTip { problem },
            Eyes::Cameras(_) => RigBuildError::NoImages { problem },
        })
    }
}

impl core::fmt::Debug for Eyes {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Shape(_) => "Shape",
            Self::Cameras(_) => "Cameras",
        })
    }
}
