//! The bridge's thread: what is published when.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use hal::frame::{ArmBase, Frame, LeftCamera, NeedleBase, World};
use hal::{ArmMode, ArmState, Joints, Overlay, Stamp, Telemetry};
use nalgebra::Isometry3;

use super::cameras::CameraOutlet;
use super::{BridgeOptions, Frames, Item, Rates, diagnostics};
use crate::convert;
use crate::display;
use crate::msg::{
    diagnostic_msgs, geometry_msgs, needle_steer_msgs, rosgraph_msgs, sensor_msgs, tf2_msgs,
    visualization_msgs,
};
use crate::seam::{Node, NodeError, Outlet, Quality, TimeBase};

/// Time after its arrival for which a reading of the arm counts.
const FRESH: Duration = Duration::from_millis(200);
/// Shortest period of the thread.
const SHORTEST: f64 = 1e-3;

/// The topics and the newest state.
pub(super) struct Publisher {
    node: Node,
    joint_names: Vec<String>,
    clock: Option<Outlet<rosgraph_msgs::Clock>>,
    joint_states: Option<Outlet<sensor_msgs::JointState>>,
    tf: Outlet<tf2_msgs::TFMessage>,
    tf_static: Outlet<tf2_msgs::TFMessage>,
    still: tf2_msgs::TFMessage,
    tip: Outlet<geometry_msgs::PoseStamped>,
    state: Outlet<needle_steer_msgs::State>,
    markers: Outlet<visualization_msgs::MarkerArray>,
    cameras: [CameraOutlet; 2],
    overlay: Outlet<sensor_msgs::Image>,
    diagnostics: Outlet<diagnostic_msgs::DiagnosticArray>,
    latest: Option<Arc<Telemetry>>,
    joints: Option<Sample>,
    /// Whether the arm's own readings come; until then those of the snapshots count.
    reports: bool,
    next_markers: Stamp,
    tick: Duration,
    /// Ticks from one message to the next.
    every: Every,
    ticks: u64,
}

/// What happens every so many ticks; a tick is a period of `joint_states`.
#[derive(Clone, Copy)]
struct Every {
    poses: u64,
    markers: u64,
    diagnostics: u64,
}

impl Every {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "at least one, and a float-to-integer cast saturates"
    )]
    fn new(rates: &Rates) -> Self {
        let every = |rate: f64| (rates.joint_states_hz / rate).round().max(1.0) as u64;
        Self {
            poses: every(rates.poses_hz),
            markers: every(rates.markers_hz),
            diagnostics: every(1.0),
        }
    }
}

/// A reading of the arm, when it was true, and when it came.
#[derive(Clone, Copy)]
struct Sample {
    stamp: Stamp,
    positions: Joints,
    rates: Joints,
    mode: ArmMode,
    arrived: Instant,
}

impl Sample {
    /// Whether the arm still reports: old readings say nothing of where it is now.
    fn is_fresh(&self) -> bool {
        self.arrived.elapsed() <= FRESH
    }
}

