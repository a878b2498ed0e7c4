//! A pair of cameras behind ROS topics.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use hal::{CameraFrame, Error, ErrorKind, Stamp, StereoCamera, StereoFrame};

use crate::convert;
use crate::msg::sensor_msgs;
use crate::seam::{Inlet, Node, NodeClock, NodeError, lock};

/// Images of one side that wait for their partners.
const WAITING: usize = 4;

/// Settings of cameras behind ROS topics.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RosCamerasOptions {
    /// Name of the pair for messages and errors.
    pub name: String,
    /// Topic of the left images (mono8).
    pub left: String,
    /// Topic of the right images (mono8).
    pub right: String,
    /// Largest distance between the stamps of a pair.
    pub tolerance: Duration,
    /// Silence after which the cameras count as gone.
    pub timeout: Duration,
}

impl Default for RosCamerasOptions {
    fn default() -> Self {
        Self {
            name: "cameras".to_owned(),
            left: "left/image_raw".to_owned(),
            right: "right/image_raw".to_owned(),
            tolerance: Duration::from_millis(2),
            timeout: Duration::from_secs(1),
        }
    }
}

/// The cameras. Before the first pair, `poll` finds nothing; after one, long silence is an error.
#[derive(Debug)]
pub struct RosCameras {
    name: String,
    timeout: Duration,
    clock: NodeClock,
    pairing: Arc<Mutex<Pairing>>,
}

impl RosCameras {
    /// Subscribes to both cameras.
    ///
    /// # Errors
    /// The master does not register the topics.
    pub fn new(node: &Node, options: RosCamerasOptions) -> Result<Self, NodeError> {
        let clock = node.clock();
        let pairing = Arc::new(Mutex::new(Pairing::new(options.tolerance)));
        for (topic, side) in [(&options.left, Side::Left), (&options.right, Side::Right)] {
            let (pairing, clock) = (Arc::clone(&pairing), clock.clone());
            Inlet::open::<sensor_msgs::Image>(node, topic, 2, move |message| {
                let stamp = clock.run_stamp(message.header.stamp);
                // Images of another encoding are no images: the cameras stay silent.
                if let Ok(frame) = convert::from_image(message) {
                    lock(&pairing).add(side, CameraFrame { stamp, ..frame }, clock.now());
                }
            })?;
        }
        Ok(Self {
            name: options.name,
            timeout: options.timeout,
            clock,
            pairing,
        })
    }
}

impl StereoCamera for RosCameras {
    fn poll(&mut self) -> Result<Option<StereoFrame>, Error> {
        let mut pairing = lock(&self.pairing);
        if let Some(pair) = pairing.newest.take() {
            return Ok(Some(pair));
        }
        let silent = pairing
            .arrived
            .is_some_and(|at| self.clock.now().since(at) > self.timeout);
        if silent {
            Err(Error::new(&self.name, ErrorKind::Timeout))
        } else {
            Ok(None)
        }
    }
}

#[derive(Clone, Copy, Debug)]
enum Side {
    Left,
    Right,
}

/// Brings images together whose stamps agree.
#[derive(Debug)]
struct Pairing {
    tolerance: Duration,
    left: VecDeque<CameraFrame>,
    right: VecDeque<CameraFrame>,
    newest: Option<StereoFrame>,
    arrived: Option<Stamp>,
}

impl Pairing {
    fn new(tolerance: Duration) -> Self {
        Self {
            tolerance,
            left: VecDeque::new(),
            right: VecDeque::new(),
            newest: None,
            arrived: None,
        }
    }

    fn add(&mut self, side: Side, frame: CameraFrame, now: Stamp) {
        let (own, others) = match side {
            Side::Left => (&mut self.left, &mut self.right),
            Side::Right => (&mut self.right, &mut self.left),
        };
        let tolerance = self.tolerance.as_secs_f64();
        let partner = others
            .iter()
            .position(|other| other.stamp.secs_since(frame.stamp).abs() <= tolerance);
        let Some(at) = partner else {
            own.push_back(frame);
            if own.len() > WAITING {
                own.pop_front();
            }
            return;
        };
        // Older ones will not find a partner any more.
        let Some(other) = others.drain(..=at).next_back() else {
            return;
        };
        own.retain(|waiting| waiting.stamp > frame.stamp);
        let pair = match side {
            Side::Left => StereoFrame {
                left: frame,
                right: other,
            },
            Side::Right => StereoFrame {
                left: other,
                right: frame,
            },
        };
        let newer = self
            .newest
            .as_ref()
            .is_none_or(|last| last.left.stamp < pair.left.stamp);
        if newer {
            self.newest = Some(pair);
        }
        self.arrived = Some(now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::GrayImage;

    fn frame(ms: u64) -> CameraFrame {
        let image = GrayImage::filled(2, 2, 0).into();
        CameraFrame {
            stamp: Stamp::from_nanos(ms * 1_000_000),
            sequence: ms,
            image,
        }
    }

    #[test]
    fn images_are_paired_by_stamp_in_any_order_and_the_newest_wins() {
        let mut pairing = Pairing::new(Duration::from_millis(2));
        let arrivals = [
            (Side::Left, 0),
            (Side::Left, 33),
            (Side::Right, 34),
            (Side::Right, 0),
            (Side::Right, 66),
            (Side::Left, 100),
            (Side::Left, 66),
        ];
        for (side, ms) in arrivals {
            pairing.add(side, frame(ms), Stamp::from_secs(1.0));
        }
        let pair = pairing.newest.take().unwrap();
        assert_eq!((pair.left.sequence, pair.right.sequence), (66, 66));
        assert_eq!(pairing.left.len(), 1, "100 ms still waits");
    }

    #[test]
    fn a_dead_side_does_not_fill_memory_and_makes_no_pairs() {
        let mut pairing = Pairing::new(Duration::from_millis(2));
        for i in 0..100 {
            pairing.add(Side::Left, frame(33 * i), Stamp::ZERO);
        }
        assert!(pairing.newest.is_none() && pairing.arrived.is_none());
        assert_eq!(pairing.left.len(), WAITING);
    }
}
