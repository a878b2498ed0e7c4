//! An arm under `ros2_control` in another process: it holds the last velocities that it heard for ever.

use std::time::Duration;

use crate::peer::{BINARY, Domain, Running, Talk};

/// Names of the Viper's joints.
const JOINTS: &str = "joint_1,joint_2,joint_3,joint_4,joint_5,joint_6";
/// Where velocity controllers of a UR listen.
const CONTROLLERS: &str = "/forward_velocity_controller/commands";

/// Where the default insertion starts \[rad\].
fn place() -> Vec<f64> {
    let output = std::process::Command::new(BINARY)
        .args(["run", "--dry-run"])
        .output()
        .unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    let (_, rest) = text.split_once("joints [").unwrap();
    let (list, _) = rest.split_once(']').unwrap();
    let degrees = list.split(", ").map(|x| x.parse::<f64>().unwrap());
    degrees.map(f64::to_radians).collect()
}

/// A node that waits for `~start`, and commands the relay.
fn waiting(domain: &Domain) -> Running {
    domain.start(&[
        "run",
        "--backend",
        "ros",
        "--sensor",
        "shape",
        "--set",
        "ros.version=2",
        "--set",
        "ros.publish=true",
        "--set",
        "ros.autostart=false",
        // A busy machine must not fail; how soon silence is a fault has its own tests.
        "--set",
        "ros.late_ms=500",
        "--set",
        "supervisor.image_stop_ms=60000",
        "--out",
        "results",
        "--ros-args",
        "-r",
        "joint_group_velocity_controller/command:=needle_steer/velocities",
    ])
}

fn where_it_stands(arm: &mut Talk) -> Vec<f64> {
    arm.order("where");
    let text = arm.after("at ");
    text.split(' ').map(|q| q.parse().unwrap()).collect()
}

/// Driven to the target of a trajectory; then the program is killed while it moves the arm.
#[test]
fn an_arm_is_driven_to_its_target_and_stopped_by_the_relay_when_the_program_dies() {
    let Some(domain) = Domain::new() else { return };
    let start = place();
    let mut arm = domain.arm(CONTROLLERS, JOINTS, &start);
    let _relay = domain.start_ready(&["relay", "--ros2", "--output", CONTROLLERS]);
    let mut run = waiting(&domain);
    let mut peer = domain.peer();
    peer.order("read /rosout Log reliable latched");
    let up = peer.next(|said| said.to_string().contains("is up"));
    assert!(up.is_some(), "no node");
    // About the vertical: the needle stays as far from the tissue as it is.
    let mut goal = start.clone();
    goal[0] += 0.05;
    let words: Vec<_> = goal.iter().map(f64::to_string).collect();
    let words = words.join(" ");
    peer.order(&format!(
        "trajectory /joint_trajectory_controller/command 2 {words}"
    ));
    assert!(peer.next(|said| said["sent"] == true).is_some());
    arm.after("moving");
    arm.after("still");
    let stands = where_it_stands(&mut arm);
    for (q, goal) in stands.iter().zip(&goal) {
        assert!((q - goal).abs() < 2e-3, "{stands:?} instead of {goal:?}");
    }
    // Away from the tissue at 5 mm/s, by hand, for longer than the program lives.
    peer.order("twist /twist_cmd 0.0 0.0 0.005 5.0");
    arm.after("moving");
    std::thread::sleep(Duration::from_millis(500));
    run.kill();
    // Since the last velocity that the arm heard.
    let after: f64 = arm.after("still").parse().unwrap();
    println!("at rest {after} s after the last velocity");
    assert!(after < 0.3, "the arm goes on for {after} s");
    // A new program may have the arm at once: the dead one does not count.
    let _next = waiting(&domain);
    let up = peer.next(|said| said.to_string().contains("is up"));
    assert!(up.is_some(), "the dead program keeps the arm");
}

#[test]
fn a_second_controller_is_refused_at_the_start_and_stops_the_arm() {
    let Some(domain) = Domain::new() else { return };
    let mut arm = domain.arm("/joint_group_velocity_controller/command", JOINTS, &place());
    let mut rival = domain.peer();
    rival.order("velocities /joint_group_velocity_controller/command 30 0 0 0 0 0 0");
    std::thread::sleep(Duration::from_millis(500));
    for arguments in [
        &["relay", "--ros2"][..],
        &[
            "run",
            "--backend",
            "ros",
            "--sensor",
            "shape",
            "--set",
            "ros.version=2",
            "--out",
            "results",
        ],
    ] {
        let output = domain.command(arguments).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("two controllers"), "{said}");
    }
    drop(rival);
    // One that has left does not count; one that comes later stops the arm.
    let _relay = domain.start_ready(&["relay", "--ros2"]);
    let mut hand = domain.peer();
    hand.order("velocities /needle_steer/velocities 20 0.01 0 0 0 0 0");
    arm.after("moving");
    let mut rival = domain.peer();
    rival.order("velocities /joint_group_velocity_controller/command 20 0 0 0 0 0 0");
    arm.after("still");
    // The relay forwards nothing any more.
    std::thread::sleep(Duration::from_secs(1));
    let before = where_it_stands(&mut arm);
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(before, where_it_stands(&mut arm));
}
