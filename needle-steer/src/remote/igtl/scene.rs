//! A scene as messages.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use hal::frame::{LeftCamera, RightCamera, World};
use hal::telemetry::{Phase, Telemetry};
use hal::{ArmMode, Overlay, Stamp, StereoFrame, Transform};
use igtl::{
    Body, Ends, Extension, Image, Message, PolyData, Scalar, Status, StatusCode, Text, Timestamp,
    Trajectory,
};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde_json::json;
use vision::camera::Camera;

use super::super::{Due, Scene, Show};
use super::clients::Audience;
use super::counters::Counters;
use super::space::{Space, pose_of};
use super::tracker::Tracker;

/// Distance from the left camera at which its image is placed in space \[m\].
const IMAGE_DISTANCE: f64 = 0.1;
/// Longest text of a `STRING` \[bytes\].
const TEXT: usize = u16::MAX as usize;
/// Colour of the straight way from the tip to the target.
const PLAN: igtl::Colour = [255, 13, 13, 255];

/// Names of devices; at most 20 bytes.
mod device {
    pub(super) const TIP: &str = "NeedleTip";
    /// Another name than the transform's: some programs keep one message a name.
    pub(super) const POSITION: &str = "TipPosition";
    pub(super) const BASE: &str = "NeedleBase";
    pub(super) const TARGET: &str = "Target";
    /// In simulation.
    pub(super) const TRUTH: &str = "TrueTip";
    pub(super) const LEFT: &str = "LeftCamera";
    pub(super) const RIGHT: &str = "RightCamera";
    pub(super) const NEEDLE: &str = "Needle";
    pub(super) const CUT: &str = "CutPath";
    pub(super) const PREDICTED: &str = "PredictedPath";
    pub(super) const PLAN: &str = "Plan";
    pub(super) const IMAGE: &str = "LeftImage";
    pub(super) const STATUS: &str = "NeedleSteer";
    pub(super) const STATE: &str = "State";
    pub(super) const WARNING: &str = "Warning";
    pub(super) const ANSWER: &str = "Answer";
}

/// Cameras, as registered and calibrated.
#[derive(Clone, Debug)]
pub(super) struct Optics {
    pub(super) world_from_left: Transform<World, LeftCamera>,
    pub(super) left_from_right: Option<Transform<LeftCamera, RightCamera>>,
    pub(super) left: Option<Camera>,
}

/// Puts messages together.
#[derive(Debug)]
pub(super) struct Writer {
    /// Whether messages have an extended header, and their number.
    pub(super) number: Option<u32>,
    /// Wall-clock time since the epoch at the run's time zero.
    pub(super) origin: Duration,
    bytes: Vec<u8>,
}

impl Writer {
    pub(super) const fn new(extended: bool, origin: Duration) -> Self {
        Self {
            number: if extended { Some(0) } else { None },
            origin,
            bytes: Vec::new(),
        }
    }

    /// Adds a message; what has no bytes is left out.
    fn put(&mut self, device: &str, stamp: Stamp, body: Body) {
        let since_epoch = self.origin + Duration::from_nanos(stamp.as_nanos());
        let nanos = u64::try_from(since_epoch.as_nanos()).unwrap_or(0);
        let extension = self.number.as_mut().map(|number| {
            *number = number.wrapping_add(1);
            Extension {
                id: *number,
                metadata: Vec::new(),
            }
        });
        let message = Message {
            stamp: Timestamp::from_nanos(nanos),
            extension,
            ..Message::new(device, body)
        };
        if let Ok(mut bytes) = message.encode() {
            self.bytes.append(&mut bytes);
        }
    }

    /// All that was put since the last time.
    fn take(&mut self) -> Arc<[u8]> {
        std::mem::take(&mut self.bytes).into()
    }

    /// One answer to a request, as a `STRING` of JSON.
    pub(super) fn answer(&mut self, request: &str, accepted: bool, text: &str) -> Arc<[u8]> {
        let answer = json!({ "request": request, "accepted": accepted, "text": text });
        self.put(device::ANSWER, Stamp::ZERO, text_of(&answer.to_string()));
        self.take()
    }
}

