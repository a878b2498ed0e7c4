//! The telemetry snapshot as ROS's standard messages, for logs and for topics alike.

use hal::frame::{Frame, LeftCamera, NeedleBase, NeedleTip, World};
use hal::telemetry::{Telemetry, TruthReport};
use hal::{Joints, Stamp, Transform};
use nalgebra::{Isometry3, Vector3};

use crate::convert;
use crate::msg::needle_steer_msgs::State;
use crate::msg::visualization_msgs::{Marker, MarkerArray};
use crate::msg::{geometry_msgs, sensor_msgs, std_msgs, tf2_msgs};

/// Joint positions and rates; both have as many values as the arm has joints.
pub(crate) fn joint_state(
    header: std_msgs::Header,
    names: &[String],
    [positions, rates]: [&Joints; 2],
) -> sensor_msgs::JointState {
    sensor_msgs::JointState {
        header,
        name: names.iter().take(positions.len()).cloned().collect(),
        position: positions.to_vec(),
        velocity: rates.to_vec(),
        effort: Vec::new(),
    }
}

/// Pose of the model's tip.
pub(crate) fn tip(t: &Telemetry) -> geometry_msgs::PoseStamped {
    geometry_msgs::PoseStamped {
        header: convert::header(t.stamp, World::NAME, t.step),
        pose: convert::pose(t.world_from_tip.isometry()),
    }
}

/// One transform of the tree, named by its frames.
pub(crate) fn edge<A: Frame, B: Frame>(
    a_from_b: &Transform<A, B>,
    stamp: Stamp,
) -> geometry_msgs::TransformStamped {
    link(A::NAME, B::NAME, a_from_b.isometry(), stamp)
}

/// One transform of the tree between links of any names.
pub(crate) fn link(
    parent: &str,
    child: &str,
    parent_from_child: &Isometry3<f64>,
    stamp: Stamp,
) -> geometry_msgs::TransformStamped {
    geometry_msgs::TransformStamped {
        header: convert::header(stamp, parent, 0),
        child_frame_id: child.to_owned(),
        transform: convert::transform(parent_from_child),
    }
}

pub(crate) fn tree(transforms: Vec<geometry_msgs::TransformStamped>) -> tf2_msgs::TFMessage {
    tf2_msgs::TFMessage { transforms }
}

/// The tip below the needle's base.
pub(crate) fn tip_edge(t: &Telemetry) -> geometry_msgs::TransformStamped {
    let base_from_tip: Transform<NeedleBase, NeedleTip> =
        t.world_from_base.inverse() * t.world_from_tip;
    edge(&base_from_tip, t.stamp)
}

/// The few numbers that a display shows.
pub(crate) fn state(t: &Telemetry) -> State {
    State {
        header: convert::header(t.stamp, World::NAME, t.step),
        step: t.step,
        phase: format!("{:?}", t.phase),
        mode: format!("{:?}", t.law.mode),
        tracking: format!("{:?}", t.tracking),
        arm: format!("{:?}", t.arm_mode),
        lateral_error: t.lateral_error,
        axial_distance: t.axial_distance,
        depth: t.depth,
        predicted_miss: t.law.predicted_miss.norm(),
        stiffness: t.model.stiffness,
        mean_stretch: t.model.mean_stretch,
        max_stretch: t.model.max_stretch,
        entry_force: t.model.entry_force,
    }
}

type Colour = [f32; 4];

const NEEDLE: Colour = [0.75, 0.78, 0.85, 1.0];
const CUT_PATH: Colour = [1.0, 0.55, 0.0, 1.0];
const SPRINGS: Colour = [0.9, 0.9, 0.2, 0.9];
const PREDICTED: Colour = [0.1, 0.6, 1.0, 1.0];
const TARGET: Colour = [1.0, 0.05, 0.05, 1.0];
const TIP_AXIS: Colour = [0.1, 0.9, 0.2, 1.0];
const TRUTH: Colour = [0.8, 0.2, 0.9, 0.6];

