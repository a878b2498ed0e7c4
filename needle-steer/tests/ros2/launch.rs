//! The launch files, read through a double of ROS 2's `launch`, and what they start.

use serde_json::Value;

use crate::peer::{BINARY, Domain, Running};

const LAUNCH: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../rosbridge/ros2/needle_steer/launch"
);
const DOUBLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/ros2_launch.py");

/// What a launch file starts.
fn described(domain: &Domain, file: &str, arguments: &[&str]) -> Vec<Value> {
    let file = format!("{LAUNCH}/{file}.launch.py");
    let output = domain
        .python(&[&[DOUBLE, &file], arguments].concat())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// Starts a process that a launch file names, with this binary.
fn started(domain: &Domain, described: &Value) -> Running {
    let words: Vec<_> = described["process"]
        .as_array()
        .unwrap()
        .iter()
        .map(|word| word.as_str().unwrap())
        .collect();
    let mut command = std::process::Command::new(words[0]);
    domain.environment(&mut command);
    command
        .args(&words[1..])
        .env("NEEDLE_STEER_BIN", BINARY)
        .stdin(std::process::Stdio::null())
        .stdout(std::process::Stdio::null());
    Running(command.spawn().unwrap())
}

#[test]
fn launch_files_start_nodes_that_other_nodes_hear() {
    let Some(domain) = Domain::new() else { return };
    let sim = described(&domain, "sim", &["rviz:=true", "seed:=2", "out:=results"]);
    let nodes: Vec<_> = sim
        .iter()
        .filter_map(|said| said["node"].as_array())
        .collect();
    assert_eq!(nodes.len(), 2, "{sim:?}");
    assert_eq!(nodes[0][0], "robot_state_publisher");
    assert!(
        sim.iter()
            .any(|said| said["parameters"][1] == "robot_description")
    );
    let displays = sim.iter().find(|said| said["node"][0] == "rviz2").unwrap();
    let file = displays["arguments"][1].as_str().unwrap();
    assert!(std::path::Path::new(file).exists(), "{file}");
    let without = described(&domain, "sim", &["rviz:=false"]);
    assert!(without.iter().all(|said| said["node"][0] != "rviz2"));
    let run = sim.iter().find(|said| said["process"].is_array()).unwrap();
    let arm = described(&domain, "ros_arm", &["out:=results"]);
    assert_eq!(arm.len(), 2, "{arm:?}");
    assert!(arm[0]["respawn"] == true && arm[1]["respawn"] == false);
    let _relay = started(&domain, &arm[0]);
    let mut peer = domain.peer();
    peer.order("read /rosout Log reliable latched");
    let _run = started(&domain, run);
    let up = peer.next(|said| {
        let said = said["message"]["msg"].as_str().unwrap_or_default();
        said.contains("is up") && said.contains("seed 2")
    });
    assert!(up.is_some(), "the run is not heard");
    // The relay stops the arm at its start.
    peer.order("read /forward_velocity_controller/commands Float64MultiArray reliable volatile");
    peer.order("velocities /needle_steer/velocities 3 0.1 0 0 0 0 0");
    let forwarded = peer.next(|said| said["message"]["data"][0] == 0.1);
    assert!(forwarded.is_some(), "the relay forwards nothing");
}