fn text_of(text: &str) -> Body {
    let mut end = text.len().min(TEXT);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    Body::Text(Text::new(&text[..end]))
}

/// Sends scenes to all connections.
#[derive(Debug)]
pub(super) struct Sender {
    pub(super) audience: Audience,
    pub(super) counters: Arc<Counters>,
    pub(super) space: Space,
    pub(super) optics: Optics,
    pub(super) tracker: Option<Tracker>,
    pub(super) writer: Writer,
}

impl Show for Sender {
    fn show(&mut self, scene: &Scene, due: Due) {
        if self.audience.len() == 0 {
            return;
        }
        if let Some(telemetry) = &scene.telemetry {
            if due.poses {
                self.poses(telemetry);
            }
            if due.lines {
                self.lines(telemetry);
                self.state(telemetry, scene.dropped);
            }
            if due.slow {
                self.slow(telemetry);
            }
        }
        for warning in &scene.warnings {
            self.writer
                .put(device::WARNING, Stamp::ZERO, text_of(warning));
        }
        self.flush();
        if let (true, Some((pair, overlay))) = (due.images, &scene.images) {
            self.image(pair, overlay);
            self.flush();
        }
    }
}

impl Sender {
    fn flush(&mut self) {
        let messages = self.writer.take();
        if !messages.is_empty() {
            self.audience.send(&messages);
        }
    }

    fn poses(&mut self, t: &Telemetry) {
        let (tip, base) = (pose_of(&t.world_from_tip), pose_of(&t.world_from_base));
        for (device, pose) in [(device::TIP, &tip), (device::BASE, &base)] {
            if let Some(pose) = self.space.pose(pose) {
                self.writer.put(device, t.stamp, Body::Transform(pose));
            }
        }
        if let Some(position) = self.space.position(&tip) {
            let body = Body::Position(position);
            self.writer.put(device::POSITION, t.stamp, body);
        }
        if let Some(target) = self.space.point(&self.target(t)) {
            let body = Body::Transform(igtl::Transform::at(target));
            self.writer.put(device::TARGET, t.stamp, body);
        }
        // As the base is turned, but along the true axis.
        if let Some(truth) = &t.truth
            && let Some(turn) =
                UnitQuaternion::rotation_between(&(base.rotation * Vector3::z()), &truth.direction)
            && let Some(pose) = self.space.pose(&Isometry3::from_parts(
                truth.tip.into(),
                turn * base.rotation,
            ))
        {
            self.writer
                .put(device::TRUTH, truth.stamp, Body::Transform(pose));
        }
    }

    /// The target in World; not a number before there is one.
    fn target(&self, t: &Telemetry) -> Vector3<f64> {
        (self.optics.world_from_left * t.target).coords()
    }

    fn lines(&mut self, t: &Telemetry) {
        let model = &t.model;
        for (device, points) in [
            (device::NEEDLE, &model.shape),
            (device::CUT, &model.rest_points),
            (device::PREDICTED, &model.predicted_path),
        ] {
            let points: Vec<[f32; 3]> = points
                .iter()
                .filter_map(|point| self.space.point(point))
                .collect();
            let body = Body::PolyData(PolyData::polylines([points.as_slice()]));
            self.writer.put(device, t.stamp, body);
        }
        let tip = t.world_from_tip.origin().coords();
        let ends = (self.space.point(&tip), self.space.point(&self.target(t)));
        if let (Some(entry), Some(target)) = ends {
            let plan = Trajectory {
                name: "tip to target".to_owned(),
                group: "Trajectory".to_owned(),
                ends: Ends::Both,
                colour: PLAN,
                entry,
                target,
                ..Trajectory::default()
            };
            let body = Body::Trajectories(vec![plan]);
            self.writer.put(device::PLAN, t.stamp, body);
        }
    }

