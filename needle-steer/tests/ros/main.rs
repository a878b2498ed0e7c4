//! The binary as a ROS node, on a private master, with ROS's own tools as the judges.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    clippy::disallowed_methods,
    reason = "tests of live processes: they wait, tell what they skip, and fail by panicking"
)]

mod back_end;
mod dead_arm;
mod dead_man;
mod faults;
mod foreign_arm;
mod hiccup;
mod images;
mod launch;
mod lifecycle;
mod messages;
#[path = "../../../rosbridge/tests/ros/master.rs"]
mod master;
mod picture;
mod services;
mod speech;
mod targets;
#[path = "../peers/ur_robot.rs"]
mod ur_robot;
mod velocity_arm;
mod withdraw;

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::Duration;

use master::{Master, Running, wait_until};

const BINARY: &str = env!("CARGO_BIN_EXE_needle-steer");

/// Held by tests that load the machine, so that one on the wall clock can have it alone.
static MACHINE: RwLock<()> = RwLock::new(());

fn alone() -> RwLockWriteGuard<'static, ()> {
    MACHINE.write().unwrap_or_else(PoisonError::into_inner)
}

fn among_others() -> RwLockReadGuard<'static, ()> {
    MACHINE.read().unwrap_or_else(PoisonError::into_inner)
}

/// The binary on a master.
fn start(master: &Master, arguments: &[&str]) -> Running {
    let mut command = Command::new(BINARY);
    master.environment(&mut command);
    command
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped());
    Running(command.spawn().unwrap())
}

/// An insertion by the fast sensor as a node on a master, its results in `out`.
fn start_run(master: &Master, more: &[&str], out: &Path) -> Running {
    let run = ["run", "--sensor", "shape", "--set", "ros.publish=true"];
    let out = ["--out", out.to_str().unwrap()];
    start(master, &[&run[..], more, &out[..]].concat())
}

/// Waits until a process says that it is ready, in its first line. What it says later is in what comes
/// back; nobody would hear it if that were dropped.
fn ready(process: &mut Running) -> BufReader<ChildStdout> {
    let mut line = String::new();
    let mut lines = BufReader::new(process.0.stdout.take().unwrap());
    lines.read_line(&mut line).unwrap();
    assert_eq!(line, "ready\n");
    lines
}

fn wait_for_node(master: &Master, name: &str) {
    let up = wait_until(Duration::from_secs(20), || nodes(master).contains(name));
    assert!(up, "{}", nodes(master));
}

fn signal(child: &Child, name: &str) {
    let sent = Command::new("kill")
        .args([name, &child.id().to_string()])
        .status();
    assert!(sent.unwrap().success());
}

fn nodes(master: &Master) -> String {
    master.output(10, "rosnode", &["list"])
}

/// Calls a trigger: whether it was accepted, and the answer.
fn call(master: &Master, service: &str) -> (bool, String) {
    let answer = master.output(20, "rosservice", &["call", service]);
    (answer.contains("success: True"), answer)
}

/// What `/diagnostics` says of the run.
fn phase(master: &Master) -> String {
    let text = master.output(10, "rostopic", &["echo", "-n", "1", "/diagnostics"]);
    let mut lines = text.lines().skip_while(|line| !line.contains(": run\""));
    lines.nth(1).unwrap_or_default().trim().to_owned()
}
