//! A run on topics, and what is asked of it.

use std::io::Write;
use std::sync::Arc;

use hal::frame::LeftCamera;
use hal::telemetry::{Phase, Telemetry, Tracking};
use hal::{ArmState, Position, StereoFrame};
use nalgebra::Point3;
use rosbridge::bridge::{
    Bridge, BridgeOptions, CameraModel, Command, Frames, Overlay, Rates, Request,
};
use rosbridge::motion::Hand;
use rosbridge::{Node, NodeError};

use vision::StereoRig;
use vision::camera::{Camera, View};
use vision::track::Tracked;

use super::Link;
use crate::config::{Backend, Config};
use crate::controls::{Controls, Wish};
use crate::outcome::Ended;
use crate::rig::Rig;
use crate::run::Observer;
use crate::withdrawal::Verdict;

/// Pieces of a curve that is drawn.
const CURVE_POINTS: u32 = 40;

/// A run's node with its topics and services.
#[derive(Debug)]
pub struct Session {
    node: Node,
    pub(super) bridge: Bridge,
    pub(super) hand: Hand,
    controls: Arc<Controls>,
    /// Whether `~enable` allows motion.
    pub(super) allowed: bool,
    /// The target that was taken before the start.
    pub(super) target: Option<Position<LeftCamera>>,
    shown: Option<Arc<Telemetry>>,
    /// Whether the images are this node's to show.
    shows_images: bool,
    view: Option<View>,
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
                left_from_right: bearings
                    .cameras
                    .as_ref()
                    .map(|pair| pair.right_from_left.inverse()),
            },
            cameras: bearings.cameras.as_ref().map(camera_models),
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
            target: None,
            shown: None,
            shows_images: match config.run.backend {
                Backend::Sim => true,
                Backend::Viper => config.viper.emulate,
                Backend::Ros => false,
            },
            view: bearings.cameras.map(|pair| pair.left_view()),
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

    /// Says something on `/rosout` and on standard error.
    pub(super) fn warn(&self, text: &str) {
        self.node.warn(text);
    }

    /// Shows that the insertion has ended.
    pub fn show_end(&mut self, ended: &Ended) {
        if let Some(last) = &self.shown {
            let mut last = (**last).clone();
            last.phase = match ended {
                Ended::Stopped(_) | Ended::Device(_) | Ended::NotRetracted(_) => Phase::Faulted,
                _ => Phase::Ended,
            };
            self.show(&last);
        }
    }

    /// Shows how a withdrawal ended.
    pub(super) fn show_withdrawn(&mut self, verdict: &Verdict) {
        if let Some(last) = &self.shown {
            let mut last = (**last).clone();
            last.phase = match verdict {
                Verdict::Stopped(_) => Phase::Faulted,
                _ => Phase::Ended,
            };
            self.show(&last);
        }
        // Nothing can be done about a closed stderr.
        let _ = writeln!(std::io::stderr(), "{verdict}");
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
            Command::Start if self.controls.wish() == Wish::Retract => {
                request.refuse("the needle is being withdrawn; ~retract goes on with that");
            }
            Command::Start => {
                self.controls.ask(Wish::Proceed);
                request.accept("going on");
            }
            Command::Stop => {
                self.controls.stop();
                request.accept("stopping; what is under way ends, ~retract withdraws the needle");
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
                    request.accept("enabled; ~start goes on, or ~retract with a withdrawal");
                } else {
                    self.controls.ask(Wish::Pause);
                    request.accept("holding still, not enabled");
                }
            }
            Command::Target(_) if self.controls.wish() == Wish::Retract => {
                request.refuse("the needle is being withdrawn");
            }
            Command::Target(target) => self.controls.aim_then(target, move |answer| match answer {
                Ok(aimed) => request.accept(aimed.to_string()),
                Err(refused) => request.refuse(refused.to_string()),
            }),
            Command::Home => request.refuse("an insertion is under way"),
            Command::ClearFault => request.refuse("no fault: an insertion is under way"),
        }
    }
}

impl Session {
    /// Shows a pair, and the left image with the tracked curve and the target drawn in.
    fn show_pair(&self, pair: &StereoFrame, tracked: &Tracked) {
        if self.shows_images {
            self.bridge.show_images(pair.clone());
        }
        let curve = tracked.curves[0].filter(|_| tracked.status != Tracking::Lost);
        let target = self.shown.as_ref().map(|last| last.target.coords());
        self.bridge.show_overlay(Overlay {
            image: pair.left.clone(),
            curve_px: curve.map_or_else(Vec::new, |curve| {
                (0..=CURVE_POINTS)
                    .map(|i| curve.at(f64::from(i) / f64::from(CURVE_POINTS)).into())
                    .collect()
            }),
            target_px: target
                .filter(|target| target.iter().all(|x| x.is_finite()))
                .and_then(|target| self.view.as_ref()?.project(&target))
                .map(|px| [px.0.x, px.0.y]),
        });
    }
}

impl Observer for Session {
    fn images(&mut self, pair: &StereoFrame, tracked: &Tracked) {
        self.show_pair(pair, tracked);
    }

    fn step(&mut self, telemetry: &Telemetry) {
        self.show(telemetry);
    }

    fn arm(&mut self, state: &ArmState) {
        self.show_arm(state);
        self.answer();
    }
}

/// What ROS is told of a calibrated pair.
pub(super) fn camera_models(pair: &StereoRig) -> [CameraModel; 2] {
    let model = |camera: &Camera, shift: f64| {
        let (distortion_model, distortion) = camera.distortion.ros();
        CameraModel {
            width: u32::try_from(camera.width).unwrap_or(u32::MAX),
            height: u32::try_from(camera.height).unwrap_or(u32::MAX),
            intrinsics: [camera.fx, camera.fy, camera.cx, camera.cy],
            distortion_model,
            distortion,
            shift,
        }
    };
    // The cameras look at the gel from two sides: unrectified, they have no common baseline row.
    [model(&pair.left, 0.0), model(&pair.right, 0.0)]
}
