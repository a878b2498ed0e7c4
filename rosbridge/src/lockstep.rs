//! Time of an emulated laboratory, moved by the controller: a run over ROS that does not depend
//! on the speed of machine or network.
//!
//! The laboratory publishes its state, the controller answers with new velocities and the next
//! instant, and so on. Either message may get lost: the answer is repeated until the next state
//! comes, and the laboratory repeats its state when an old answer comes.

use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use hal::{CameraFrame, Clock, Error, SensedShape, Stamp, StereoCamera, StereoFrame};

use crate::arm::core::{Core, Reading};
use crate::arm::{RosArm, RosArmError, RosArmOptions, feedback_of};
use crate::convert;
use crate::image::{self, Depth};
use crate::laboratory::{LABORATORY, Laboratory, RosShapes};
use crate::msg::needle_steer_lockstep::{Advance, World};
use crate::msg::sensor_msgs;
use crate::seam::{Inlet, Node, NodeClock, Outlet, Quality, lock};
use crate::status;

/// Topic of the controller's answers (`needle_steer_lockstep/Advance`).
pub const ADVANCE: &str = "laboratory/advance";
/// Longest wait for a laboratory at the start.
const CONNECT: Duration = Duration::from_secs(10);
/// Longest wait for the laboratory's next state; then it is lost.
const PATIENCE: Duration = Duration::from_secs(5);
/// Wait before an answer is repeated.
const REPEAT: Duration = Duration::from_millis(100);

/// The controller's clock: waiting moves the laboratory. A laboratory that is lost leaves the
/// clock running alone, so that the arm's feedback grows stale and faults it.
pub struct Lockstep {
    clock: NodeClock,
    joint_names: Vec<String>,
    core: Arc<Mutex<Core>>,
    period: Duration,
    next_tick: Stamp,
    advance: Outlet<Advance>,
    states: Receiver<World>,
    shapes: RosShapes,
    cameras: LockstepCameras,
    laboratory: Laboratory,
    lost: bool,
}

/// Cameras whose images come with the laboratory's states.
#[derive(Clone, Debug, Default)]
pub struct LockstepCameras {
    newest: Arc<Mutex<Option<StereoFrame>>>,
}

impl LockstepCameras {
    fn put(&self, [left, right]: &[sensor_msgs::Image; 2]) {
        let frame = |image: &sensor_msgs::Image| -> Option<CameraFrame> {
            image::grey(image.clone(), &mut Depth::default()).ok()
        };
        // The laboratory of this project sends mono8; others are no part of the lockstep.
        if let (Some(left), Some(right)) = (frame(left), frame(right)) {
            *lock(&self.newest) = Some(StereoFrame { left, right });
        }
    }
}

impl StereoCamera for LockstepCameras {
    fn poll(&mut self) -> Result<Option<StereoFrame>, Error> {
        Ok(lock(&self.newest).take())
    }
}

/// A controller's devices in lockstep.
#[derive(Debug)]
pub struct Parts {
    /// The arm.
    pub arm: RosArm,
    /// The clock of the run.
    pub clock: Lockstep,
    /// The sensor of needle shapes.
    pub shapes: RosShapes,
    /// The cameras.
    pub cameras: LockstepCameras,
    /// The hidden truth.
    pub laboratory: Laboratory,
}