impl Publisher {
    pub(super) fn new(node: &Node, options: BridgeOptions) -> Result<Self, NodeError> {
        let time = node.time_base();
        let tick = (1.0 / options.rates.joint_states_hz).max(SHORTEST);
        let [left, right] = match options.cameras {
            Some(models) => models.map(Some),
            None => [None, None],
        };
        let clock = if time == TimeBase::Simulated {
            Some(Outlet::new(node, "/clock", Quality::Event(10))?)
        } else {
            None
        };
        let joint_states = if options.joint_states {
            Some(Outlet::new(node, "joint_states", Quality::Event(10))?)
        } else {
            None
        };
        let tf_static = Outlet::new(node, "/tf_static", Quality::Latched(1))?;
        let still = still(&options.frames, node.clock().ros_stamp(Stamp::ZERO));
        tf_static.send(still.clone());
        Ok(Self {
            joint_names: options.joint_names,
            clock,
            joint_states,
            tf: Outlet::new(node, "/tf", Quality::Event(50))?,
            tf_static,
            still,
            tip: Outlet::new(node, "needle/tip", Quality::Event(10))?,
            state: Outlet::new(node, "needle/state", Quality::Event(10))?,
            markers: Outlet::new(node, "needle/markers", Quality::Event(2))?,
            cameras: [
                CameraOutlet::left(node, left)?,
                CameraOutlet::right(node, right)?,
            ],
            overlay: Outlet::new(node, "overlay", Quality::Stream(2))?,
            diagnostics: Outlet::new(node, "/diagnostics", Quality::Event(2))?,
            latest: None,
            joints: None,
            reports: false,
            next_markers: Stamp::ZERO,
            tick: Duration::try_from_secs_f64(tick).unwrap_or(Duration::from_millis(10)),
            every: Every::new(&options.rates),
            ticks: 0,
            node: node.clone(),
        })
    }

    /// Publishes until the run's side is dropped.
    #[expect(clippy::disallowed_methods, reason = "the rates are wall-clock rates")]
    pub(super) fn run(mut self, items: &Receiver<Item>, dropped: &AtomicU64) {
        let period = self.tick;
        let mut next = Instant::now() + period;
        loop {
            match items.recv_timeout(next.saturating_duration_since(Instant::now())) {
                Ok(item) => self.take(item),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            let now = Instant::now();
            if now >= next {
                self.tick(dropped.load(Ordering::Relaxed));
                next += period;
                if now > next + 10 * period {
                    // The machine slept: go on from here instead of catching up.
                    next = now + period;
                }
            }
        }
    }

    fn take(&mut self, item: Item) {
        match item {
            Item::Step(telemetry) => {
                if !self.reports {
                    self.note(&ArmState {
                        stamp: telemetry.stamp,
                        positions: telemetry.joints,
                        rates: telemetry.joint_rates,
                        mode: telemetry.arm_mode,
                    });
                }
                if self.is_simulated() {
                    self.step_of_simulation(&telemetry);
                }
                self.latest = Some(telemetry);
            }
            Item::Arm(state) => {
                self.reports = true;
                self.note(&state);
            }
            Item::Stereo(frame) => {
                let [left, right] = &self.cameras;
                left.send(&self.node.clock(), &frame.left);
                right.send(&self.node.clock(), &frame.right);
            }
            Item::Overlay(overlay) => {
                if self.overlay.subscribers() > 0 {
                    self.overlay.send(overlay_message(
                        &overlay,
                        self.node.clock().ros_stamp(overlay.image.stamp),
                    ));
                }
            }
        }
    }

    /// Takes in a reading of the arm. One that is repeated is not fresh.
    #[expect(
        clippy::disallowed_methods,
        reason = "whether the arm still reports is wall-clock time, whatever the run's clock"
    )]
    fn note(&mut self, state: &ArmState) {
        if self.joints.is_none_or(|last| last.stamp < state.stamp) {
            self.joints = Some(Sample {
                stamp: state.stamp,
                positions: state.positions,
                rates: state.rates,
                mode: state.mode,
                arrived: Instant::now(),
            });
        } else if let Some(last) = &mut self.joints {
            last.mode = state.mode;
        }
    }

    fn is_simulated(&self) -> bool {
        matches!(
            self.node.time_base(),
            TimeBase::Simulated | TimeBase::Remote
        )
    }

    /// On a simulated clock everything is published once, stamped with the run's own time.
    fn step_of_simulation(&mut self, telemetry: &Telemetry) {
        let stamp = self.node.clock().ros_stamp(telemetry.stamp);
        if let Some(clock) = &self.clock {
            clock.send(rosgraph_msgs::Clock {
                clock: convert::time(stamp),
            });
        }
        self.send_joints();
        self.send_poses(telemetry, stamp);
        if telemetry.stamp >= self.next_markers {
            self.next_markers = telemetry.stamp + Duration::from_millis(50);
            self.markers.send(display::markers(&at(telemetry, stamp)));
        }
    }

    /// Publishes what is due, as long as the arm reports: the newest reading with its own stamp,
    /// what follows from it with the present one.
    fn tick(&mut self, dropped: u64) {
        self.ticks += 1;
        let due = |every: u64| self.ticks.is_multiple_of(every);
        let stamp = self.node.clock().ros_stamp(self.node.clock().now());
        if due(self.every.diagnostics) {
            let arm = self.joints.map(|joints| diagnostics::Reading {
                mode: joints.mode,
                age: joints.arrived.elapsed(),
                is_fresh: joints.is_fresh(),
            });
            let message = diagnostics::message(
                self.latest.as_deref(),
                arm,
                &self.node.doubts(),
                stamp,
                self.node.name(),
                dropped,
            );
            self.diagnostics.send(message);
            // rosrust does not tell recorders that a topic is latched: a bag that is played would
            // have it once, before most subscribers come. ROS 2 does.
            if !self.tf_static.keeps() {
                self.tf_static.send(self.still.clone());
            }
        }
        if self.is_simulated() || !self.joints.is_some_and(|joints| joints.is_fresh()) {
            return;
        }
        self.send_joints();
        if let Some(telemetry) = &self.latest {
            if due(self.every.poses) {
                self.send_poses(telemetry, stamp);
            }
            if due(self.every.markers) {
                self.markers.send(display::markers(&at(telemetry, stamp)));
            }
        }
    }

    fn send_joints(&self) {
        if let (Some(outlet), Some(joints)) = (&self.joint_states, &self.joints) {
            let stamp = self.node.clock().ros_stamp(joints.stamp);
            let header = convert::header(stamp, "", 0);
            let values = [&joints.positions, &joints.rates];
            outlet.send(display::joint_state(header, &self.joint_names, values));
        }
    }

    fn send_poses(&self, telemetry: &Telemetry, stamp: Stamp) {
        let shown = at(telemetry, stamp);
        self.tf.send(display::tree(vec![display::tip_edge(&shown)]));
        self.tip.send(display::tip(&shown));
        self.state.send(display::state(&shown));
    }
}