    fn state(&mut self, t: &Telemetry, dropped: u64) {
        let counts: BTreeMap<_, _> = self.counters.counts();
        let state = json!({
            "step": t.step,
            "time_s": t.stamp.secs_since(Stamp::ZERO),
            "phase": format!("{:?}", t.phase),
            "mode": format!("{:?}", t.law.mode),
            "tracking": format!("{:?}", t.tracking),
            "arm": format!("{:?}", t.arm_mode),
            "depth_mm": t.depth * 1e3,
            "lateral_error_mm": t.lateral_error * 1e3,
            "axial_distance_mm": t.axial_distance * 1e3,
            "predicted_miss_mm": t.law.predicted_miss.norm() * 1e3,
            "stiffness_n_m2": t.model.stiffness,
            "mean_stretch_mm": t.model.mean_stretch * 1e3,
            "max_stretch_mm": t.model.max_stretch * 1e3,
            "entry_force_n": t.model.entry_force,
            "clients": self.audience.len(),
            "snapshots_dropped": dropped,
            "dropped": counts,
            "tracker": self.tracker.as_ref().map(|tracker| json!({
                "taken": tracker.taken(),
                "dropped": tracker.counters().counts(),
            })),
        });
        self.writer
            .put(device::STATE, t.stamp, text_of(&state.to_string()));
    }

    fn slow(&mut self, t: &Telemetry) {
        self.writer
            .put(device::STATUS, t.stamp, Body::Status(status(t)));
        let left = self.optics.world_from_left;
        let right = self.optics.left_from_right.map(|right| left * right);
        let cameras = [
            (device::LEFT, Some(pose_of(&left))),
            (device::RIGHT, right.map(|right| pose_of(&right))),
        ];
        for (device, pose) in cameras {
            if let Some(pose) = pose.and_then(|pose| self.space.pose(&pose)) {
                self.writer.put(device, t.stamp, Body::Transform(pose));
            }
        }
    }

    /// The left image with what was found in it, placed in space where the camera sees it.
    fn image(&mut self, pair: &StereoFrame, overlay: &Overlay) {
        let (width, height) = (overlay.image.image.width(), overlay.image.image.height());
        let (Ok(w), Ok(h)) = (u16::try_from(width), u16::try_from(height)) else {
            return;
        };
        let Some(camera) = &self.optics.left else {
            return;
        };
        let pose = self.optics.world_from_left;
        let (dx, dy) = (IMAGE_DISTANCE / camera.fx, IMAGE_DISTANCE / camera.fy);
        let middle = |pixels: usize, centre: f64| (pixels as f64 - 1.0) / 2.0 - centre;
        let centre = Vector3::new(
            middle(width, camera.cx) * dx,
            middle(height, camera.cy) * dy,
            IMAGE_DISTANCE,
        );
        let centre = pose.isometry() * nalgebra::Point3::from(centre);
        let Some(centre) = self.space.point(&centre.coords) else {
            return;
        };
        let step = |v: Vector3<f64>| self.space.direction(&(pose.rotate(&v) * 1e3));
        let body = Body::Image(Image {
            components: 3,
            scalar: Scalar::Uint8,
            big_endian: false,
            coordinates: self.space.coordinates(),
            size: [w, h, 1],
            steps: [
                step(Vector3::x() * dx),
                step(Vector3::y() * dy),
                step(Vector3::z() * 1e-3),
            ],
            centre,
            part_from: [0; 3],
            part_size: [w, h, 1],
            pixels: overlay.draw(),
        });
        self.writer.put(device::IMAGE, pair.left.stamp, body);
    }
}

/// How the run is, by the protocol's codes.
fn status(t: &Telemetry) -> Status {
    let faulted = matches!(t.arm_mode, ArmMode::Faulted(_));
    let code = match t.phase {
        _ if faulted => StatusCode::HARDWARE_FAILURE,
        Phase::Faulted => StatusCode::UNKNOWN_ERROR,
        Phase::Idle => StatusCode::NOT_READY,
        Phase::Paused => StatusCode::DISABLED,
        Phase::Ended => StatusCode::EXITING,
        Phase::PreInsertion | Phase::Steering | Phase::Retracting => StatusCode::OK,
    };
    Status {
        code,
        sub_code: i64::try_from(t.step).unwrap_or(i64::MAX),
        name: format!("{:?}", t.phase),
        text: format!(
            "{:?}: depth {:.1} mm, target {:.2} mm off the tip's axis",
            t.phase,
            t.depth * 1e3,
            t.lateral_error * 1e3
        ),
    }
}
