//! Masters that go, come back or hang; subscribers that hang; clients that say nothing.

use std::io::{BufRead, BufReader};
use std::net::{TcpListener, TcpStream};
use std::process::Command;
use std::time::{Duration, Instant};

use crate::child::Player;
use crate::master::{Master, wait_until};

#[test]
fn a_master_that_comes_back_finds_everything_again() {
    let Some(mut master) = Master::start() else {
        return;
    };
    let player = Player::start(&master, "bridge");
    master.kill();
    std::thread::sleep(Duration::from_secs(2));
    master.launch();
    let back = wait_until(Duration::from_secs(15), || {
        let topics = master.output(10, "rostopic", &["list"]);
        ["/joint_states", "/tf_static", "/diagnostics", "/target"]
            .iter()
            .all(|topic| topics.lines().any(|line| line == *topic))
    });
    assert!(back, "{}", master.output(10, "rostopic", &["list"]));
    let joints = master.output(20, "rostopic", &["echo", "-n", "1", "/joint_states"]);
    assert!(
        joints.contains("position: [0.0, -1.462349, 3.616621, 0.0, 0.987321, 0.0]"),
        "{joints}"
    );
    let still = master.output(20, "rostopic", &["echo", "-n", "1", "/tf_static"]);
    assert!(
        still.contains("base_link"),
        "latched messages are sent again: {still}"
    );
    let answer = master.output(20, "rosservice", &["call", "/needle_steer/stop"]);
    assert!(answer.contains("success: True"), "{answer}");
    player.end();
    assert!(
        !master
            .output(20, "rosnode", &["list"])
            .contains("/needle_steer")
    );
}

#[test]
fn a_hanging_master_is_given_up_after_five_seconds() {
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let uri = format!("http://{}/", silent.local_addr().unwrap());
    let mut player = Player::launch("connect", |command| {
        command
            .env("ROS_MASTER_URI", &uri)
            .env("ROS_IP", "127.0.0.1");
    });
    let line = player.line();
    assert!(line.starts_with("5 s: the ROS master at"), "{line}");
    assert!(
        line.contains(&uri) && line.contains("does not answer"),
        "{line}"
    );
}

#[test]
fn a_missing_master_is_named_at_once() {
    let uri = format!("http://127.0.0.1:{}/", crate::master::free_port());
    let mut player = Player::launch("connect", |command| {
        command
            .env("ROS_MASTER_URI", &uri)
            .env("ROS_IP", "127.0.0.1");
    });
    let line = player.line();
    assert!(
        line.starts_with("0 s: no ROS master at") && line.contains(&uri),
        "{line}"
    );
}

#[test]
fn a_node_open_to_other_machines_needs_permission() {
    let mut player = Player::launch("connect", |command| {
        command
            .env("ROS_IP", "192.0.2.1")
            .env_remove("ROS_HOSTNAME");
    });
    let line = player.line();
    assert!(
        line.contains("192.0.2.1") && line.contains("set ROS_IP=127.0.0.1"),
        "{line}"
    );
}

/// Prints the largest gap between images over 6 s, from the first one on.
const LARGEST_GAP: &str = "
import rospy, time
from sensor_msgs.msg import Image
rospy.init_node('watcher', disable_signals=True)
seen = []
rospy.Subscriber('/left/image_raw', Image, lambda m: seen.append(time.monotonic()))
while not seen: time.sleep(0.01)
print('watching', flush=True)
time.sleep(6)
ends = seen[1:] + [time.monotonic()]
print(max(b - a for a, b in zip(seen, ends)), len(seen), flush=True)
";

const SUBSCRIBER: &str = "
import rospy, time
from sensor_msgs.msg import Image
rospy.init_node('sleeper', disable_signals=True)
seen = []
rospy.Subscriber('/left/image_raw', Image, lambda m: seen.append(1))
while not seen: time.sleep(0.01)
print('receiving', flush=True)
time.sleep(600)
";

fn first_line(reader: &mut impl BufRead) -> String {
    let mut line = String::new();
    reader.read_line(&mut line).unwrap();
    line.trim().to_owned()
}

/// A subscriber that stops reading 9 MB/s of images costs the others less than 0.6 s.
#[test]
fn a_stopped_subscriber_starves_nobody() {
    let Some(master) = Master::start() else {
        return;
    };
    let player = Player::start(&master, "bridge");
    let mut sleeper = master.python(SUBSCRIBER);
    let mut sleeping = BufReader::new(sleeper.0.stdout.take().unwrap());
    assert_eq!(first_line(&mut sleeping), "receiving");
    let mut watcher = master.python(LARGEST_GAP);
    let mut watching = BufReader::new(watcher.0.stdout.take().unwrap());
    assert_eq!(first_line(&mut watching), "watching");
    let stop = Command::new("kill")
        .args(["-STOP", &sleeper.0.id().to_string()])
        .status();
    assert!(stop.unwrap().success());
    let result = first_line(&mut watching);
    let (gap, seen) = result.split_once(' ').unwrap();
    let (gap, seen): (f64, u32) = (gap.parse().unwrap(), seen.parse().unwrap());
    println!("largest gap {gap:.3} s over {seen} images");
    assert!(gap < 0.6, "{gap} s");
    assert!(seen > 120, "{seen} images in 6 s");
    player.end();
}

/// The port of a topic's publisher, asked as a subscriber asks.
const PORT: &str = "
import rosgraph, xmlrpc.client
master = rosgraph.Master('/asker')
publishers = dict(master.getSystemState()[0])
assert '/joint_states' in publishers
uri = master.lookupNode('/needle_steer')
code, text, (name, host, port) = xmlrpc.client.ServerProxy(uri).requestTopic(
    '/asker', '/joint_states', [['TCPROS']])
print(port, flush=True)
";

#[test]
fn a_silent_client_keeps_nobody_out_for_long() {
    let Some(master) = Master::start() else {
        return;
    };
    let player = Player::start(&master, "bridge");
    let mut asker = master.python(PORT);
    let port = first_line(&mut BufReader::new(asker.0.stdout.take().unwrap()));
    let port: u16 = port.parse().unwrap();
    let silent: Vec<_> = (0..2)
        .map(|_| TcpStream::connect(("127.0.0.1", port)).unwrap())
        .collect();
    let started = Instant::now();
    let joints = master.output(20, "rostopic", &["echo", "-n", "1", "/joint_states"]);
    assert!(joints.contains("position:"), "{joints}");
    // Two silent clients of 1 s each, and the start of Python.
    assert!(
        started.elapsed() < Duration::from_secs(10),
        "{:?}",
        started.elapsed()
    );
    drop(silent);
    player.end();
}