/// The snapshot with another stamp.
fn at(telemetry: &Telemetry, stamp: Stamp) -> Telemetry {
    Telemetry {
        stamp,
        ..telemetry.clone()
    }
}

pub(crate) fn overlay_message(overlay: &Overlay, stamp: Stamp) -> sensor_msgs::Image {
    let image = &overlay.image.image;
    let [width, height] =
        [image.width(), image.height()].map(|n| u32::try_from(n).unwrap_or(u32::MAX));
    sensor_msgs::Image {
        header: convert::header(stamp, LeftCamera::NAME, overlay.image.sequence),
        height,
        width,
        encoding: "rgb8".to_owned(),
        is_bigendian: 0,
        step: width.saturating_mul(3),
        data: overlay.draw(),
    }
}

pub(crate) fn still(frames: &Frames, stamp: Stamp) -> tf2_msgs::TFMessage {
    let mut edges = vec![
        display::edge::<World, _>(&frames.world_from_arm_base, stamp),
        display::edge(&frames.world_from_left_camera, stamp),
    ];
    let described = &frames.described;
    edges.extend(described.base.iter().map(|root| {
        let same = Isometry3::identity();
        display::link(ArmBase::NAME, root, &same, stamp)
    }));
    edges.extend(
        described
            .holder
            .iter()
            .map(|(link, needle)| display::link(link, NeedleBase::NAME, needle, stamp)),
    );
    edges.extend(
        frames
            .left_from_right
            .iter()
            .map(|right| display::edge(right, stamp)),
    );
    display::tree(edges)
}
