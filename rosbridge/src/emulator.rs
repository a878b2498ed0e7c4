//! An arm, simulated or not, as a ROS node: what [`RosArm`](crate::arm::RosArm) and
//! [`RosCameras`](crate::cameras::RosCameras) find on the other side.
//!
//! Like an arm under `ros_control`, it has no enabling of its own: velocities move it, and it
//! stops when they stop. `~stop`, `~clear_fault` and `~enable` are offered beside, and the
//! topics of [`motion`](crate::motion). A [`LabNode`] is the arm with the rest of a laboratory.

mod lab;

use std::collections::VecDeque;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use hal::request::{Command, Request};
use hal::{Arm, ArmMode, ArmState, Error, ErrorKind, Joints, RateCommand, Stamp, StereoFrame};

use crate::bridge::{CameraModel, CameraOutlet, Received, Requests};
pub use lab::{LabNode, Seen};

use crate::motion::{Hand, ToRates};
use crate::msg::{industrial_msgs, sensor_msgs, std_msgs};
use crate::seam::{Inlet, Node, NodeClock, NodeError, Outlet, Quality, lock};
use crate::{convert, display, status};

/// Age at which velocities are dropped and the arm is stopped.
const AGE_LIMIT: Duration = Duration::from_millis(100);

/// Velocities that came over ROS, and when.
type Newest = Arc<Mutex<Option<(Stamp, Joints)>>>;

/// What keeps an arm's reports (`joint_states`, `robot_status`) from arriving on the wall clock. Clones are
/// the same; it may be changed at any time.
#[derive(Clone, Debug, Default)]
pub struct Reports(Arc<Mutex<Delivery>>);

#[derive(Clone, Copy, Debug, Default)]
struct Delivery {
    silent: bool,
    late: Duration,
}

impl Reports {
    /// Whether none arrive.
    pub fn silence(&self, silent: bool) {
        lock(&self.0).silent = silent;
    }

    /// They arrive later by `late`, stamped with when they were true.
    pub fn delay(&self, late: Duration) {
        lock(&self.0).late = late;
    }
}

/// A report under way, and when it was made.
type Report = (Stamp, sensor_msgs::JointState, industrial_msgs::RobotStatus);

