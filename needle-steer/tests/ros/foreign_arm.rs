//! An arm that is not ours: another process with the maker's kinematics, its own needle, tissue and tracker, which
//! knows of this project what docs/ROS.md says.

use std::io::{BufRead, BufReader, Lines, Write};
use std::process::{ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

use crate::master::{Master, Running};
use crate::ur_robot::{self, REST, off, verdict};
use crate::velocity_arm::waiting;
use crate::{BINARY, alone, call, ready, start};

/// Where the robot's own controllers listen, and what leads the program to the relay.
const CONTROLLERS: &str = "joint_group_vel_controller/command";
const BEHIND: &str = "joint_group_velocity_controller/command:=needle_steer/velocities";

struct Robot {
    _process: Running,
    orders: ChildStdin,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Robot {
    /// Where the program expects it; its messages are made as the manual says.
    fn start(master: &Master, told: &[String]) -> Self {
        let packages = concat!(env!("CARGO_MANIFEST_DIR"), "/../rosbridge/ros");
        let peers = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers");
        let modules = master.home().join("modules");
        let script = format!("{packages}/needle_steer_msgs/scripts/python_modules");
        let mut make = Command::new(script);
        master.environment(&mut make);
        let made = make
            .arg(&modules)
            .env("ROS_PACKAGE_PATH", "/usr/share")
            .stdout(Stdio::null())
            .status();
        assert!(made.unwrap().success());
        let mut child = master
            .command("python3")
            .args([
                &format!("{peers}/ur_ros1.py"),
                &ur_robot::start(BINARY, told),
            ])
            .env("PYTHONPATH", &modules)
            .env("PYTHONDONTWRITEBYTECODE", "1")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut robot = Self {
            orders: child.stdin.take().unwrap(),
            lines: BufReader::new(child.stdout.take().unwrap()).lines(),
            _process: Running(child),
        };
        robot.after("ready");
        robot
    }

    /// What follows `word` in the next line that begins with it.
    fn after(&mut self, word: &str) -> String {
        for line in self.lines.by_ref() {
            if let Some(rest) = line.unwrap().strip_prefix(word) {
                return rest.trim().to_owned();
            }
        }
        panic!("the robot's program has ended before `{word}`");
    }

    /// Distance of the target from the needle's axis \[mm\].
    fn off(&mut self) -> f64 {
        writeln!(self.orders, "where").unwrap();
        off(&self.after("tip "))
    }
}

/// The program behind the relay, once it has begun to insert; it ends with the insertion.
fn begun(master: &Master, told: &[String]) -> Running {
    let mut arguments: Vec<&str> = told.iter().map(String::as_str).collect();
    arguments.extend([BEHIND, "--set", "ros.stay=false", "--out", "insertion"]);
    let run = waiting(master, &arguments);
    let (started, answer) = call(master, "/needle_steer/start");
    assert!(started, "{answer}");
    run
}

#[test]
#[ignore = "a minute in real time on a machine that is not busy: the robot is a Python program at 125 Hz"]
fn a_robot_of_another_laboratory_inserts_the_needle_to_the_target() {
    let Some(master) = Master::start() else {
        return;
    };
    let _alone = alone();
    let told = ur_robot::told(master.home());
    let mut robot = Robot::start(&master, &told);
    let mut relay = start(&master, &["relay", "--output", CONTROLLERS]);
    let _said = ready(&mut relay);
    let mut run = begun(&master, &told);
    let code = run.0.wait().unwrap().code();
    let (hit, ended) = verdict(&master.home().join("insertion"));
    // The robot's own world knows better than its tracker's measurements.
    let off = robot.off();
    println!("{off:.3} mm off the target; hit: {hit}; {ended}");
    assert!(hit && code == Some(0) && off < 0.5, "{off} mm off: {ended}");
}

#[test]
fn it_rests_soon_after_the_program_was_killed_amid_an_insertion() {
    let Some(master) = Master::start() else {
        return;
    };
    let _alone = alone();
    let told = ur_robot::told(master.home());
    let mut robot = Robot::start(&master, &told);
    let mut relay = start(&master, &["relay", "--output", CONTROLLERS]);
    let _said = ready(&mut relay);
    let mut run = begun(&master, &told);
    while robot.after("depth ").parse::<f64>().unwrap() < 10.0 {}
    run.0.kill().unwrap();
    run.0.wait().unwrap();
    // Since the last velocity that the robot heard.
    let after: f64 = robot.after("rest ").parse().unwrap();
    println!("at rest {after} s after the last velocity");
    assert!(after < REST, "the robot goes on for {after} s");
    let before = robot.off();
    std::thread::sleep(Duration::from_secs(1));
    assert_eq!(before.to_bits(), robot.off().to_bits(), "it moves again");
}
