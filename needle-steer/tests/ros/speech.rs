//! What the node says: on `/rosout` and on standard error, as much of it as it is asked for, and of a
//! master that goes and comes back.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::process::Stdio;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use crate::master::{Master, Running};
use crate::{BINARY, among_others, call, nodes, signal, wait_for_node};

/// Prints what is said on `/rosout`: level, node, text.
const LISTENER: &str = "import rospy\nfrom rosgraph_msgs.msg import Log\n\
    rospy.init_node('listener', disable_signals=True, disable_rosout=True)\n\
    def heard(m):\n\
    \x20   if 'needle' in m.name: print(m.level, m.name, m.msg, flush=True)\n\
    rospy.Subscriber('/rosout', Log, heard)\nprint('up', flush=True)\n\
    rospy.rostime.wallsleep(300)\n";

/// Levels of `rosgraph_msgs/Log`.
const DEBUG: u8 = 1;
const INFO: u8 = 2;
const WARN: u8 = 4;
const ERROR: u8 = 8;

struct Listener {
    _process: Running,
    lines: Receiver<String>,
    passed: VecDeque<String>,
}

impl Listener {
    fn start(master: &Master) -> Self {
        let mut process = master.python(LISTENER);
        let output = BufReader::new(process.0.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in output.lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        assert_eq!(lines.recv_timeout(Duration::from_secs(30)).unwrap(), "up");
        Self {
            _process: process,
            lines,
            passed: VecDeque::new(),
        }
    }

    /// Waits for words of the node at this level.
    fn hears(&mut self, level: u8, words: &str) {
        let start = format!("{level} /needle_steer ");
        let end = Instant::now() + Duration::from_secs(40);
        loop {
            let left = end.saturating_duration_since(Instant::now());
            let Ok(line) = self.lines.recv_timeout(left) else {
                panic!("nothing at level {level} with `{words}`: {:?}", self.passed);
            };
            let is_it = line.starts_with(&start) && line.contains(words);
            self.passed.push_back(line);
            if is_it {
                return;
            }
        }
    }

    fn has_heard(&mut self, words: &str) -> bool {
        self.passed.extend(self.lines.try_iter());
        self.passed.iter().any(|line| line.contains(words))
    }
}

/// Gives a target in a frame that there is not.
fn aim_at_nothing(master: &Master, frame: &str) {
    let message = format!("{{header: {{frame_id: {frame}}}}}");
    let kind = "geometry_msgs/PointStamped";
    master.run(20, "rostopic", &["pub", "-1", "/target", kind, &message]);
}

fn choose_level(master: &Master, level: &str) {
    let chosen = master.run(
        20,
        "rosconsole",
        &["set", "/needle_steer", "ros.needle_steer", level],
    );
    assert!(chosen.status.success(), "{chosen:?}");
    let level_now = master.output(
        20,
        "rosconsole",
        &["get", "/needle_steer", "ros.needle_steer"],
    );
    assert_eq!(level_now.trim(), level);
}

#[test]
fn the_node_says_on_rosout_and_on_the_screen_what_becomes_of_it() {
    let Some(mut master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let out = master.home().join("speech");
    let mut listener = Listener::start(&master);
    let mut command = std::process::Command::new(BINARY);
    master.environment(&mut command);
    command
        .args(["run", "--sensor", "shape", "--set", "ros.publish=true"])
        .args(["--set", "ros.autostart=false", "--json"])
        .args(["--out", out.to_str().unwrap()])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut run = Running(command.spawn().unwrap());
    wait_for_node(&master, "/needle_steer");
    listener.hears(INFO, "is up: law hybrid");
    listener.hears(INFO, "waiting for a start");

    // As much as it is asked for, by ROS's own tool.
    let loggers = master.output(20, "rosconsole", &["list", "/needle_steer"]);
    assert_eq!(loggers.trim(), "ros.needle_steer");
    aim_at_nothing(&master, "nowhere");
    listener.hears(WARN, "target refused: given in frame \"nowhere\"");
    choose_level(&master, "error");
    aim_at_nothing(&master, "elsewhere");
    let (_, answer) = call(&master, "/needle_steer/pause");
    assert!(answer.contains("no insertion"), "{answer}");
    choose_level(&master, "debug");
    let (_, answer) = call(&master, "/needle_steer/pause");
    assert!(answer.contains("no insertion"), "{answer}");
    listener.hears(DEBUG, "~pause refused: no insertion is under way");
    assert!(!listener.has_heard("elsewhere"), "{:?}", listener.passed);
    choose_level(&master, "info");
    for (logger, level) in [("ros.other", "info"), ("ros.needle_steer", "loud")] {
        let request = format!("{{logger: {logger}, level: {level}}}");
        let service = "/needle_steer/set_logger_level";
        let refused = master.run(20, "rosservice", &["call", service, &request]);
        assert!(!refused.status.success(), "{refused:?}");
        let why = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(
            why.contains("there is ros.needle_steer") || why.contains("warn"),
            "{why}"
        );
    }
    assert!(nodes(&master).contains("/needle_steer"));

    let (started, answer) = call(&master, "/needle_steer/start");
    assert!(started, "{answer}");
    listener.hears(INFO, "phase: PreInsertion");
    listener.hears(INFO, "phase: Steering");
    master.kill();
    listener.hears(WARN, "does not answer");
    master.launch();
    let mut listener = Listener::start(&master);
    listener.hears(INFO, "registered anew");
    let (stopped, answer) = call(&master, "/needle_steer/stop");
    assert!(stopped, "{answer}");
    listener.hears(ERROR, "interrupted");
    signal(&run.0, "-TERM");
    assert_eq!(run.0.wait().unwrap().code(), Some(1));

    let (mut said, mut results) = (String::new(), String::new());
    run.0
        .stderr
        .take()
        .unwrap()
        .read_to_string(&mut said)
        .unwrap();
    run.0
        .stdout
        .take()
        .unwrap()
        .read_to_string(&mut results)
        .unwrap();
    for words in [
        "[INFO] needle-steer",
        "[WARN] target refused: given in frame",
        "[DEBUG] ~pause refused",
        "[INFO] phase: Steering",
        "does not answer",
        "[ERROR] interrupted",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    assert!(!said.contains("elsewhere"), "{said}");
    // Standard output is for the results alone.
    assert!(
        serde_json::from_str::<serde_json::Value>(&results).is_ok(),
        "{results}"
    );
}
