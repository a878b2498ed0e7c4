//! The way out over ROS: after a stop in the node that stays, and after a node that was killed.

use std::io::{BufRead, BufReader};
use std::process::Command;
use std::time::Duration;

use crate::master::{Master, wait_until};
use crate::{BINARY, alone, among_others, call, nodes, phase, signal, start};

fn ended(summary: &std::path::Path) -> String {
    let text = std::fs::read_to_string(summary).unwrap_or_default();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    summary["ended"].as_str().unwrap_or_default().to_owned()
}

#[test]
fn a_stopped_insertion_is_withdrawn_once_and_never_resumed() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let out = master.home().join("stopped");
    let arguments = [
        "run",
        "--sensor",
        "shape",
        "--set",
        "ros.publish=true",
        "--out",
        out.to_str().unwrap(),
    ];
    let mut run = start(&master, &arguments);
    let steering = wait_until(Duration::from_mins(1), || {
        phase(&master).contains("Steering")
    });
    assert!(steering, "{}", phase(&master));
    let (stopped, answer) = call(&master, "/needle_steer/stop");
    assert!(stopped, "{answer}");
    let there = wait_until(Duration::from_secs(20), || {
        out.join("summary.json").exists()
    });
    assert!(there && ended(&out.join("summary.json")) == "interrupted");
    let (resumed, answer) = call(&master, "/needle_steer/start");
    assert!(!resumed && answer.contains("not resumed"), "{answer}");
    let (retracting, answer) = call(&master, "/needle_steer/retract");
    assert!(retracting && answer.contains("withdrawing"), "{answer}");
    // Neither while it comes out nor after.
    let (resumed, answer) = call(&master, "/needle_steer/start");
    assert!(!resumed, "{answer}");
    let summary = out.join("withdrawal-1").join("summary.json");
    let done = wait_until(Duration::from_mins(1), || summary.exists());
    assert!(
        done && ended(&summary) == "retracted",
        "{}",
        ended(&summary)
    );
    let log = out.join("withdrawal-1").join("run.mcap");
    assert!(log.metadata().unwrap().len() > 10_000);
    let (again, answer) = call(&master, "/needle_steer/retract");
    assert!(again && answer.contains("already at the start"), "{answer}");
    let (resumed, answer) = call(&master, "/needle_steer/start");
    assert!(!resumed && answer.contains("not resumed"), "{answer}");
    signal(&run.0, "-TERM");
    assert_eq!(run.0.wait().unwrap().code(), Some(1));
}

/// The laboratory is another process; its arm outlives the controller's.
#[test]
fn an_arm_whose_node_was_killed_is_withdrawn() {
    let Some(master) = Master::start() else {
        return;
    };
    let _alone = alone();
    let mut laboratory = start(&master, &["emulate", "ros", "--set", "run.sensor=shape"]);
    let mut ready = String::new();
    let mut lines = BufReader::new(laboratory.0.stdout.take().unwrap());
    lines.read_line(&mut ready).unwrap();
    assert_eq!(ready, "ready\n");
    let out = master.home().join("killed");
    let arguments = [
        "run",
        "--backend",
        "ros",
        "--sensor",
        "shape",
        "--set",
        "ros.late_ms=1000",
        "--out",
        out.to_str().unwrap(),
    ];
    let mut run = start(&master, &arguments);
    let log = out.join("run.mcap");
    let grown = wait_until(Duration::from_mins(1), || {
        log.metadata().is_ok_and(|file| file.len() > 2_000_000)
    });
    assert!(grown, "no log");
    signal(&run.0, "-KILL");
    run.0.wait().unwrap();
    assert!(!out.join("summary.json").exists());
    let mut last = String::new();
    // A busy machine may miss a deadline, which stops the arm; the same command goes on.
    let out_at_last = (0..3).any(|_| {
        let mut command = Command::new(BINARY);
        master.environment(&mut command);
        let output = command
            .args(["withdraw", log.to_str().unwrap(), "--json"])
            .output()
            .unwrap();
        last = format!("{output:?}");
        output.status.success()
    });
    assert!(out_at_last, "{last}");
    assert!(last.contains("retracted"), "{last}");
    signal(&laboratory.0, "-TERM");
    assert!(laboratory.0.wait().unwrap().success());
    let left = nodes(&master);
    assert!(!left.contains("needle_steer"), "{left}");
}
