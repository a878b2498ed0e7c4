//! An arm behind ROS topics: any arm that takes joint velocities.
//!
//! Listens to `joint_states` and publishes `joint_group_velocity_controller/command`
//! (`std_msgs/Float64MultiArray`, base to flange) while motion is enabled. The state machine of
//! [`hal::Arm`] lives on this side, since ROS topics have none: a robot that stops answering, or
//! that is not where it was commanded to be, faults the arm.

pub(crate) mod core;
mod peers;

use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use hal::guarded::LimiterError;
use hal::{Arm, ArmDescription, ArmState, Error, Joints, RateCommand, Stamp};

use crate::convert::ConvertError;
use crate::msg::{industrial_msgs, sensor_msgs, std_msgs};
use crate::seam::{Inlet, Node, NodeClock, NodeError, Outlet, Quality, lock};
use crate::status;
pub(crate) use core::skew;
pub use core::{ArmTiming, ArmTolerances, Refused};
use core::{Core, Reading};
use peers::Peers;

/// Longest time that the arm may take to come to rest when it is dropped.
const FAREWELL: Duration = Duration::from_secs(2);

/// Settings of an arm behind ROS topics.
#[derive(Clone, Debug)]
pub struct RosArmOptions {
    /// What the arm is; feedback is looked up by its joint names.
    pub description: ArmDescription,
    /// Times after which something is stale.
    pub timing: ArmTiming,
    /// Which deviations to accept.
    pub tolerances: ArmTolerances,
    /// Topic of the feedback.
    pub joint_states: String,
    /// Topic of the velocities.
    pub velocities: String,
    /// Topic of the state of the robot's controller (`industrial_msgs/RobotStatus`), for robots
    /// that have one.
    pub robot_status: String,
}

impl RosArmOptions {
    /// The usual topics, times and tolerances.
    pub fn new(description: ArmDescription) -> Self {
        Self {
            description,
            timing: ArmTiming::default(),
            tolerances: ArmTolerances::default(),
            joint_states: "joint_states".to_owned(),
            velocities: "joint_group_velocity_controller/command".to_owned(),
            robot_status: "robot_status".to_owned(),
        }
    }
}

