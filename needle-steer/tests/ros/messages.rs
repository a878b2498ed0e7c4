//! What ROS's own tools make of the packages, the messages and the bags.

use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use crate::master::{Master, Running};
use crate::{among_others, signal, start_run, wait_for_node};

const PACKAGES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../rosbridge/ros");

/// Standard output of a command that succeeds, with the packages of this project in its path.
fn tool(master: &Master, program: &str, arguments: &[&str], more: &[(&str, &str)]) -> String {
    let output = master
        .command("timeout")
        .args([&["30", program], arguments].concat())
        .env("ROS_PACKAGE_PATH", format!("{PACKAGES}:/usr/share"))
        .envs(more.iter().copied())
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "{program} {arguments:?}: {text}{errors}"
    );
    text
}

#[test]
fn rosmsg_and_rostopic_know_the_messages() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let shown = tool(&master, "rosmsg", &["show", "needle_steer_msgs/State"], &[]);
    assert!(shown.contains("float64 predicted_miss"), "{shown}");
    let modules = master.home().join("modules");
    let script = Path::new(PACKAGES).join("needle_steer_msgs/scripts/python_modules");
    let said = tool(
        &master,
        script.to_str().unwrap(),
        &[modules.to_str().unwrap()],
        &[],
    );
    let path = said.trim().strip_prefix("export PYTHONPATH=").unwrap();
    let path = path.split('$').next().unwrap();
    let _run = start_run(&master, &[], &master.home().join("out"));
    wait_for_node(&master, "needle_steer");
    // A subscriber of the generated class is served only if both have the same definition.
    let echoed = tool(
        &master,
        "rostopic",
        &["echo", "-n", "1", "/needle/state"],
        &[("PYTHONPATH", path)],
    );
    assert!(echoed.contains("predicted_miss: "), "{echoed}");
    // Debian has no folder at its default ROS_ROOT, which roswtf counts as an error.
    let root = master.home().join("ros");
    std::fs::create_dir_all(&root).unwrap();
    let findings = tool(
        &master,
        "roswtf",
        &[],
        &[("ROS_ROOT", root.to_str().unwrap())],
    );
    assert!(!findings.contains("ERROR"), "{findings}");
}

#[test]
fn who_subscribes_late_to_a_played_bag_has_the_static_frames() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let run = start_run(&master, &[], &master.home().join("out"));
    wait_for_node(&master, "needle_steer");
    let bag = master.home().join("run.bag");
    let bag = bag.to_str().unwrap();
    let record = ["record", "--duration=6", "-O", bag, "/tf", "/tf_static"];
    tool(&master, "rosbag", &record, &[]);
    signal(&run.0, "-TERM");
    drop(run);
    let play = master
        .command("rosbag")
        .args(["play", "--quiet", bag])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn();
    let _play = Running(play.unwrap());
    std::thread::sleep(Duration::from_secs(3));
    let heard = tool(&master, "rostopic", &["echo", "-n", "1", "/tf_static"], &[]);
    assert!(heard.contains("left_camera_optical_frame"), "{heard}");
    // Rules for old bags are read from every package on the path, so that a broken one fails here. Our
    // definitions of ROS's messages carry no comments: to rosbag a rule from the same to the same.
    let checked = tool(&master, "rosbag", &["check", bag], &[]);
    let is_clean = checked.contains("up to date") || checked.contains("All rules defined");
    assert!(is_clean, "{checked}");
}
