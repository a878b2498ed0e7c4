//! An arm under `ros_control`: it holds the last velocities for ever, moves by itself, reports with
//! another clock, or has a second controller.

use std::io::{BufRead, BufReader, Lines, Read, Write};
use std::process::{ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

use crate::master::{Master, Running, wait_until};
use crate::{BINARY, among_others, call, nodes, ready, start};

/// Topic between the program and the relay.
const BEHIND: &str = "joint_group_velocity_controller/command:=needle_steer/velocities";

/// Where the default insertion starts [rad], and the folder of the message definitions.
fn place() -> [f64; 6] {
    let output = Command::new(BINARY)
        .args(["run", "--dry-run"])
        .output()
        .unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    let (_, rest) = text.split_once("joints [").unwrap();
    let (list, _) = rest.split_once(']').unwrap();
    let degrees = list.split(", ").map(|x| x.parse::<f64>().unwrap());
    let radians: Vec<f64> = degrees.map(f64::to_radians).collect();
    radians.try_into().unwrap()
}

/// `arm.py` on a master.
struct VelocityArm {
    _process: Running,
    orders: ChildStdin,
    lines: Lines<BufReader<ChildStdout>>,
}

impl VelocityArm {
    fn start(master: &Master, joints: [f64; 6]) -> Self {
        let joints = joints.map(|q| q.to_string()).join(",");
        let messages = concat!(env!("CARGO_MANIFEST_DIR"), "/../rosbridge/msgs");
        let mut child = master
            .command("python3")
            .args(["-c", include_str!("arm.py"), &joints, messages])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut arm = Self {
            orders: child.stdin.take().unwrap(),
            lines: BufReader::new(child.stdout.take().unwrap()).lines(),
            _process: Running(child),
        };
        assert_eq!(arm.line(), "ready");
        arm
    }

    fn line(&mut self) -> String {
        self.lines
            .next()
            .map_or_else(|| "(ended)".to_owned(), Result::unwrap)
    }

    /// The figure of the next line that starts with `word` [s].
    fn figure(&mut self, word: &str) -> f64 {
        loop {
            let line = self.line();
            assert_ne!(line, "(ended)");
            if let Some(rest) = line.strip_prefix(word) {
                return rest.trim().parse().unwrap();
            }
        }
    }

    fn order(&mut self, order: &str) {
        writeln!(self.orders, "{order}").unwrap();
        while self.line() != "done" {}
    }
}

/// A node that waits for `~start`.
pub(crate) fn waiting(master: &Master, more: &[&str]) -> Running {
    let fixed = [
        "run",
        "--backend",
        "ros",
        "--sensor",
        "shape",
        "--set",
        "ros.publish=true",
        "--set",
        "ros.autostart=false",
        // A busy machine must not fail; how soon silence is a fault has its own tests.
        "--set",
        "ros.late_ms=500",
        "--set",
        "supervisor.image_stop_ms=60000",
    ];
    let run = start(master, &[&fixed[..], more].concat());
    let up = wait_until(Duration::from_secs(20), || {
        let services = master.output(10, "rosservice", &["list"]);
        services.contains("/needle_steer/start")
    });
    assert!(up, "{}", nodes(master));
    run
}

/// A run that is to be refused before it has begun: what it says.
fn refused(master: &Master) -> String {
    let mut command = Command::new(BINARY);
    master.environment(&mut command);
    let output = command
        .args(["run", "--backend", "ros", "--sensor", "shape"])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn a_start_from_elsewhere_and_a_hindered_robot_are_refused_and_the_node_stays() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let mut aside = place();
    aside[0] += 0.088;
    let mut arm = VelocityArm::start(&master, aside);
    assert!(
        refused(&master).contains("mm and"),
        "the figures are missing"
    );
    let _run = waiting(&master, &[]);
    let (started, answer) = call(&master, "/needle_steer/start");
    assert!(!started, "{answer}");
    let away = answer.split("needle's base is ").nth(1).unwrap_or_default();
    let away: f64 = away.split(" mm").next().unwrap().parse().unwrap();
    assert!((30.0..40.0).contains(&away), "{answer}");
    // Back at the start, but the robot's controller cannot move it.
    drop(arm);
    arm = VelocityArm::start(&master, place());
    for (field, bad, good) in [
        ("motion_possible", 0, 1),
        ("e_stopped", 1, 0),
        ("in_error", 1, 0),
    ] {
        arm.order(&format!("status {field} {bad}"));
        let mut answer = String::new();
        let named = wait_until(Duration::from_secs(10), || {
            let (started, said) = call(&master, "/needle_steer/start");
            assert!(!started, "{said}");
            answer = said;
            answer.contains(field)
        });
        assert!(named, "{field}: {answer}");
        arm.order(&format!("status {field} {good}"));
        std::thread::sleep(Duration::from_millis(200));
    }
    assert!(nodes(&master).contains("/needle_steer"));
}

#[test]
fn an_arm_that_creeps_while_paused_is_stopped_for_it() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let mut arm = VelocityArm::start(&master, place());
    let out = master.home().join("creep");
    let _run = waiting(&master, &["--out", out.to_str().unwrap()]);
    let (started, answer) = call(&master, "/needle_steer/start");
    assert!(started, "{answer}");
    let (paused, answer) = call(&master, "/needle_steer/pause");
    assert!(paused, "{answer}");
    std::thread::sleep(Duration::from_secs(1));
    // 14 mm/s at 0.4 m from the first axis.
    arm.order("creep 0.035");
    let summary = out.join("summary.json");
    let ended = wait_until(Duration::from_secs(10), || summary.exists());
    assert!(ended, "nobody notices");
    std::thread::sleep(Duration::from_millis(300));
    let text = std::fs::read_to_string(&summary).unwrap();
    assert!(text.contains("UncommandedMotion"), "{text}");
}

