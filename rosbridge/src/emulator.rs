//! An arm, simulated or not, as a ROS node: what [`RosArm`](crate::arm::RosArm) and
//! [`RosCameras`](crate::cameras::RosCameras) find on the other side.
//!
//! Like an arm under `ros_control`, it has no enabling of its own: velocities move it, and it
//! stops when they stop. `~stop`, `~clear_fault` and `~enable` are offered beside.

use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use hal::{Arm, ArmMode, Error, ErrorKind, Joints, RateCommand, Stamp, StereoFrame};

use crate::bridge::{CameraModel, CameraOutlet, Command, Received, Request, Requests};
use crate::msg::{sensor_msgs, std_msgs};
use crate::seam::{Inlet, Node, NodeClock, NodeError, Outlet, lock};
use crate::{convert, display};

/// Age at which velocities are dropped and the arm is stopped.
const AGE_LIMIT: Duration = Duration::from_millis(100);

/// Velocities that came over ROS, and when.
type Newest = Arc<Mutex<Option<(Stamp, Joints)>>>;

/// The topics of an arm and, where there are some, of its cameras.
pub struct ArmNode {
    clock: NodeClock,
    joint_names: Vec<String>,
    joint_states: Outlet<sensor_msgs::JointState>,
    cameras: Option<[CameraOutlet; 2]>,
    newest: Newest,
    requests: Receiver<Received>,
    sequence: u64,
    allowed: bool,
    /// When velocities last came, while they do.
    streaming: Option<Stamp>,
}

impl ArmNode {
    /// Advertises the arm's topics; `cameras` with or without known models.
    ///
    /// # Errors
    /// The master does not register them.
    pub fn new(
        node: &Node,
        joint_names: Vec<String>,
        cameras: Option<[Option<CameraModel>; 2]>,
    ) -> Result<Self, NodeError> {
        let requests = Requests::new(node);
        requests.trigger("~stop", Command::Stop)?;
        requests.trigger("~clear_fault", Command::ClearFault)?;
        requests.enable("~enable")?;
        let newest = Newest::default();
        let (arriving, clock, joints) = (Arc::clone(&newest), node.clock(), joint_names.len());
        let topic = "joint_group_velocity_controller/command";
        Inlet::open::<std_msgs::Float64MultiArray>(node, topic, 1, move |message| {
            // Anything else than a finite rate for every joint counts as silence.
            if let Ok(rates) = Joints::from_slice(&message.data)
                && rates.len() == joints
                && rates.is_finite()
            {
                *lock(&arriving) = Some((clock.now(), rates));
            }
        })?;
        let cameras = match cameras {
            Some([left, right]) => Some([
                CameraOutlet::left(node, left)?,
                CameraOutlet::right(node, right)?,
            ]),
            None => None,
        };
        Ok(Self {
            clock: node.clock(),
            joint_states: Outlet::new(node, "joint_states", 10, false)?,
            joint_names,
            cameras,
            newest,
            requests: requests.receiver(),
            sequence: 0,
            allowed: true,
            streaming: None,
        })
    }

    /// One period: hands new velocities to `arm`, stops it when they have stopped, publishes its
    /// state. `now` is the arm's clock.
    ///
    /// # Errors
    /// The arm has no state, or refuses what it should take.
    pub fn step(&mut self, arm: &mut dyn Arm, now: Stamp) -> Result<(), Error> {
        while let Some(request) = self.requests.try_iter().find_map(Received::fresh) {
            self.obey(arm, request);
        }
        let state = arm.state()?;
        let velocities = lock(&self.newest).take();
        if let Some((arrived, rates)) = velocities
            && self.clock.now().since(arrived) <= AGE_LIMIT
        {
            self.streaming = Some(arrived);
            self.drive(arm, state.mode, now, rates)?;
        } else if self
            .streaming
            .is_some_and(|last| self.clock.now().since(last) > AGE_LIMIT)
        {
            self.streaming = None;
            arm.stop()?;
        }
        let header = convert::header(self.clock.ros_stamp(state.stamp), "", 0);
        let values = [&state.positions, &state.rates];
        self.joint_states
            .send(display::joint_state(header, &self.joint_names, values));
        Ok(())
    }

    /// Publishes a pair of images.
    pub fn show_images(&self, frame: &StereoFrame) {
        if let Some([left, right]) = &self.cameras {
            left.send(self.clock, &frame.left);
            right.send(self.clock, &frame.right);
        }
    }

    fn drive(
        &mut self,
        arm: &mut dyn Arm,
        mode: ArmMode,
        now: Stamp,
        rates: Joints,
    ) -> Result<(), Error> {
        match mode {
            ArmMode::Connected if self.allowed => arm.enable()?,
            ArmMode::Enabled | ArmMode::Moving => {}
            _ => return Ok(()),
        }
        self.sequence += 1;
        match arm.command(&RateCommand {
            sequence: self.sequence,
            stamp: now,
            rates,
        }) {
            // The mode changed in between; the next period sees it.
            Err(error) if matches!(error.kind(), ErrorKind::WrongMode | ErrorKind::Faulted) => {
                Ok(())
            }
            result => result,
        }
    }

    fn obey(&mut self, arm: &mut dyn Arm, request: Request) {
        let done = match request.command {
            Command::Stop => arm.stop(),
            Command::ClearFault => arm.reset(),
            Command::Enable(allowed) => {
                self.allowed = allowed;
                if allowed { Ok(()) } else { arm.stop() }
            }
            _ => return request.refuse("not offered by an arm"),
        };
        match done {
            Ok(()) => request.accept("done"),
            Err(error) => request.refuse(error.to_string()),
        }
    }
}

impl std::fmt::Debug for ArmNode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ArmNode")
            .field("joint_names", &self.joint_names)
            .finish_non_exhaustive()
    }
}