/// Diameter of the drawn target \[m\].
const TARGET_DIAMETER: f64 = 0.006;
/// Diameter of the true target \[m\]: seen where it lies outside of the drawn one.
const TRUE_TARGET_DIAMETER: f64 = 0.004;
/// Length of the drawn tip axis \[m\].
const TIP_AXIS_LENGTH: f64 = 0.03;

/// Needle, springs, cut path, predicted path, target, tip axis and, in simulation, the truth.
pub(crate) fn markers(t: &Telemetry) -> MarkerArray {
    let model = &t.model;
    let springs: Vec<_> = model
        .spring_points
        .iter()
        .zip(&model.rest_points)
        .flat_map(|(shaft, rest)| [*shaft, *rest])
        .collect();
    let tip = t.world_from_tip.origin().coords();
    let axis = t.world_from_tip.rotate(&Vector3::z()) * TIP_AXIS_LENGTH;
    let mut markers = vec![
        line(
            t,
            "needle",
            Marker::LINE_STRIP,
            0.0012,
            NEEDLE,
            &model.shape,
        ),
        line(
            t,
            "cut_path",
            Marker::LINE_STRIP,
            0.0008,
            CUT_PATH,
            &model.rest_points,
        ),
        line(t, "springs", Marker::LINE_LIST, 0.0004, SPRINGS, &springs),
        line(
            t,
            "predicted_path",
            Marker::LINE_STRIP,
            0.0006,
            PREDICTED,
            &model.predicted_path,
        ),
        arrow(t, "tip_axis", TIP_AXIS, [tip, tip + axis]),
        sphere(t, "target", LeftCamera::NAME, TARGET, &t.target.coords()),
    ];
    let none = TruthReport::default();
    let truth = t.truth.as_ref();
    let shape = &truth.unwrap_or(&none).shape;
    markers.push(line(
        t,
        "true_needle",
        Marker::LINE_STRIP,
        0.0008,
        TRUTH,
        shape,
    ));
    if let Some(truth) = truth {
        let mut sphere = sphere(t, "true_target", World::NAME, TRUTH, &truth.target);
        sphere.scale = convert::vector(&Vector3::repeat(TRUE_TARGET_DIAMETER));
        markers.push(sphere);
    }
    MarkerArray { markers }
}

fn marker(t: &Telemetry, name: &str, frame: &str, kind: u8, colour: Colour) -> Marker {
    let [r, g, b, a] = colour;
    Marker {
        header: convert::header(t.stamp, frame, t.step),
        ns: name.to_owned(),
        type_: i32::from(kind),
        pose: convert::pose(&Isometry3::identity()),
        color: std_msgs::ColorRGBA { r, g, b, a },
        ..Marker::default()
    }
}

/// A line, or its removal where there is nothing to draw: displays refuse lines of fewer than
/// two points.
fn line(
    t: &Telemetry,
    name: &str,
    kind: u8,
    width: f64,
    colour: Colour,
    points: &[Vector3<f64>],
) -> Marker {
    let mut marker = marker(t, name, World::NAME, kind, colour);
    marker.scale.x = width;
    if points.len() < 2 || !points.iter().flatten().all(|x| x.is_finite()) {
        marker.action = i32::from(Marker::DELETE);
    } else {
        marker.points = convert::points(points);
    }
    marker
}

fn arrow(t: &Telemetry, name: &str, colour: Colour, ends: [Vector3<f64>; 2]) -> Marker {
    let mut arrow = line(t, name, Marker::ARROW, 0.001, colour, &ends);
    arrow.scale.y = 0.002;
    arrow
}

fn sphere(t: &Telemetry, name: &str, frame: &str, colour: Colour, at: &Vector3<f64>) -> Marker {
    let mut sphere = marker(t, name, frame, Marker::SPHERE, colour);
    if at.iter().all(|x| x.is_finite()) {
        sphere.pose.position = convert::point(at);
        sphere.scale = convert::vector(&Vector3::repeat(TARGET_DIAMETER));
    } else {
        sphere.action = i32::from(Marker::DELETE);
    }
    sphere
}