/// The topics of an arm and, where there are some, of its cameras.
pub struct ArmNode {
    clock: NodeClock,
    joint_names: Vec<String>,
    joint_states: Outlet<sensor_msgs::JointState>,
    robot_status: Outlet<industrial_msgs::RobotStatus>,
    reports: Reports,
    under_way: VecDeque<Report>,
    cameras: Option<[CameraOutlet; 2]>,
    newest: Newest,
    hand: Hand,
    to_rates: Box<ToRates>,
    requests: Receiver<Received>,
    sequence: u64,
    allowed: bool,
    /// When velocities last came, while they do.
    streaming: Option<Stamp>,
    /// Whether the last velocities are held for ever.
    holds: bool,
    held: Option<Joints>,
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
        Inlet::open::<std_msgs::Float64MultiArray>(
            node,
            topic,
            Quality::Stream(1),
            move |message| {
                // Anything else than a finite rate for every joint counts as silence.
                if let Ok(rates) = Joints::from_slice(&message.data)
                    && rates.len() == joints
                    && rates.is_finite()
                {
                    *lock(&arriving) = Some((clock.now(), rates));
                }
            },
        )?;
        let cameras = match cameras {
            Some([left, right]) => Some([
                CameraOutlet::left(node, left)?,
                CameraOutlet::right(node, right)?,
            ]),
            None => None,
        };
        Ok(Self {
            clock: node.clock(),
            joint_states: Outlet::new(node, "joint_states", Quality::Event(10))?,
            robot_status: Outlet::new(node, "robot_status", Quality::Event(10))?,
            reports: Reports::default(),
            under_way: VecDeque::new(),
            hand: Hand::new(node, &joint_names)?,
            to_rates: Box::new(|q, _, _| q.zeroed()),
            joint_names,
            cameras,
            newest,
            requests: requests.receiver(),
            sequence: 0,
            allowed: true,
            streaming: None,
            holds: false,
            held: None,
        })
    }

    /// Holds the last velocities for ever, as `ros_control`'s velocity controllers do.
    #[must_use]
    pub const fn without_watchdog(mut self) -> Self {
        self.holds = true;
        self
    }

    /// What may keep the reports from arriving.
    pub fn reports(&self) -> Reports {
        self.reports.clone()
    }

    /// Lets twists on `twist_cmd` move the arm; without kinematics they do not.
    #[must_use]
    pub fn with_kinematics(mut self, to_rates: Box<ToRates>) -> Self {
        self.to_rates = to_rates;
        self
    }

    /// One period: hands new velocities to `arm`, stops it when they have stopped, publishes its
    /// state. `now` is the arm's clock.
    ///
    /// # Errors
    /// The arm has no state, or refuses what it should take.
    pub fn step(&mut self, arm: &mut dyn Arm, now: Stamp) -> Result<(), Error> {
        self.answer(arm);
        self.command(arm, now)?;
        let state = arm.state()?;
        let made = self.clock.now();
        let report = (made, self.feedback(&state), self.status(&state));
        self.under_way.push_back(report);
        self.deliver();
        Ok(())
    }

    /// Sends the reports that are due.
    fn deliver(&mut self) {
        let Delivery { silent, late } = *lock(&self.reports.0);
        let now = self.clock.now();
        let is_due = |(made, ..): &Report| now.since(*made) >= late;
        while self.under_way.front().is_some_and(is_due) {
            if let (Some((_, joints, status)), false) = (self.under_way.pop_front(), silent) {
                self.joint_states.send(joints);
                self.robot_status.send(status);
            }
        }
    }

    /// Answers services.
    pub fn answer(&mut self, arm: &mut dyn Arm) {
        while let Some(request) = self.requests.try_iter().find_map(Received::fresh) {
            self.obey(arm, request);
        }
    }

    /// Velocities for the next [`command`](Self::command), as if they had come over the topic.
    pub(crate) fn put(&self, rates: Joints) {
        *lock(&self.newest) = Some((self.clock.now(), rates));
    }

    /// Hands new velocities to `arm`, or stops it when they have stopped.
    pub(crate) fn command(&mut self, arm: &mut dyn Arm, now: Stamp) -> Result<(), Error> {
        let state = arm.state()?;
        let present = self.clock.now();
        let velocities = lock(&self.newest).take();
        let velocities = velocities
            .filter(|(arrived, _)| present.since(*arrived) <= AGE_LIMIT)
            .map(|(_, rates)| rates);
        if self.holds && velocities.is_some() {
            self.held = velocities.filter(|rates| rates.max_abs() > 0.0);
        }
        let velocities = velocities.or(self.held);
        let by_hand = self.hand.rates(present, &state, &*self.to_rates);
        let rates = match velocities {
            Some(rates) => {
                // Who streams velocities has the arm.
                self.hand.drop_all();
                Some(rates)
            }
            None => by_hand,
        };
        if let Some(rates) = rates {
            self.streaming = Some(present);
            self.drive(arm, state.mode, now, rates)
        } else if self
            .streaming
            .is_some_and(|last| present.since(last) > AGE_LIMIT)
        {
            self.streaming = None;
            arm.stop()
        } else {
            Ok(())
        }
    }

    pub(crate) fn feedback(&self, state: &ArmState) -> sensor_msgs::JointState {
        let header = convert::header(self.clock.ros_stamp(state.stamp), "", 0);
        let values = [&state.positions, &state.rates];
        display::joint_state(header, &self.joint_names, values)
    }

    pub(crate) fn status(&self, state: &ArmState) -> industrial_msgs::RobotStatus {
        let header = convert::header(self.clock.ros_stamp(self.clock.now()), "", 0);
        status::of_arm(header, state.mode)
    }

    /// Publishes a pair of images.
    pub fn show_images(&self, frame: &StereoFrame) {
        if let Some([left, right]) = &self.cameras {
            left.send(&self.clock, &frame.left);
            right.send(&self.clock, &frame.right);
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
            Command::Stop => {
                self.held = None;
                arm.stop()
            }
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