/// An arm that cannot be set up.
#[derive(Debug, thiserror::Error)]
pub enum RosArmError {
    /// A topic cannot be registered.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// The description's limits cannot be used.
    #[error("joint limits")]
    Limits(#[from] LimiterError),
    /// Another number of names than of limits.
    #[error("{names} joint names, {limits} limits")]
    Names {
        /// Number of names.
        names: usize,
        /// Number of limits.
        limits: usize,
    },
    /// Another node commands the same arm.
    #[error(transparent)]
    SecondController(#[from] Refused),
    /// No emulated laboratory answers.
    #[error("no emulated laboratory in lockstep on topic {topic} within {seconds} s")]
    NoLaboratory {
        /// Where it was waited for.
        topic: String,
        /// How long \[s\].
        seconds: u64,
    },
    /// No thread for the arm.
    #[error("no thread for the arm")]
    Thread(#[source] std::io::Error),
}

/// The driver. Dropping it brings the arm to rest.
#[derive(Debug)]
pub struct RosArm {
    description: ArmDescription,
    clock: NodeClock,
    core: Arc<Mutex<Core>>,
    thread: Option<JoinHandle<()>>,
    /// Kept while the arm is.
    peers: Option<Peers>,
}

impl RosArm {
    /// Subscribes, advertises and waits for feedback in the background.
    ///
    /// # Errors
    /// The master does not register the topics, the description does not fit, or another node
    /// publishes velocities for the same arm.
    pub fn new(node: &Node, options: RosArmOptions) -> Result<Self, RosArmError> {
        let mut arm = Self::undriven(node, &options)?;
        // Before this node is a second publisher itself: a run under way would stop for it.
        peers::refuse_others(node, &options.velocities)?;
        let names = options.description.joint_names;
        let velocities = Outlet::new(node, &options.velocities, Quality::Event(1))?;
        let (feedback, clock) = (Arc::clone(&arm.core), node.clock());
        let newest = Quality::Stream(1);
        Inlet::open::<sensor_msgs::JointState>(
            node,
            &options.joint_states,
            newest,
            move |message| {
                // Messages of other devices on the same topic, or nonsense: feedback grows stale.
                if let Ok((positions, rates)) = feedback_of(&message, &names) {
                    let reading = Reading {
                        stamp: clock.run_stamp(message.header.stamp),
                        behind: clock.behind(message.header.stamp),
                        positions,
                        rates,
                    };
                    lock(&feedback).feedback(clock.now(), reading);
                }
            },
        )?;
        let (told, clock) = (Arc::clone(&arm.core), node.clock());
        Inlet::open::<industrial_msgs::RobotStatus>(
            node,
            &options.robot_status,
            newest,
            move |m| {
                lock(&told).robot(clock.now(), status::hindrance(&m));
            },
        )?;
        arm.peers = Some(Peers::watch(node, &options.velocities, &arm.core)?);
        let cut = Arc::downgrade(&arm.core);
        node.on_end(move |end| {
            if let Some(core) = cut.upgrade() {
                lock(&core).cut_off(&end.to_string());
            }
        });
        let (driven, clock) = (Arc::clone(&arm.core), node.clock());
        let period = options.description.period;
        let thread = std::thread::Builder::new()
            .name("ros-arm".to_owned())
            .spawn(move || drive(&driven, || clock.now(), period, &velocities))
            .map_err(RosArmError::Thread)?;
        arm.thread = Some(thread);
        Ok(arm)
    }

    /// An arm without topics, whose core somebody else drives.
    pub(crate) fn undriven(node: &Node, options: &RosArmOptions) -> Result<Self, RosArmError> {
        let description = options.description.clone();
        let (names, limits) = (description.joint_names.len(), description.limits.len());
        if names != limits {
            return Err(RosArmError::Names { names, limits });
        }
        let core = Core::new(&description, options.timing, options.tolerances)?;
        Ok(Self {
            description,
            clock: node.clock(),
            core: Arc::new(Mutex::new(core)),
            thread: None,
            peers: None,
        })
    }

    pub(crate) fn core(&self) -> Arc<Mutex<Core>> {
        Arc::clone(&self.core)
    }

    fn with_core<T>(
        &self,
        order: impl FnOnce(&mut Core, Stamp) -> Result<T, Refused>,
    ) -> Result<T, Error> {
        order(&mut lock(&self.core), self.clock.now())
            .map_err(|refused| Error::with_source(&self.description.name, refused.kind(), refused))
    }
}

impl Arm for RosArm {
    fn description(&self) -> &ArmDescription {
        &self.description
    }

    fn state(&mut self) -> Result<ArmState, Error> {
        self.with_core(|core, now| core.state(now))
    }

    fn enable(&mut self) -> Result<(), Error> {
        self.with_core(Core::enable)
    }

    fn command(&mut self, command: &RateCommand) -> Result<(), Error> {
        self.with_core(|core, now| core.command(now, command))
    }

    fn stop(&mut self) -> Result<(), Error> {
        lock(&self.core).stop();
        Ok(())
    }

    fn reset(&mut self) -> Result<(), Error> {
        self.with_core(Core::reset)
    }

    fn explanation(&self) -> Option<String> {
        lock(&self.core).explanation()
    }
}

impl Drop for RosArm {
    fn drop(&mut self) {
        lock(&self.core).close();
        if let Some(thread) = self.thread.take() {
            // A panic has been reported where it happened.
            let _ = thread.join();
        }
    }
}

/// Sends velocities every period until the arm is closed and at rest.
#[expect(
    clippy::disallowed_methods,
    reason = "the arm's period is wall-clock time"
)]
fn drive(
    core: &Mutex<Core>,
    now: impl Fn() -> Stamp,
    period: Duration,
    velocities: &Outlet<std_msgs::Float64MultiArray>,
) {
    let mut next = Instant::now();
    let mut farewell = None;
    loop {
        let (rates, closed, rest) = {
            let mut core = lock(core);
            let rates = core.tick(now());
            (rates, core.is_closed(), core.is_rest())
        };
        if let Some(rates) = rates {
            velocities.send(std_msgs::Float64MultiArray {
                data: rates.to_vec(),
                ..std_msgs::Float64MultiArray::default()
            });
        }
        if closed {
            let since = *farewell.get_or_insert_with(Instant::now);
            if rest || since.elapsed() > FAREWELL {
                return;
            }
        }
        next += period;
        let left = next.saturating_duration_since(Instant::now());
        if left.is_zero() {
            next = Instant::now();
        }
        std::thread::sleep(left);
    }
}

/// Positions and, where given, rates of the named joints, in their order.
pub(crate) fn feedback_of(
    message: &sensor_msgs::JointState,
    names: &[String],
) -> Result<(Joints, Option<Joints>), ConvertError> {
    let count = message.name.len();
    if message.position.len() != count {
        let found = message.position.len();
        return Err(ConvertError::Length {
            field: "position",
            found,
            expected: count,
        });
    }
    let mut positions = Joints::zeros(names.len())?;
    let mut rates = (message.velocity.len() == count).then_some(positions);
    for (i, joint) in names.iter().enumerate() {
        let at = message
            .name
            .iter()
            .position(|name| name == joint)
            .ok_or_else(|| ConvertError::MissingJoint {
                joint: joint.clone(),
            })?;
        positions[i] = message.position[at];
        if let Some(rates) = &mut rates {
            rates[i] = message.velocity[at];
        }
    }
    if !positions.is_finite() {
        return Err(ConvertError::NonFinite { field: "position" });
    }
    Ok((positions, rates.filter(Joints::is_finite)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn feedback_is_found_by_name_and_refused_when_it_does_not_fit() {
        let names = ["b", "a"].map(str::to_owned);
        let mut message = sensor_msgs::JointState {
            name: ["gripper", "a", "b"].map(str::to_owned).to_vec(),
            position: vec![9.0, 1.0, 2.0],
            velocity: vec![0.9, 0.1, 0.2],
            ..sensor_msgs::JointState::default()
        };
        let (positions, rates) = feedback_of(&message, &names).unwrap();
        assert_eq!(positions.to_vec(), [2.0, 1.0]);
        assert_eq!(rates.unwrap().to_vec(), [0.2, 0.1]);
        message.velocity.clear();
        assert!(feedback_of(&message, &names).unwrap().1.is_none());
        message.position[1] = f64::NAN;
        let error = feedback_of(&message, &names).unwrap_err();
        assert_eq!(error, ConvertError::NonFinite { field: "position" });
        message.position.pop();
        assert!(matches!(
            feedback_of(&message, &names),
            Err(ConvertError::Length { .. })
        ));
        let other = ["c".to_owned()];
        message.position = vec![0.0; 3];
        assert!(matches!(
            feedback_of(&message, &other),
            Err(ConvertError::MissingJoint { .. })
        ));
    }
}
