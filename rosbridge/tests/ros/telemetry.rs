//! What the bridge shows, seen by ROS's tools.

use std::time::Duration;

use crate::child::Player;
use crate::master::Master;

/// The last average that `rostopic hz` prints [Hz].
fn rate(master: &Master, topic: &str) -> f64 {
    let output = master.output(6, "rostopic", &["hz", topic]);
    output
        .lines()
        .rev()
        .find_map(|line| line.trim().strip_prefix("average rate: "))
        .unwrap_or_else(|| panic!("no rate of {topic}: {output}"))
        .parse()
        .unwrap()
}

#[test]
fn rates_hold() {
    let Some(master) = Master::start() else {
        return;
    };
    let player = Player::start(&master, "bridge");
    let bounds = [
        ("/joint_states", 95.0, 105.0),
        ("/tf", 47.0, 53.0),
        ("/needle/markers", 19.0, 21.0),
    ];
    for (topic, lowest, highest) in bounds {
        let rate = rate(&master, topic);
        assert!((lowest..=highest).contains(&rate), "{topic}: {rate} Hz");
    }
    player.end();
}

/// ROS's tools decode every message and find the run's numbers in it.
#[test]
fn contents_are_the_runs() {
    let Some(master) = Master::start() else {
        return;
    };
    let player = Player::start(&master, "bridge");
    let echo = |topic: &str| master.output(20, "rostopic", &["echo", "-n", "1", topic]);
    let joints = echo("/joint_states");
    assert!(
        joints.contains("position: [0.0, -1.462349, 3.616621, 0.0, 0.987321, 0.0]"),
        "{joints}"
    );
    assert!(
        joints.contains("name:") && joints.contains("joint_6"),
        "{joints}"
    );
    let still = echo("/tf_static");
    for frame in ["world", "base_link", "left_camera_optical_frame"] {
        assert!(still.contains(&format!("\"{frame}\"")), "{still}");
    }
    assert!(echo("/tf").contains("child_frame_id: \"needle_tip\""));
    assert!(echo("/needle/tip").contains("x: 0.4"));
    let markers = echo("/needle/markers");
    for name in ["needle", "target", "tip_axis"] {
        assert!(markers.contains(&format!("ns: \"{name}\"")), "{markers}");
    }
    let image = master.output(
        20,
        "rostopic",
        &["echo", "-n", "1", "--noarr", "/left/image_raw"],
    );
    assert!(
        image.contains("length: 307200") && image.contains("mono8"),
        "{image}"
    );
    assert!(echo("/left/camera_info").contains("equidistant"));
    let diagnostics = echo("/diagnostics");
    assert!(diagnostics.contains("needle_steer: run"), "{diagnostics}");
    assert!(diagnostics.contains("Steering, Straight"), "{diagnostics}");
    player.end();
}

/// A bag carries our own message's definition, and rosbag's decoder finds the numbers with it.
#[test]
fn bags_hold_own_messages() {
    let Some(master) = Master::start() else {
        return;
    };
    let player = Player::start(&master, "bridge");
    let topics = ["/needle/state", "/tf", "/needle/markers"];
    let mut arguments = vec!["record", "--duration=3", "-O", "run.bag"];
    arguments.extend(topics);
    let recorded = master.run(30, "rosbag", &arguments);
    assert!(recorded.status.success(), "{recorded:?}");
    let script = "import rosbag\n\
        with rosbag.Bag('run.bag') as bag:\n\
        \x20   for topic, m, t in bag.read_messages(topics=['/needle/state']):\n\
        \x20       print(m._type, m.phase, m.lateral_error, m.stiffness)\n\
        \x20   print(sorted(bag.get_type_and_topic_info().topics))\n";
    let read = master.run(30, "python3", &["-c", script]);
    let text = String::from_utf8_lossy(&read.stdout).into_owned();
    let states = text
        .lines()
        .filter(|line| *line == "needle_steer_msgs/State Steering 0.00125 22200.0");
    assert!(
        states.count() > 50,
        "{text} {}",
        String::from_utf8_lossy(&read.stderr)
    );
    assert!(topics.iter().all(|topic| text.contains(topic)), "{text}");
    player.end();
}

#[test]
fn services_and_targets_reach_the_run() {
    let Some(master) = Master::start() else {
        return;
    };
    let mut player = Player::start(&master, "bridge");
    for (service, command) in [
        ("start", "Start"),
        ("pause", "Pause"),
        ("retract", "Retract"),
    ] {
        let answer = master.output(
            20,
            "rosservice",
            &["call", &format!("/needle_steer/{service}")],
        );
        assert!(
            answer.contains("success: True") && answer.contains("as you wish"),
            "{answer}"
        );
        assert_eq!(player.line(), command);
    }
    let answer = master.output(
        20,
        "rosservice",
        &["call", "/needle_steer/enable", "data: true"],
    );
    assert!(answer.contains("success: True"), "{answer}");
    assert_eq!(player.line(), "Enable(true)");
    let target = "{header: {frame_id: left_camera_optical_frame}, point: {x: 0.01, z: 0.5}}";
    master.run(
        20,
        "rostopic",
        &["pub", "-1", "/target", "geometry_msgs/PointStamped", target],
    );
    assert!(
        player
            .line()
            .starts_with("Target([0.01, 0, 0.5] m in left_camera"),
        "target"
    );
    player.end();
}

#[test]
fn an_ended_node_leaves_nothing_behind() {
    let Some(master) = Master::start() else {
        return;
    };
    let player = Player::start(&master, "bridge");
    assert!(
        master
            .output(20, "rosnode", &["list"])
            .contains("/needle_steer")
    );
    let started = std::time::Instant::now();
    player.end();
    assert!(
        started.elapsed() < Duration::from_secs(4),
        "{:?}",
        started.elapsed()
    );
    let nodes = master.output(20, "rosnode", &["list"]);
    assert!(!nodes.contains("/needle_steer"), "{nodes}");
    let topics = master.output(20, "rostopic", &["list"]);
    assert!(!topics.contains("needle"), "{topics}");
    let services = master.output(20, "rosservice", &["list"]);
    assert!(!services.contains("needle"), "{services}");
}
