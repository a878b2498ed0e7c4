//! A pair of cameras behind ROS topics.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use hal::{CameraFrame, Error, ErrorKind, Stamp, StereoCamera, StereoFrame};

use crate::image::{self, Depth, ImageRefused};
use crate::msg::sensor_msgs;
use crate::seam::{Inlet, Node, NodeClock, NodeError, Quality, Time, lock};

/// Images of one side that wait for their partners.
const WAITING: usize = 4;

/// Settings of cameras behind ROS topics.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RosCamerasOptions {
    /// Name of the pair for messages and errors.
    pub name: String,
    /// Topic of the left images, in any encoding of [`image`].
    pub left: String,
    /// Topic of the right images.
    pub right: String,
    /// Take `CompressedImage`s, from `/compressed` below each of the two.
    pub compressed: bool,
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
            compressed: false,
            tolerance: Duration::from_millis(2),
            timeout: Duration::from_secs(1),
        }
    }
}

impl RosCamerasOptions {
    fn topic(&self, side: Side) -> String {
        let base = match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        };
        let suffix = if self.compressed { "/compressed" } else { "" };
        format!("{base}{suffix}")
    }
}

/// The cameras. Before the first pair, `poll` finds nothing; after one, long silence is an error.
/// What keeps pairs from coming is said in words, by [`StereoCamera::hindrance`] and `/diagnostics`.
#[derive(Debug)]
pub struct RosCameras {
    name: String,
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
        let pairing = Arc::new(Mutex::new(Pairing::new(&options)));
        for side in [Side::Left, Side::Right] {
            let receiver = Receiver {
                side,
                clock: clock.clone(),
                pairing: Arc::clone(&pairing),
                depth: Mutex::default(),
            };
            let topic = options.topic(side);
            if options.compressed {
                Inlet::open::<sensor_msgs::CompressedImage>(
                    node,
                    &topic,
                    Quality::Stream(2),
                    move |message| {
                        let frame = image::decompressed(&message, &mut lock(&receiver.depth));
                        receiver.take(frame, message.header.stamp);
                    },
                )?;
            } else {
                Inlet::open::<sensor_msgs::Image>(
                    node,
                    &topic,
                    Quality::Stream(2),
                    move |message| {
                        let stamp = message.header.stamp;
                        let frame = image::grey(message, &mut lock(&receiver.depth));
                        receiver.take(frame, stamp);
                    },
                )?;
            }
        }
        let (asked, now) = (Arc::clone(&pairing), clock.clone());
        node.ask_about(&options.name, move || lock(&asked).hindrance(now.now()));
        Ok(Self {
            name: options.name,
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
        match (pairing.arrived, pairing.hindrance(self.clock.now())) {
            (Some(_), Some(why)) => Err(Error::with_source(&self.name, ErrorKind::Timeout, why)),
            _ => Ok(None),
        }
    }

    fn hindrance(&self) -> Option<String> {
        lock(&self.pairing).hindrance(self.clock.now())
    }
}

/// Where the images of one side arrive.
struct Receiver {
    side: Side,
    clock: NodeClock,
    pairing: Arc<Mutex<Pairing>>,
    depth: Mutex<Depth>,
}

impl Receiver {
    fn take(&self, frame: Result<CameraFrame, ImageRefused>, exposed: Time) {
        let stamp = self.clock.run_stamp(exposed);
        let mut pairing = lock(&self.pairing);
        match frame {
            Ok(frame) => {
                pairing.add(self.side, CameraFrame { stamp, ..frame }, self.clock.now());
            }
            Err(refused) => pairing.topics[self.side as usize].refused = Some(refused),
        }
    }
}

impl Topic {
    fn trouble(&self) -> Option<String> {
        match &self.refused {
            Some(refused) => Some(format!("{}: {refused}", self.name)),
            None if self.came => None,
            None => Some(format!("nothing comes on {}", self.name)),
        }
    }
}

#[derive(Clone, Copy, Debug)]
enum Side {
    Left,
    Right,
}

/// What came on one side's topic.
#[derive(Debug)]
struct Topic {
    name: String,
    /// An image that can be read came.
    came: bool,
    /// Why the newest image could not be read.
    refused: Option<ImageRefused>,
}

/// Brings images together whose stamps agree.
#[derive(Debug)]
struct Pairing {
    tolerance: Duration,
    timeout: Duration,
    topics: [Topic; 2],
    left: VecDeque<CameraFrame>,
    right: VecDeque<CameraFrame>,
    newest: Option<StereoFrame>,
    arrived: Option<Stamp>,
}

impl Pairing {
    fn new(options: &RosCamerasOptions) -> Self {
        let topics = [Side::Left, Side::Right].map(|side| Topic {
            name: options.topic(side),
            came: false,
            refused: None,
        });
        Self {
            tolerance: options.tolerance,
            timeout: options.timeout,
            topics,
            left: VecDeque::new(),
            right: VecDeque::new(),
            newest: None,
            arrived: None,
        }
    }

