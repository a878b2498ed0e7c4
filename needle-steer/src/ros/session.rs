//! A run on topics, and what is asked of it.

use std::io::Write;
use std::sync::Arc;

use hal::frame::LeftCamera;
use hal::telemetry::{Phase, Telemetry};
use hal::{ArmState, Position};
use nalgebra::Point3;
use rosbridge::bridge::{Bridge, BridgeOptions, Command, Frames, Rates, Request};
use rosbridge::motion::Hand;
use rosbridge::{Node, NodeError};

use super::Link;
use crate::config::{Backend, Config};
use crate::controls::{Controls, Wish};
use crate::outcome::Ended;
use crate::rig::Rig;
use crate::run::Observer;

/// A run's node with its topics and services.
#[derive(Debug)]
pub struct Session {
    node: Node,
    pub(super) bridge: Bridge,
    pub(super) hand: Hand,
    controls: Arc<Controls>,
    /// Whether `~enable` allows motion.
    pub(super) allowed: bool,
    shown: Option<Arc<Telemetry>>,
}

impl Session {
    /// Advertises everything.
    ///
    /// # Errors
    /// The master does not register it.
    pub fn new(
        config: &Config,
        link: &Link,
        rig: &Rig,
        controls: &Arc<Controls>,
    ) -> Result<Self, NodeError> {
        let bearings = &rig.bearings;
        let names = bearings.chain.names().to_vec();
        let options = BridgeOptions {
            joint_names: names.clone(),
            joint_states: config.run.backend != Backend::Ros,
            frames: Frames {
                world_from_arm_base: bearings.world_from_arm_base,
                // The robot's description has it.
                flange_from_needle_base: None,
                world_from_left_camera: bearings.world_from_left_camera,
                left_from_right: None,
            },
            cameras: None,
            rates: Rates {
                joint_states_hz: config.ros.joint_states_hz,
                poses_hz: config.ros.poses_hz,
                markers_hz: config.ros.markers_hz,
            },
        };
        Ok(Self {
            bridge: Bridge::new(&link.node, options)?,
            hand: Hand::new(&link.node, &names)?,
            node: link.node.clone(),
            controls: Arc::clone(controls),
            allowed: true,
            shown: None,
        })
    }

    /// Shows a snapshot. Before a target is set, none is shown.
    pub(super) fn show(&mut self, telemetry: &Telemetry) {
        let mut telemetry = telemetry.clone();
        if !telemetry.axial_distance.is_finite() {
            telemetry.target = Position::<LeftCamera>::new(Point3::from([f64::NAN; 3]));
        }
        let telemetry = Arc::new(telemetry);
        self.shown = Some(Arc::clone(&telemetry));
        self.bridge.show(telemetry);
    }

    /// Shows the arm, and its time where that is the time of the node.
    pub(super) fn show_arm(&self, state: &ArmState) {
        self.node.set_time(state.stamp);
        self.bridge.show_arm(*state);
    }

    /// Shows that the insertion has ended.
    pub fn show_end(&mut self, ended: &Ended) {
        if let Some(last) = &self.shown {
            let mut last = (**last).clone();
            last.phase = match ended {
                Ended::Stopped(_) => Phase::Faulted,
                _ => Phase::Ended,
            };
            self.show(&last);
        }
    }

    /// Shows that the arm failed.
    pub(super) fn note(&mut self, error: &hal::Error) {
        if let Some(last) = &self.shown {
            let mut last = (**last).clone();
            last.phase = Phase::Faulted;
            self.show(&last);
        }
        // Nothing can be done about a closed stderr.
        let _ = writeln!(std::io::stderr(), "{error}");
    }

    /// Answers what is asked of a running insertion.
    fn answer(&mut self) {
        while let Some(request) = self.bridge.poll() {
            self.obey(request);
        }
    }

    fn obey(&mut self, request: Request) {
        let moves = matches!(request.command, Command::Start | Command::Retract);
        if moves && !self.allowed {
            return request.refuse("motion is not enabled");
        }
        match request.command {
            Command::Start => {
                self.controls.ask(Wish::Proceed);
                request.accept("going on");
            }
            Command::Stop => {
                self.controls.stop();
                request.accept("stopping; the insertion ends");
            }
            Command::Pause => {
                self.controls.ask(Wish::Pause);
                request.accept("holding still");
            }
            Command::Retract => {
                self.controls.ask(Wish::Retract);
                request.accept("withdrawing the needle");
            }
            Command::Enable(allowed) => {
                self.allowed = allowed;
                if allowed {
                    request.accept("enabled; ~start goes on");
                } else {
                    self.controls.ask(Wish::Pause);
                    request.accept("holding still, not enabled");
                }
            }
            Command::Target(target) => {
                self.controls.aim(target);
                request.accept("aiming there");
            }
            Command::Home => request.refuse("an insertion is under way"),
            Command::ClearFault => request.refuse("no fault: an insertion is under way"),
        }
    }
}

impl Observer for Session {
    fn step(&mut self, telemetry: &Telemetry) {
        self.show(telemetry);
    }

    fn arm(&mut self, state: &ArmState) {
        self.show_arm(state);
        self.answer();
    }
}
