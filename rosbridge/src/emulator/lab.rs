//! A whole emulated laboratory as a node: arm, sensor of shapes, hidden truth, and its time.

use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

use hal::frame::{Frame, LeftCamera, RightCamera, World as Laboratory};
use hal::telemetry::TruthReport;
use hal::{Arm, ArmState, Error, Joints, SensedShape, Stamp, StereoFrame, Transform};

use super::ArmNode;
use crate::codes::Code;
use crate::convert;
use crate::laboratory::{LABORATORY, SHAPES};
use crate::lockstep::ADVANCE;
use crate::msg::needle_steer_lockstep::{Advance, World};
use crate::msg::needle_steer_msgs::Shape;
use crate::msg::{rosgraph_msgs, sensor_msgs};
use crate::seam::{Inlet, Node, NodeClock, NodeError, Outlet, Quality, TimeBase};

/// What there is to see in the laboratory since the last time.
#[derive(Clone, Debug)]
pub struct Seen {
    /// Needle shapes that arrived.
    pub shapes: Vec<SensedShape>,
    /// Pairs of images that arrived.
    pub pairs: Vec<StereoFrame>,
    /// Where the frame of the measurements truly lies.
    pub stereo_from_world: Transform<LeftCamera, Laboratory>,
    /// The truth at the last exposure, without target and errors.
    pub truth: TruthReport,
    /// Straight start that the protocol asks for \[m\].
    pub pre_insertion: f64,
}

impl Default for Seen {
    fn default() -> Self {
        Self {
            shapes: Vec::new(),
            pairs: Vec::new(),
            stereo_from_world: Transform::identity(),
            truth: TruthReport::default(),
            pre_insertion: 0.0,
        }
    }
}

/// The topics of a laboratory. On a [simulated](TimeBase::Simulated) clock it moves in
/// [lockstep](crate::lockstep) with a controller.
pub struct LabNode {
    /// The arm's topics.
    pub arm: ArmNode,
    node: Node,
    clock: NodeClock,
    ticks: Option<Outlet<rosgraph_msgs::Clock>>,
    shapes: Outlet<Shape>,
    states: Outlet<World>,
    answers: Receiver<Advance>,
    last: Option<World>,
}

impl LabNode {
    /// Adds the laboratory's topics to the arm's.
    ///
    /// # Errors
    /// The master does not register them.
    pub fn new(node: &Node, arm: ArmNode) -> Result<Self, NodeError> {
        let (filled, answers) = sync_channel(16);
        let ticks = if node.time_base() == TimeBase::Simulated {
            Inlet::open::<Advance>(node, ADVANCE, Quality::Event(16), move |message| {
                // A full queue: the controller repeats.
                let _ = filled.try_send(message);
            })?;
            Some(Outlet::new(node, "/clock", Quality::Event(10))?)
        } else {
            None
        };
        Ok(Self {
            arm,
            clock: node.clock(),
            ticks,
            shapes: Outlet::new(node, SHAPES, Quality::Event(4))?,
            states: Outlet::new(node, LABORATORY, Quality::Latched(16))?,
            answers,
            last: None,
            node: node.clone(),
        })
    }

    /// Publishes the laboratory's state; `now` is its time.
    pub fn show(&mut self, now: Stamp, arm: &ArmState, seen: &Seen) {
        self.node.set_time(now);
        let stamp = self.clock.ros_stamp(now);
        if let Some(ticks) = &self.ticks {
            ticks.send(rosgraph_msgs::Clock {
                clock: convert::time(stamp),
            });
        }
        for shape in &seen.shapes {
            let mut message = Shape::from(shape);
            message.header.stamp = convert::time(self.clock.ros_stamp(shape.stamp));
            self.shapes.send(message);
        }
        for pair in &seen.pairs {
            self.arm.show_images(pair);
        }
        let mut joints = self.arm.feedback(arm);
        joints.header.stamp = convert::time(arm.stamp);
        let state = World {
            header: convert::header(stamp, "", 0),
            joints,
            robot: self.arm.status(arm),
            shapes: seen.shapes.iter().map(Into::into).collect(),
            // Without lockstep images have topics of their own.
            images: match &self.ticks {
                Some(_) => seen.pairs.iter().flat_map(images).collect(),
                None => Vec::new(),
            },
            stereo_from_world: convert::pose(seen.stereo_from_world.isometry()),
            pre_insertion: seen.pre_insertion,
            truth: (&seen.truth).into(),
            events: seen.truth.events.iter().map(|event| event.code()).collect(),
        };
        if self.ticks.is_some() {
            self.arm.joint_states.send(self.arm.feedback(arm));
            self.arm.robot_status.send(self.arm.status(arm));
            self.last = Some(state.clone());
        }
        self.states.send(state);
    }

    /// Waits for the controller's answer to the present state, for at most `patience`: the next
    /// instant, once `arm` has the new velocities.
    ///
    /// # Errors
    /// The arm has no state, or refuses what it should take.
    pub fn await_answer(
        &mut self,
        arm: &mut dyn Arm,
        patience: Duration,
    ) -> Result<Option<Stamp>, Error> {
        self.arm.answer(arm);
        let Ok(answer) = self.answers.recv_timeout(patience) else {
            return Ok(None);
        };
        let (now, until) = (self.clock.now(), convert::stamp(answer.until));
        if self.clock.run_stamp(answer.header.stamp) != now || until <= now {
            // It answers an older state: the present one got lost.
            if let Some(last) = &self.last {
                self.states.send(last.clone());
            }
            return Ok(None);
        }
        if let Some(rates) = answer.velocities.first()
            && let Ok(rates) = Joints::try_from(rates)
            && rates.is_finite()
        {
            self.arm.put(rates);
        }
        self.arm.command(arm, now)?;
        Ok(Some(until))
    }
}

fn images(pair: &StereoFrame) -> [sensor_msgs::Image; 2] {
    [
        convert::image(&pair.left, LeftCamera::NAME),
        convert::image(&pair.right, RightCamera::NAME),
    ]
}

impl std::fmt::Debug for LabNode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LabNode")
            .field("now", &self.clock.now())
            .finish_non_exhaustive()
    }
}