    /// Why there is no pair, or no recent one, in words.
    fn hindrance(&self, now: Stamp) -> Option<String> {
        if self.arrived.is_some_and(|at| now.since(at) <= self.timeout) {
            return None;
        }
        let troubles: Vec<String> = self.topics.iter().filter_map(Topic::trouble).collect();
        if !troubles.is_empty() {
            return Some(troubles.join("; "));
        }
        let last = self.arrived.map(|at| now.secs_since(at));
        let apart = match (self.left.back(), self.right.back()) {
            (Some(left), Some(right)) => left.stamp.secs_since(right.stamp).abs(),
            _ => 0.0,
        };
        let tolerance = self.tolerance.as_secs_f64();
        Some(match last {
            _ if apart > tolerance => format!(
                "left and right images are {:.1} ms apart, more than {:.0} ms",
                apart * 1e3,
                tolerance * 1e3
            ),
            Some(age) => format!("the last pair came {age:.1} s ago"),
            None => "no pair yet".to_owned(),
        })
    }

    fn add(&mut self, side: Side, frame: CameraFrame, now: Stamp) {
        let topic = &mut self.topics[side as usize];
        topic.came = true;
        topic.refused = None;
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
        let mut pairing = Pairing::new(&RosCamerasOptions::default());
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
        let mut pairing = Pairing::new(&RosCamerasOptions::default());
        for i in 0..100 {
            pairing.add(Side::Left, frame(33 * i), Stamp::ZERO);
        }
        assert!(pairing.newest.is_none() && pairing.arrived.is_none());
        assert_eq!(pairing.left.len(), WAITING);
    }

    #[test]
    fn what_keeps_pairs_from_coming_is_said() {
        let mut pairing = Pairing::new(&RosCamerasOptions::default());
        let why = |pairing: &Pairing| pairing.hindrance(Stamp::from_secs(1.0)).unwrap();
        let text = why(&pairing);
        assert!(text.contains("nothing comes on left/image_raw"), "{text}");
        pairing.add(Side::Left, frame(900), Stamp::from_secs(0.9));
        let text = why(&pairing);
        assert_eq!(text, "nothing comes on right/image_raw");
        pairing.add(Side::Right, frame(906), Stamp::from_secs(0.9));
        let text = why(&pairing);
        assert_eq!(
            text,
            "left and right images are 6.0 ms apart, more than 2 ms"
        );
        pairing.topics[1].refused = Some(ImageRefused::Encoding {
            encoding: "yuv422".to_owned(),
        });
        let text = why(&pairing);
        assert!(
            text.contains("right/image_raw") && text.contains("yuv422"),
            "{text}"
        );
        pairing.add(Side::Left, frame(940), Stamp::from_secs(0.94));
        pairing.add(Side::Right, frame(940), Stamp::from_secs(0.94));
        assert_eq!(pairing.hindrance(Stamp::from_secs(1.0)), None);
        let text = pairing.hindrance(Stamp::from_secs(3.0)).unwrap();
        assert!(text.contains("2.1 s ago"), "{text}");
    }
}
