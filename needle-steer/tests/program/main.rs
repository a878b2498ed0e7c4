//! The program at its command line, in processes of its own: what it says, writes, refuses and leaves.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::disallowed_methods,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "live processes: tests wait, a failed step is a failed test; \
              images are small"
)]

mod arms;
mod calibrate;
mod cli;
#[cfg(unix)]
mod dead_man;
mod dry_run;
#[cfg(unix)]
mod example;
mod export;
mod first_day;
mod lab;
mod paused;
#[cfg(unix)]
mod results;
mod track;
#[cfg(unix)]
mod withdraw;

use std::path::{Path, PathBuf};
#[cfg(unix)]
use std::process::Child;
use std::process::{Command, Output, Stdio};

const BIN: &str = env!("CARGO_BIN_EXE_needle-steer");

/// The program, where tests may write, without a keyboard.
fn program() -> Command {
    let mut command = Command::new(BIN);
    command
        .current_dir(env!("CARGO_TARGET_TMPDIR"))
        .stdin(Stdio::null());
    command
}

/// `emulate viper` at ports that the system chooses.
fn emulator() -> Command {
    let mut command = program();
    command.args(["emulate", "viper", "--motion-port=0", "--state-port=0"]);
    command
}

/// Sends Ctrl-C, and waits for the end.
#[cfg(unix)]
fn interrupt(child: Child) -> Output {
    let pid = child.id().to_string();
    let sent = Command::new("kill").args(["-INT", &pid]).status().unwrap();
    assert!(sent.success());
    child.wait_with_output().unwrap()
}

fn needle_steer(arguments: &[&str]) -> Output {
    program().args(arguments).output().unwrap()
}

/// A folder of this test's own, empty.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if folder.exists() {
        std::fs::remove_dir_all(&folder).unwrap();
    }
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn stdout(output: &Output) -> String {
    words(&output.stdout)
}

fn stderr(output: &Output) -> String {
    words(&output.stderr)
}

fn words(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn json(output: &Output) -> serde_json::Value {
    assert!(!output.stdout.is_empty(), "{}", stderr(output));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Joint positions that a dry run reports \[rad\].
fn joints_of(output: &Output) -> [f64; 6] {
    let message = stderr(output);
    let line = message
        .lines()
        .find(|line| line.starts_with("joints ["))
        .unwrap_or_else(|| panic!("no joints in {message}"));
    let (_, rest) = line.split_once('[').unwrap();
    let (list, _) = rest.split_once(']').unwrap();
    let values: Vec<f64> = list
        .split(", ")
        .map(|x| x.parse::<f64>().unwrap().to_radians())
        .collect();
    values.try_into().unwrap()
}

/// Largest difference of two joints' positions.
fn apart(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    let apart = a.iter().zip(b).map(|(a, b)| (a - b).abs());
    apart.fold(0.0, f64::max)
}
