//! A private ROS master, and ROS's tools on it.

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Rates suffer when tests share the machine's few cores.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// A master on a free port with a home of its own; ended, with its home, on drop.
pub(crate) struct Master {
    port: u16,
    home: PathBuf,
    process: Option<Child>,
    _alone: MutexGuard<'static, ()>,
}

/// A process that is killed on drop.
pub(crate) struct Running(pub(crate) Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn installed() -> bool {
    ["/usr/bin/rosmaster", "/usr/bin/rostopic", "/usr/bin/rosbag"]
        .iter()
        .all(|tool| Path::new(tool).exists())
}

pub(crate) fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port()
}

pub(crate) fn wait_until(limit: Duration, mut done: impl FnMut() -> bool) -> bool {
    let end = Instant::now() + limit;
    while Instant::now() < end {
        if done() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    done()
}

impl Master {
    /// Starts a master; nothing, with a message, where ROS is not installed.
    pub(crate) fn start() -> Option<Self> {
        if !installed() {
            let required = std::env::var_os("NEEDLE_STEER_REQUIRE_ROS").is_some();
            assert!(
                !required,
                "ROS 1 is required and not installed: run scripts/setup"
            );
            eprintln!("skipped: ROS 1 is not installed (scripts/setup installs it)");
            return None;
        }
        let alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let port = free_port();
        let home = std::env::temp_dir().join(format!("rosbridge-{}-{port}", std::process::id()));
        std::fs::create_dir_all(home.join("log")).unwrap();
        let mut master = Self {
            port,
            home,
            process: None,
            _alone: alone,
        };
        master.launch();
        Some(master)
    }

    /// Starts the process, also again after [`kill`](Self::kill).
    pub(crate) fn launch(&mut self) {
        let process = self
            .command("rosmaster")
            .args(["--core", "--port", &self.port.to_string()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        self.process = Some(process);
        let port = self.port;
        let up = wait_until(Duration::from_secs(20), || {
            std::net::TcpStream::connect(("127.0.0.1", port)).is_ok()
        });
        assert!(up, "the master does not start");
    }

    pub(crate) fn kill(&mut self) {
        if let Some(mut process) = self.process.take() {
            process.kill().unwrap();
            process.wait().unwrap();
        }
    }

    pub(crate) fn home(&self) -> &Path {
        &self.home
    }

    /// Puts a process on this master.
    pub(crate) fn environment(&self, command: &mut Command) {
        command
            .env("ROS_MASTER_URI", format!("http://127.0.0.1:{}/", self.port))
            .env("ROS_IP", "127.0.0.1")
            .env_remove("ROS_HOSTNAME")
            .env_remove("ROS_NAMESPACE")
            .env("ROS_HOME", &self.home)
            .env("ROS_LOG_DIR", self.home.join("log"))
            .env("PYTHONUNBUFFERED", "1")
            .current_dir(&self.home);
    }

    /// One of ROS's tools.
    pub(crate) fn command(&self, tool: &str) -> Command {
        let mut command = Command::new(format!("/usr/bin/{tool}"));
        self.environment(&mut command);
        command
    }

    /// Runs a tool that ends by itself, for at most `seconds`.
    pub(crate) fn run(&self, seconds: u64, tool: &str, arguments: &[&str]) -> Output {
        let mut command = self.command("timeout");
        command.args(["-s", "INT", "-k", "5", &seconds.to_string()]);
        command
            .arg(format!("/usr/bin/{tool}"))
            .args(arguments)
            .output()
            .unwrap()
    }

    /// Standard output of a tool.
    pub(crate) fn output(&self, seconds: u64, tool: &str, arguments: &[&str]) -> String {
        let output = self.run(seconds, tool, arguments);
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    /// A Python script with ROS's client library.
    pub(crate) fn python(&self, script: &str) -> Running {
        let child = self
            .command("python3")
            .args(["-c", script])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        Running(child)
    }
}

impl Drop for Master {
    fn drop(&mut self) {
        self.kill();
        let _ = std::fs::remove_dir_all(&self.home);
    }
}
