//! The state of a run in the terms of `/diagnostics`.

use hal::telemetry::{Phase, Telemetry, Tracking};
use hal::{ArmMode, Stamp};

use crate::convert;
use crate::msg::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus, KeyValue};

/// One status each for the run, the arm, the tracking and the bridge.
pub(super) fn message(
    latest: Option<&Telemetry>,
    stamp: Stamp,
    node: &str,
    dropped: u64,
) -> DiagnosticArray {
    let node = node.trim_start_matches('/');
    let mut status = vec![bridge(dropped)];
    if let Some(t) = latest {
        status.extend([run(t), arm(t), tracking(t)]);
    }
    for status in &mut status {
        status.name = format!("{node}: {}", status.name);
    }
    DiagnosticArray {
        header: convert::header(stamp, "", 0),
        status,
    }
}

fn status(level: i8, name: &str, message: String, values: &[(&str, f64)]) -> DiagnosticStatus {
    DiagnosticStatus {
        level,
        name: name.to_owned(),
        message,
        hardware_id: String::new(),
        values: values
            .iter()
            .map(|(key, value)| KeyValue {
                key: (*key).to_owned(),
                value: format!("{value:.6}"),
            })
            .collect(),
    }
}

fn run(t: &Telemetry) -> DiagnosticStatus {
    let level = match t.phase {
        Phase::Faulted => DiagnosticStatus::ERROR,
        Phase::Paused => DiagnosticStatus::WARN,
        _ => DiagnosticStatus::OK,
    };
    let values = [
        ("step", t.step as f64),
        ("lateral error [m]", t.lateral_error),
        ("axial distance [m]", t.axial_distance),
        ("depth [m]", t.depth),
        ("stiffness [N/m2]", t.model.stiffness),
        ("mean stretch [m]", t.model.mean_stretch),
    ];
    status(
        level,
        "run",
        format!("{:?}, {:?}", t.phase, t.law.mode),
        &values,
    )
}

fn arm(t: &Telemetry) -> DiagnosticStatus {
    let level = match t.arm_mode {
        ArmMode::Faulted(_) => DiagnosticStatus::ERROR,
        ArmMode::Disconnected => DiagnosticStatus::WARN,
        _ => DiagnosticStatus::OK,
    };
    status(level, "arm", format!("{:?}", t.arm_mode), &[])
}

fn tracking(t: &Telemetry) -> DiagnosticStatus {
    let level = match t.tracking {
        Tracking::Lost => DiagnosticStatus::ERROR,
        Tracking::Predicted => DiagnosticStatus::WARN,
        Tracking::None | Tracking::Tracked => DiagnosticStatus::OK,
    };
    let age = t
        .image_stamp
        .map_or(f64::NAN, |image| t.stamp.secs_since(image));
    status(
        level,
        "tracking",
        format!("{:?}", t.tracking),
        &[("image age [s]", age)],
    )
}

fn bridge(dropped: u64) -> DiagnosticStatus {
    let values = [("dropped", dropped as f64)];
    status(
        DiagnosticStatus::OK,
        "bridge",
        "publishing".to_owned(),
        &values,
    )
}
