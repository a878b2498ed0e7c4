//! The state of a run in the terms of `/diagnostics`.

use std::time::Duration;

use hal::telemetry::{Phase, Telemetry, Tracking};
use hal::{ArmMode, Stamp};

use crate::convert;
use crate::msg::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus, KeyValue};

/// The newest reading of an arm.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reading {
    pub(super) mode: ArmMode,
    /// Time since it came.
    pub(super) age: Duration,
    /// Whether the arm still counts as reporting.
    pub(super) is_fresh: bool,
}

/// One status each for the run, the arm, the tracking, the bridge and each device that says what it
/// waits for.
pub(super) fn message(
    latest: Option<&Telemetry>,
    arm: Option<Reading>,
    devices: &[(String, Option<String>)],
    stamp: Stamp,
    node: &str,
    dropped: u64,
) -> DiagnosticArray {
    let node = node.trim_start_matches('/');
    let mut status = vec![bridge(dropped), report(arm)];
    status.extend(
        devices
            .iter()
            .map(|(device, doubt)| waiting(device, doubt.as_deref())),
    );
    if let Some(t) = latest {
        status.extend([run(t), tracking(t)]);
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

/// An arm that reports no more is in error, whatever it said last.
fn report(arm: Option<Reading>) -> DiagnosticStatus {
    let Some(Reading {
        mode,
        age,
        is_fresh,
    }) = arm
    else {
        return status(
            DiagnosticStatus::ERROR,
            "arm",
            "the arm has not reported yet".to_owned(),
            &[],
        );
    };
    let age = age.as_secs_f64();
    let values = [("age of the newest reading [s]", age)];
    if !is_fresh {
        let message = format!("the arm does not report: last reading {age:.1} s ago ({mode:?})");
        return status(DiagnosticStatus::ERROR, "arm", message, &values);
    }
    let level = match mode {
        ArmMode::Faulted(_) => DiagnosticStatus::ERROR,
        ArmMode::Disconnected => DiagnosticStatus::WARN,
        _ => DiagnosticStatus::OK,
    };
    status(level, "arm", format!("{mode:?}"), &values)
}

fn waiting(device: &str, doubt: Option<&str>) -> DiagnosticStatus {
    let level = doubt.map_or(DiagnosticStatus::OK, |_| DiagnosticStatus::ERROR);
    status(level, device, doubt.unwrap_or("ready").to_owned(), &[])
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arm_that_reports_no_more_is_an_error_whatever_it_said_last() {
        let level = |age_ms, is_fresh, mode| {
            let age = Duration::from_millis(age_ms);
            let status = report(Some(Reading {
                mode,
                age,
                is_fresh,
            }));
            (status.level, status.message)
        };
        let (alive, _) = level(5, true, ArmMode::Connected);
        assert_eq!(alive, DiagnosticStatus::OK);
        let (dead, message) = level(3_200, false, ArmMode::Connected);
        assert_eq!(dead, DiagnosticStatus::ERROR);
        assert!(
            message.contains("does not report") && message.contains("3.2 s"),
            "{message}"
        );
        assert_eq!(report(None).level, DiagnosticStatus::ERROR);
    }
}
