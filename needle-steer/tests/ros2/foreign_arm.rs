//! An arm that is not ours: another process with the maker's kinematics, its own needle, tissue and tracker, which
//! knows of this project what docs/ROS.md says.

use std::time::Duration;

use crate::peer::{BINARY, Domain, Running, Talk, wait_until};
use crate::ur_robot::{self, REST, off, verdict};

/// Where the robot's own controllers listen.
const CONTROLLERS: &str = "/forward_velocity_controller/commands";

/// The program behind the relay, once it has begun to insert; it ends with the insertion.
fn begun(domain: &Domain, told: &[String]) -> Running {
    let mut arguments = vec!["run", "--backend", "ros", "--sensor", "shape"];
    arguments.extend(told.iter().map(String::as_str));
    for set in [
        "ros.version=2",
        "ros.publish=true",
        "ros.autostart=false",
        "ros.stay=false",
        // A busy machine must not fail; how soon silence is a fault has its own tests.
        "ros.late_ms=500",
        "supervisor.image_stop_ms=60000",
    ] {
        arguments.extend(["--set", set]);
    }
    arguments.extend(["--out", "insertion", "--ros-args", "-r"]);
    arguments.push("joint_group_velocity_controller/command:=needle_steer/velocities");
    let run = domain.start(&arguments);
    let mut peer = domain.peer();
    peer.order("read /rosout Log reliable latched");
    let up = peer.next(|said| said.to_string().contains("is up"));
    assert!(up.is_some(), "no node");
    let (started, answer) = peer.call("/needle_steer/start");
    assert!(started, "{answer}");
    run
}

fn where_it_ended(robot: &mut Talk) -> f64 {
    robot.order("where");
    off(&robot.after("tip "))
}

#[test]
#[ignore = "a minute in real time on a machine that is not busy: the robot is a Python program at 125 Hz"]
fn a_robot_of_another_laboratory_inserts_the_needle_to_the_target() {
    let Some(domain) = Domain::new() else { return };
    let told = ur_robot::told(domain.home());
    let mut robot = domain.robot(&ur_robot::start(BINARY, &told));
    let _relay = domain.start_ready(&["relay", "--ros2", "--output", CONTROLLERS]);
    let mut run = begun(&domain, &told);
    let ended = wait_until(Duration::from_mins(3), || {
        run.0.try_wait().unwrap().is_some()
    });
    assert!(ended, "the run does not end");
    let (hit, ended) = verdict(&domain.home().join("insertion"));
    // The robot's own world knows better than its tracker's measurements.
    let off = where_it_ended(&mut robot);
    println!("{off:.3} mm off the target; hit: {hit}; {ended}");
    assert!(hit && off < 0.5, "{off} mm off: {ended}");
}

#[test]
fn it_rests_soon_after_the_program_was_killed_amid_an_insertion() {
    let Some(domain) = Domain::new() else { return };
    let told = ur_robot::told(domain.home());
    let mut robot = domain.robot(&ur_robot::start(BINARY, &told));
    let _relay = domain.start_ready(&["relay", "--ros2", "--output", CONTROLLERS]);
    let mut run = begun(&domain, &told);
    while robot.after("depth ").parse::<f64>().unwrap() < 10.0 {}
    run.kill();
    // Since the last velocity that the robot heard.
    let after: f64 = robot.after("rest ").parse().unwrap();
    println!("at rest {after} s after the last velocity");
    assert!(after < REST, "the robot goes on for {after} s");
}