impl Lockstep {
    /// Meets the laboratory and takes in its first state; takes at most 10 s. The node's time
    /// base is to be [`Remote`](crate::TimeBase::Remote).
    ///
    /// # Errors
    /// The master does not register the topics, the description does not fit, or there is no
    /// laboratory.
    pub fn open(node: &Node, options: &RosArmOptions) -> Result<Parts, RosArmError> {
        let arm = RosArm::undriven(node, options)?;
        let (filled, states) = sync_channel(16);
        Inlet::open::<World>(node, LABORATORY, Quality::Latched(16), move |message| {
            // A full queue: nobody waits for a state now.
            let _ = filled.try_send(message);
        })?;
        let mut clock = Self {
            clock: node.clock(),
            joint_names: options.description.joint_names.clone(),
            core: arm.core(),
            period: options.description.period,
            next_tick: Stamp::ZERO,
            advance: Outlet::new(node, ADVANCE, Quality::Event(4))?,
            states,
            shapes: RosShapes::default(),
            cameras: LockstepCameras::default(),
            laboratory: Laboratory::default(),
            lost: false,
        };
        let first = clock.states.recv_timeout(CONNECT);
        let first = first.map_err(|_| RosArmError::NoLaboratory {
            topic: LABORATORY.to_owned(),
            seconds: CONNECT.as_secs(),
        })?;
        clock.take(&first);
        Ok(Parts {
            arm,
            shapes: clock.shapes.clone(),
            cameras: clock.cameras.clone(),
            laboratory: clock.laboratory.clone(),
            clock,
        })
    }

    /// Takes in a state of the laboratory.
    fn take(&mut self, state: &World) {
        let now = self.clock.run_stamp(state.header.stamp);
        self.clock.tell(now);
        let mut core = lock(&self.core);
        if let Ok((positions, rates)) = feedback_of(&state.joints, &self.joint_names) {
            let stamp = convert::stamp(state.joints.header.stamp);
            let reading = Reading {
                stamp,
                behind: now.secs_since(stamp),
                positions,
                rates,
            };
            core.feedback(now, reading);
        }
        core.robot(now, status::hindrance(&state.robot));
        drop(core);
        for shape in state
            .shapes
            .iter()
            .filter_map(|m| SensedShape::try_from(m).ok())
        {
            self.shapes.put(shape);
        }
        for pair in state.images.as_chunks::<2>().0 {
            self.cameras.put(pair);
        }
        self.laboratory.put(state);
    }

    /// One exchange: new velocities, if they are due, and the laboratory's next instant.
    #[expect(clippy::disallowed_methods, reason = "patience is wall-clock time")]
    fn exchange(&mut self, until: Stamp) {
        let now = self.clock.now();
        let due = now >= self.next_tick;
        let velocities = due.then(|| lock(&self.core).tick(now)).flatten();
        if due {
            self.next_tick = now + self.period;
        }
        let answer = Advance {
            header: convert::header(self.clock.ros_stamp(now), "", 0),
            until: convert::time(until),
            velocities: velocities.iter().map(Into::into).collect(),
        };
        let patience = Instant::now() + PATIENCE;
        while !self.lost {
            self.advance.send(answer.clone());
            if self.await_state(until) {
                return;
            }
            self.lost = Instant::now() > patience;
        }
        self.clock.tell(until);
    }

    /// Whether the state of `until` comes before the answer is to be repeated.
    fn await_state(&mut self, until: Stamp) -> bool {
        loop {
            match self.states.recv_timeout(REPEAT) {
                Ok(state) if self.clock.run_stamp(state.header.stamp) >= until => {
                    self.take(&state);
                    return true;
                }
                // A repeated one.
                Ok(_) => {}
                Err(RecvTimeoutError::Timeout) => return false,
                Err(RecvTimeoutError::Disconnected) => {
                    self.lost = true;
                    return false;
                }
            }
        }
    }

    /// Whether the laboratory has stopped answering.
    pub const fn is_lost(&self) -> bool {
        self.lost
    }
}

impl Clock for Lockstep {
    fn now(&self) -> Stamp {
        self.clock.now()
    }

    fn wait_until(&mut self, deadline: Stamp) {
        while self.clock.now() < deadline {
            let next = (self.clock.now() + self.period).min(deadline);
            self.exchange(next);
        }
    }
}

impl std::fmt::Debug for Lockstep {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Lockstep")
            .field("now", &self.clock.now())
            .field("lost", &self.lost)
            .finish_non_exhaustive()
    }
}
