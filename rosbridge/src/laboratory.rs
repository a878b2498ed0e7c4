//! An emulated laboratory as a controller sees it: needle shapes on a topic, and the hidden truth
//! for the score.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use hal::frame::LeftCamera;
use hal::telemetry::{TruthEvent, TruthReport};
use hal::{Error, SensedShape, ShapeSensor, Transform};

use crate::codes::Code;
use crate::convert;
use crate::msg::needle_steer_lockstep::World;
use crate::msg::needle_steer_msgs::Shape;
use crate::seam::{Inlet, Node, NodeError, Quality, lock};

/// Topic of the measured shapes (`needle_steer_msgs/Shape`, in the stereo frame).
pub const SHAPES: &str = "needle/shape";
/// Topic of an emulated laboratory's state (`needle_steer_lockstep/World`).
pub const LABORATORY: &str = "laboratory";
/// Truths kept for a reader that is late.
const KEPT: usize = 256;

/// A sensor of needle shapes behind a topic; any tracker may publish there.
#[derive(Clone, Debug, Default)]
pub struct RosShapes {
    newest: Arc<Mutex<Option<SensedShape>>>,
}

impl RosShapes {
    /// Listens to [`SHAPES`].
    ///
    /// # Errors
    /// The master does not register the topic.
    pub fn new(node: &Node) -> Result<Self, NodeError> {
        let sensor = Self::default();
        let (filled, clock) = (sensor.clone(), node.clock());
        Inlet::open::<Shape>(node, SHAPES, Quality::Stream(2), move |message| {
            // Shapes in another frame or with nonsense are none: the sensor stays silent.
            if let Ok(shape) = SensedShape::try_from(&message) {
                let stamp = clock.run_stamp(message.header.stamp);
                filled.put(SensedShape { stamp, ..shape });
            }
        })?;
        Ok(sensor)
    }

    /// Takes a shape in, unless it is older than the one that waits.
    pub(crate) fn put(&self, shape: SensedShape) {
        let mut newest = lock(&self.newest);
        if is_finite(&shape) && newest.as_ref().is_none_or(|last| last.stamp <= shape.stamp) {
            *newest = Some(shape);
        }
    }
}

impl ShapeSensor for RosShapes {
    fn poll(&mut self) -> Result<Option<SensedShape>, Error> {
        Ok(lock(&self.newest).take())
    }
}

fn is_finite(shape: &SensedShape) -> bool {
    let tip = &shape.tip;
    tip.position.coords().iter().all(|x| x.is_finite())
        && tip.covariance.iter().all(|x| x.is_finite())
        && tip.direction.iter().all(|x| x.is_finite())
        && (tip.direction.norm() - 1.0).abs() < 1e-3
        && tip.direction_sigma.is_finite()
        && shape.points.iter().all(|point| {
            point.sigma.is_finite() && point.position.coords().iter().all(|x| x.is_finite())
        })
}

/// The events of a truth; one that this build does not know is none.
fn events(codes: &[u8]) -> Vec<TruthEvent> {
    let known = codes.iter().map(|code| TruthEvent::from_code(*code));
    known.filter_map(Result::ok).collect()
}

/// What an emulated laboratory gives away for the score; never read by a law.
#[derive(Clone, Debug, PartialEq)]
pub struct Hidden {
    /// The truth, without target and errors.
    pub truth: TruthReport,
    /// Straight start that the protocol asks for \[m\].
    pub pre_insertion: f64,
    /// Where the frame of the measurements truly lies.
    pub stereo_from_world: Transform<LeftCamera, hal::frame::World>,
}

/// The hidden truths of an emulated laboratory, in their order.
#[derive(Clone, Debug, Default)]
pub struct Laboratory {
    waiting: Arc<Mutex<VecDeque<Hidden>>>,
}

impl Laboratory {
    /// Listens to [`LABORATORY`].
    ///
    /// # Errors
    /// The master does not register the topic.
    pub fn new(node: &Node) -> Result<Self, NodeError> {
        let laboratory = Self::default();
        let filled = laboratory.clone();
        let quality = Quality::Event(16);
        Inlet::open::<World>(node, LABORATORY, quality, move |message| {
            filled.put(&message);
        })?;
        Ok(laboratory)
    }

    pub(crate) fn put(&self, message: &World) {
        let mut waiting = lock(&self.waiting);
        if waiting.len() == KEPT {
            waiting.pop_front();
        }
        waiting.push_back(Hidden {
            truth: TruthReport {
                events: events(&message.events),
                ..(&message.truth).into()
            },
            pre_insertion: message.pre_insertion,
            stereo_from_world: convert::from_pose(&message.stereo_from_world),
        });
    }

    /// The next truth, if there is one.
    pub fn next_truth(&self) -> Option<Hidden> {
        lock(&self.waiting).pop_front()
    }
}