#[test]
fn a_robot_with_another_clock_is_refused_with_the_skew_in_words() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let mut arm = VelocityArm::start(&master, place());
    for (skew, words) in [("10", "ahead of"), ("-10", "behind")] {
        arm.order(&format!("skew {skew}"));
        let said = refused(&master);
        let figure = said.contains("10.0") || said.contains("9.99");
        assert!(said.contains(words) && figure, "{said}");
    }
}

#[test]
fn a_second_controller_is_refused_at_the_start_and_stops_a_run() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let _arm = VelocityArm::start(&master, place());
    let rival = |rate: u32| {
        let script = format!(
            "import rospy\nfrom std_msgs.msg import Float64MultiArray\n\
             rospy.init_node('rival', disable_signals=True)\n\
             p = rospy.Publisher('joint_group_velocity_controller/command', Float64MultiArray, queue_size=1)\n\
             print('up', flush=True)\n\
             while True:\n    rospy.rostime.wallsleep(0.02)\n    if {rate}: p.publish(data=[0.0] * 6)\n"
        );
        let mut rival = master.python(&script);
        let mut lines = BufReader::new(rival.0.stdout.take().unwrap()).lines();
        assert_eq!(lines.next().unwrap().unwrap(), "up");
        rival
    };
    let silent = rival(0);
    let said = refused(&master);
    assert!(
        said.contains("/rival") && said.contains("two controllers"),
        "{said}"
    );
    // One that has died without a word does not count.
    drop(silent);
    let out = master.home().join("rival");
    let _run = waiting(&master, &["--out", out.to_str().unwrap()]);
    let (started, answer) = call(&master, "/needle_steer/start");
    assert!(started, "{answer}");
    let _fights = rival(1);
    let summary = out.join("summary.json");
    let ended = wait_until(Duration::from_secs(10), || summary.exists());
    assert!(ended, "two controllers fight");
    std::thread::sleep(Duration::from_millis(300));
    let text = std::fs::read_to_string(&summary).unwrap();
    assert!(text.contains("SecondController"), "{text}");
}

#[test]
fn the_relay_stops_an_arm_whose_program_was_killed() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let mut arm = VelocityArm::start(&master, place());
    let mut relay = start(&master, &["relay"]);
    let _said = ready(&mut relay);
    let mut run = waiting(&master, &[BEHIND]);
    let lifts = "import rospy\nfrom geometry_msgs.msg import TwistStamped\n\
         rospy.init_node('hand', disable_signals=True)\n\
         p = rospy.Publisher('/twist_cmd', TwistStamped, queue_size=1)\n\
         m = TwistStamped()\nm.header.frame_id = 'world'\nm.twist.linear.z = 0.005\n\
         while True:\n    m.header.stamp = rospy.Time.now()\n    p.publish(m)\n\
         \x20   rospy.rostime.wallsleep(0.02)\n";
    let _hand = master.python(lifts);
    arm.figure("moving");
    std::thread::sleep(Duration::from_millis(500));
    run.0.kill().unwrap();
    run.0.wait().unwrap();
    // Since the last velocity that the arm heard.
    let after = arm.figure("still");
    assert!(after < 0.3, "the arm goes on for {after} s");
}

#[test]
fn a_relay_refuses_controllers_that_another_node_commands() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let topic = "joint_group_velocity_controller/command";
    let kind = "std_msgs/Float64MultiArray";
    let mut command = master.command("rostopic");
    command.args(["pub", "-r", "10", topic, kind, "data: [0, 0, 0, 0, 0, 0]"]);
    let _rival = Running(command.stdout(Stdio::null()).spawn().unwrap());
    let up = wait_until(Duration::from_secs(10), || {
        master
            .output(10, "rostopic", &["list"])
            .contains("joint_group")
    });
    assert!(up);
    let mut command = Command::new(BINARY);
    master.environment(&mut command);
    let mut relay = Running(
        command
            .arg("relay")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    assert_eq!(relay.0.wait().unwrap().code(), Some(1));
    let mut said = String::new();
    relay
        .0
        .stderr
        .take()
        .unwrap()
        .read_to_string(&mut said)
        .unwrap();
    assert!(said.contains("two controllers"), "{said}");
}
