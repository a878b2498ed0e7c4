//! A marker of the tissue behind a topic: any tracker may publish there.

use std::sync::{Arc, Mutex};

use hal::frame::{Frame, LeftCamera};
use hal::{Error, MarkerSensor, SensedMarker};

use crate::convert;
use crate::msg::geometry_msgs;
use crate::seam::{Inlet, Node, NodeError, Quality, lock};

/// Topic of the marker (`geometry_msgs/PointStamped`, in the stereo frame).
pub const MARKER: &str = "marker";

/// A sensor of a marker's place.
#[derive(Clone, Debug, Default)]
pub struct RosMarker {
    newest: Arc<Mutex<Option<SensedMarker>>>,
}

impl RosMarker {
    /// Listens to [`MARKER`]; `sigma` is the standard deviation of its measurements per
    /// axis \[m\].
    ///
    /// # Errors
    /// The master does not register the topic.
    pub fn new(node: &Node, sigma: f64) -> Result<Self, NodeError> {
        let sensor = Self::default();
        let (filled, clock) = (sensor.clone(), node.clock());
        Inlet::open::<geometry_msgs::PointStamped>(
            node,
            MARKER,
            Quality::Stream(2),
            move |message| {
                // A marker in another frame, or nowhere, is none: the sensor stays silent.
                if message.header.frame_id.trim_start_matches('/') == LeftCamera::NAME {
                    filled.put(SensedMarker {
                        stamp: clock.run_stamp(message.header.stamp),
                        position: convert::position(&message.point),
                        sigma,
                    });
                }
            },
        )?;
        Ok(sensor)
    }

    fn put(&self, marker: SensedMarker) {
        let mut newest = lock(&self.newest);
        let finite = marker.position.coords().iter().all(|x| x.is_finite());
        if finite && newest.is_none_or(|last| last.stamp <= marker.stamp) {
            *newest = Some(marker);
        }
    }
}

impl MarkerSensor for RosMarker {
    fn poll(&mut self) -> Result<Option<SensedMarker>, Error> {
        Ok(lock(&self.newest).take())
    }
}
