//! A domain of ROS 2, and processes in it.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Write};
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde_json::Value;

pub(crate) const BINARY: &str = env!("CARGO_BIN_EXE_needle-steer");
/// Where the peers' programs are.
const PEERS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers");
/// What of the environment a node of ROS 2 heeds.
const HEEDED: [&str; 6] = [
    "ROS_LOCALHOST_ONLY",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "ROS_DISTRO",
    "RMW_IMPLEMENTATION",
    "CYCLONEDDS_URI",
];

/// Rates suffer when tests share the machine's few cores.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// A domain that nobody else is in, and a folder; removed on drop.
pub(crate) struct Domain {
    number: u16,
    home: PathBuf,
    python: OsString,
    _alone: MutexGuard<'static, ()>,
}

/// A process that is killed on drop.
pub(crate) struct Running(pub(crate) Child);

impl Running {
    pub(crate) fn kill(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.kill();
    }
}

pub(crate) fn wait_until(limit: Duration, mut done: impl FnMut() -> bool) -> bool {
    let end = Instant::now() + limit;
    while Instant::now() < end {
        if done() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    done()
}

impl Domain {
    /// A domain; nothing, with a message, where there is no Python with Cyclone DDS.
    pub(crate) fn new() -> Option<Self> {
        let python = std::env::var_os("NEEDLE_STEER_PEERS").filter(|python| {
            let tried = Command::new(python)
                .args(["-c", "import cyclonedds"])
                .stderr(Stdio::null())
                .status();
            tried.is_ok_and(|status| status.success())
        });
        let Some(python) = python else {
            assert!(
                std::env::var_os("NEEDLE_STEER_REQUIRE_ROS2").is_none(),
                "NEEDLE_STEER_PEERS names no Python with cyclonedds"
            );
            eprintln!("skipped: NEEDLE_STEER_PEERS names no Python with cyclonedds");
            return None;
        };
        let alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        // Whose first participant's port nobody has; other test programs look elsewhere first.
        let first = std::process::id() % 100;
        let number = (0..100)
            .map(|i| u16::try_from((first + i) % 100 + 1).unwrap())
            .find(|number| UdpSocket::bind(("0.0.0.0", 7410 + 250 * number)).is_ok())
            .unwrap();
        let home = std::env::temp_dir().join(format!("ros2-{}-{number}", std::process::id()));
        let _ = std::fs::remove_dir_all(&home);
        std::fs::create_dir_all(&home).unwrap();
        Some(Self {
            number,
            home,
            python,
            _alone: alone,
        })
    }

    pub(crate) fn home(&self) -> &Path {
        &self.home
    }

    pub(crate) fn environment(&self, command: &mut Command) {
        for name in HEEDED {
            command.env_remove(name);
        }
        command
            .env("ROS_DOMAIN_ID", self.number.to_string())
            .env("PYTHONPATH", PEERS)
            .env("PYTHONDONTWRITEBYTECODE", "1")
            .env("PYTHONUNBUFFERED", "1")
            .current_dir(&self.home);
    }

    /// The binary, in this domain.
    pub(crate) fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(BINARY);
        self.environment(&mut command);
        command.args(arguments).stdin(Stdio::null());
        command
    }

    pub(crate) fn start(&self, arguments: &[&str]) -> Running {
        let mut command = self.command(arguments);
        Running(command.stdout(Stdio::piped()).spawn().unwrap())
    }

    /// The binary, once it has said that it is ready.
    pub(crate) fn start_ready(&self, arguments: &[&str]) -> Running {
        let mut process = self.start(arguments);
        let mut lines = BufReader::new(process.0.stdout.take().unwrap()).lines();
        assert_eq!(lines.next().unwrap().unwrap(), "ready");
        // Nobody would hear the rest if this were dropped.
        std::thread::spawn(move || lines.for_each(drop));
        process
    }

    pub(crate) fn python(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(&self.python);
        self.environment(&mut command);
        command.args(arguments);
        command
    }

    /// `ros2_peer.py`.
    pub(crate) fn peer(&self) -> Peer {
        let lines = Talk::start(self.python(&[&format!("{PEERS}/ros2_peer.py")]));
        let mut peer = Peer { lines };
        assert!(peer.next(|said| said["ready"] == true).is_some());
        peer
    }

    /// `ros2_arm.py`, at `joints` \[rad\].
    pub(crate) fn arm(&self, topic: &str, names: &str, joints: &[f64]) -> Talk {
        let joints: Vec<_> = joints.iter().map(f64::to_string).collect();
        let program = format!("{PEERS}/ros2_arm.py");
        let mut arm = Talk::start(self.python(&[&program, topic, names, &joints.join(",")]));
        assert_eq!(arm.line(Duration::from_secs(20)).unwrap(), "ready");
        arm
    }

    /// `ur_ros2.py`, at the joints given [rad].
    pub(crate) fn robot(&self, joints: &str) -> Talk {
        let program = format!("{PEERS}/ur_ros2.py");
        let mut robot = Talk::start(self.python(&[&program, joints]));
        assert_eq!(robot.line(Duration::from_secs(20)).unwrap(), "ready");
        robot
    }
}

