//! `roslaunch` end to end, with the binary.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use needle_steer::{config, rig};

use crate::master::{Master, Running, wait_until};
use crate::picture::{Picture, Screen, shows_the_scene};
use crate::{BINARY, alone, among_others, call, nodes, phase};

/// A running `roslaunch`; interrupted on drop so that it ends its nodes.
struct Launch(Running);

impl Launch {
    fn start(master: &Master, arguments: &[&str], screen: Option<&Screen>) -> Self {
        let packages = concat!(env!("CARGO_MANIFEST_DIR"), "/../rosbridge/ros:/usr/share");
        let mut command = master.command("roslaunch");
        command
            .args(arguments)
            .env("ROS_PACKAGE_PATH", packages)
            .env("NEEDLE_STEER_BIN", BINARY)
            // Files are named from where roslaunch is called.
            .current_dir(master.home())
            .env("PWD", master.home())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        if let Some(screen) = screen {
            command
                .env("DISPLAY", screen.name())
                .env("LIBGL_ALWAYS_SOFTWARE", "1")
                .env("QT_QPA_PLATFORM", "xcb")
                .env("XDG_RUNTIME_DIR", master.home());
        }
        Self(Running(command.spawn().unwrap()))
    }
}

impl Drop for Launch {
    fn drop(&mut self) {
        let _ = Command::new("kill")
            .args(["-INT", &self.0.0.id().to_string()])
            .status();
        let _ = self.0.0.wait();
    }
}

fn wait_for_node(master: &Master) {
    let up = wait_until(Duration::from_secs(30), || {
        nodes(master).contains("/needle_steer")
    });
    assert!(up, "{}", nodes(master));
}

/// From the robot's description and joint_states, through robot_state_publisher.
fn check_frames(master: &Master, expected: &[&str]) {
    let script = "import rospy\nfrom tf2_msgs.msg import TFMessage\n\
        rospy.init_node('frames', disable_signals=True)\nseen = set()\n\
        def take(m): seen.update(t.header.frame_id + '>' + t.child_frame_id for t in m.transforms)\n\
        a = rospy.Subscriber('/tf', TFMessage, take)\n\
        b = rospy.Subscriber('/tf_static', TFMessage, take)\n\
        rospy.rostime.wallsleep(3)\nprint('\\n'.join(sorted(seen)))\n";
    let frames = master.output(20, "python3", &["-c", script]);
    for edge in expected {
        assert!(
            frames.lines().any(|line| line == *edge),
            "{edge} is missing: {frames}"
        );
    }
}

/// The last average that `rostopic hz` prints [Hz].
fn rate(master: &Master, topic: &str) -> f64 {
    let output = master.output(5, "rostopic", &["hz", topic]);
    output
        .lines()
        .rev()
        .find_map(|line| line.trim().strip_prefix("average rate: "))
        .unwrap_or_else(|| panic!("no rate of {topic}: {output}"))
        .parse()
        .unwrap()
}

/// Step, lateral error and depth of the states in a bag.
fn record_states(master: &Master) -> Vec<(usize, f64, f64)> {
    let arguments = ["record", "--duration=3", "-O", "run.bag", "/needle/state"];
    let recorded = master.run(30, "rosbag", &arguments);
    assert!(recorded.status.success(), "{recorded:?}");
    let script = "import rosbag\n\
        for _, m, _ in rosbag.Bag('run.bag').read_messages():\n\
        \x20   print(m.step, repr(m.lateral_error), repr(m.depth))\n";
    let text = master.output(30, "python3", &["-c", script]);
    let number = |text: &str| text.parse::<f64>().unwrap();
    text.lines()
        .map(|line| {
            let fields: Vec<&str> = line.split(' ').collect();
            let step = fields[0].parse().unwrap();
            (step, number(fields[1]), number(fields[2]))
        })
        .collect()
}

/// Every state that was seen is that of the run's own series.
fn compare(states: &[(usize, f64, f64)], series: &Path) {
    let text = std::fs::read_to_string(series).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().map(|row| row.split(',').collect()).collect();
    let column = |name: &str| rows[0].iter().position(|cell| *cell == name).unwrap();
    let (depth_mm, error_mm) = (column("depth_mm"), column("lateral_error_mm"));
    assert!(states.len() > 50, "{} states", states.len());
    for (step, error, depth) in states {
        // Steps count from 1, and row 0 is the header.
        for (cell, value) in [(depth_mm, depth), (error_mm, error)] {
            let logged: f64 = rows[*step][cell].parse().unwrap();
            assert!((logged - value * 1e3).abs() < 1e-9, "step {step}: {logged}");
        }
    }
}

