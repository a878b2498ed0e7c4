//! Lockstep over a real master: the contract of an arm, and whole insertions, in two nodes.
//!
//! Each test runs in a process of its own, with its master in the environment.

mod contract;
mod insertions;
mod ways_out;

#[path = "../../../rosbridge/tests/ros/master.rs"]
#[expect(
    dead_code,
    clippy::disallowed_methods,
    reason = "shared with tests that use more of it; waits for processes"
)]
mod master;

use std::process::{Command, Stdio};

use master::Master;

/// Says to a child that it has a master.
const CHILD: &str = "NEEDLE_STEER_TEST_CHILD";

/// Runs the test `name` once more in a child with a private master; false in that child, which
/// then does the work.
fn is_parent_of(name: &str) -> bool {
    if std::env::var_os(CHILD).is_some() {
        return false;
    }
    let Some(master) = Master::start() else {
        return true;
    };
    let mut command = Command::new(std::env::current_exe().unwrap());
    master.environment(&mut command);
    let output = command
        .args(["--exact", name, "--nocapture", "--test-threads=1"])
        .env(CHILD, "1")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    println!("{}", text(&output.stdout));
    assert!(
        output.status.success(),
        "{}{}",
        text(&output.stdout),
        text(&output.stderr)
    );
    true
}