impl Drop for Domain {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.home);
    }
}

/// A process to which lines are said, and which answers in lines.
pub(crate) struct Talk {
    pub(crate) process: Running,
    orders: ChildStdin,
    lines: Receiver<String>,
}

impl Talk {
    fn start(mut command: Command) -> Self {
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (said, lines) = channel();
        let out = BufReader::new(child.stdout.take().unwrap());
        std::thread::spawn(move || {
            for line in out.lines().map_while(Result::ok) {
                if said.send(line).is_err() {
                    return;
                }
            }
        });
        Self {
            orders: child.stdin.take().unwrap(),
            process: Running(child),
            lines,
        }
    }

    pub(crate) fn order(&mut self, order: &str) {
        writeln!(self.orders, "{order}").unwrap();
    }

    /// The next line; nothing if none comes in time.
    pub(crate) fn line(&mut self, limit: Duration) -> Option<String> {
        match self.lines.recv_timeout(limit) {
            Ok(line) => Some(line),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => panic!("the process has ended"),
        }
    }

    /// What follows `word` in the next line that begins with it.
    pub(crate) fn after(&mut self, word: &str) -> String {
        let end = Instant::now() + Duration::from_secs(20);
        while Instant::now() < end {
            let line = self.line(Duration::from_secs(20));
            let line = line.unwrap_or_else(|| panic!("no line `{word}`"));
            if let Some(rest) = line.strip_prefix(word) {
                return rest.trim().to_owned();
            }
        }
        panic!("no line `{word}`");
    }
}

/// The other side of a ROS 2 graph.
pub(crate) struct Peer {
    pub(crate) lines: Talk,
}

impl Peer {
    pub(crate) fn order(&mut self, order: &str) {
        self.lines.order(order);
    }

    /// The next object for which `wanted` holds, within 20 s; others are passed over.
    pub(crate) fn next(&mut self, wanted: impl Fn(&Value) -> bool) -> Option<Value> {
        let end = Instant::now() + Duration::from_secs(20);
        while Instant::now() < end {
            let Some(line) = self.lines.line(Duration::from_millis(200)) else {
                continue;
            };
            let said: Value = serde_json::from_str(&line).unwrap();
            assert!(said["error"].is_null(), "{said}");
            if wanted(&said) {
                return Some(said);
            }
        }
        None
    }

    /// The next message on a topic.
    pub(crate) fn message(&mut self, topic: &str) -> Value {
        let found = self.next(|said| said["topic"] == topic);
        found.unwrap_or_else(|| panic!("nothing on {topic}"))["message"].clone()
    }

    /// Calls a service: whether it was accepted, and the answer.
    pub(crate) fn call(&mut self, service: &str) -> (bool, String) {
        self.order(&format!("call {service}"));
        let name = service.split(' ').next().unwrap();
        let said = self.next(|said| said["service"] == name);
        let said = said.unwrap_or_else(|| panic!("{service} does not answer"));
        let message = said["message"].as_str().unwrap().to_owned();
        (said["success"] == true, message)
    }

    /// All that has been said so far.
    pub(crate) fn rest(&mut self) -> Vec<Value> {
        let mut said = Vec::new();
        while let Some(line) = self.lines.line(Duration::from_millis(500)) {
            said.push(serde_json::from_str(&line).unwrap());
        }
        said
    }
}