/// The default insertion on the wall clock, to its target, through everything that happens to it:
/// rviz, a pause, a bag, a master that goes and comes back.
#[test]
fn sim_launch_runs_the_default_insertion_to_its_target() {
    let Some(mut master) = Master::start() else {
        return;
    };
    // rviz without a graphics card takes every processor for itself.
    let _alone = alone();
    let screen = Screen::start(&master);
    let out = master.home().join("results");
    let results = "out:=results".to_owned();
    let with_rviz = format!("rviz:={}", screen.is_some());
    let arguments = ["needle_steer", "sim.launch", &with_rviz, &results];
    let launch = Launch::start(&master, &arguments, screen.as_ref());
    wait_for_node(&master);
    let (paused, answer) = call(&master, "/needle_steer/pause");
    assert!(paused, "{answer}");
    let viper = [
        "world>base_link",
        "world>left_camera_optical_frame",
        "link_5>link_6",
        "tool0>needle_base",
        "needle_base>needle_tip",
    ];
    check_frames(&master, &viper);
    let (on, answer) = call(&master, "/needle_steer/start");
    assert!(on, "{answer}");
    let inserting = wait_until(Duration::from_secs(40), || {
        phase(&master).contains("Steering")
    });
    assert!(inserting, "{}", phase(&master));
    // Held, so that the insertion does not end while rviz comes up beside other tests.
    let (held, answer) = call(&master, "/needle_steer/pause");
    assert!(held, "{answer}");
    if let Some(screen) = &screen {
        let mut found = String::new();
        let shown = wait_until(Duration::from_mins(3), || {
            let dump = screen.dump(&master);
            if dump.is_empty() {
                return false;
            }
            let shows;
            (shows, found) = shows_the_scene(&Picture::parse(&dump));
            if let (true, Some(keep)) = (shows, std::env::var_os("NEEDLE_STEER_PICTURE")) {
                std::fs::write(keep, &dump).unwrap();
            }
            shows
        });
        println!("{found}");
        assert!(shown, "{found}");
        // It needs the processor that the rates below need.
        master.run(20, "rosnode", &["kill", "/rviz"]);
    }
    let (on, answer) = call(&master, "/needle_steer/start");
    assert!(on, "{answer}");
    let rate = rate(&master, "/joint_states");
    println!("joint_states: {rate} Hz");
    assert!((95.0..=105.0).contains(&rate), "{rate} Hz");
    let states = record_states(&master);
    master.kill();
    std::thread::sleep(Duration::from_secs(1));
    master.launch();
    let back = wait_until(Duration::from_secs(15), || {
        let topics = master.output(10, "rostopic", &["list"]);
        topics.lines().any(|line| line == "/needle/state")
    });
    assert!(back, "topics are not registered anew");
    let summary = out.join("summary.json");
    let ended = wait_until(Duration::from_mins(3), || summary.exists());
    assert!(ended, "the insertion does not end: {}", phase(&master));
    std::thread::sleep(Duration::from_millis(500));
    let text = std::fs::read_to_string(&summary).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(summary["ended"], "target passed", "{text}");
    assert!(summary["true_error_mm"].as_f64().unwrap() < 0.3, "{text}");
    compare(&states, &out.join("series.csv"));
    assert!(nodes(&master).contains("/needle_steer"), "the node stays");
    assert!(phase(&master).contains("Ended"), "{}", phase(&master));
    drop(launch);
    let left = nodes(&master);
    assert!(!left.contains("/needle_steer"), "{left}");
}

#[test]
fn viper_launch_inserts_with_the_emulated_controller() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let launch = Launch::start(
        &master,
        &["needle_steer", "viper.launch", "rviz:=false"],
        None,
    );
    wait_for_node(&master);
    let inserting = wait_until(Duration::from_secs(40), || {
        phase(&master).contains("Steering")
    });
    assert!(inserting, "{}", phase(&master));
    drop(launch);
    let left = nodes(&master);
    assert!(!left.contains("/needle_steer"), "{left}");
}

/// A device of fewer joints and an arm of another maker: their own descriptions join our frames at
/// both ends.
#[test]
fn sim_launch_shows_the_arm_that_the_configuration_names() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots");
    for (urdf, keys, edges) in [
        (
            format!("{root}/urdf/stage.urdf"),
            ["arm.tip_link=needle_base", "arm.mechanism=true"],
            ["base_link>stage_base", "slide>needle_base"],
        ),
        (
            format!("{root}/tests/data/arms/kuka_iiwa7.urdf"),
            ["arm.tip_link=tool0", "arm.tip_mm=[0.0,0.0,20.0]"],
            ["world>base_link", "tool0>needle_base"],
        ),
    ] {
        let mut overrides = vec![format!("arm.urdf={urdf:?}"), "run.sensor=shape".to_owned()];
        overrides.extend(keys.map(str::to_owned));
        let config = rig::placed(&config::load(None, &overrides).unwrap()).unwrap();
        std::fs::write(
            master.home().join("own.toml"),
            toml::to_string(&config).unwrap(),
        )
        .unwrap();
        let own = format!("urdf:={urdf}");
        let arguments = [
            "needle_steer",
            "sim.launch",
            "rviz:=false",
            "config:=own.toml",
            &own,
        ];
        let launch = Launch::start(&master, &arguments, None);
        wait_for_node(&master);
        let inserting = wait_until(Duration::from_secs(40), || {
            phase(&master).contains("Steering")
        });
        assert!(inserting, "{}", phase(&master));
        check_frames(&master, &[&edges[..], &["needle_base>needle_tip"]].concat());
        drop(launch);
        let left = nodes(&master);
        assert!(!left.contains("/needle_steer"), "{left}");
    }
}
