//! A whole run watched and commanded by an independent implementation.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A run that is served at a free port, and the port.
struct Served {
    child: Child,
    port: String,
    rest: std::thread::JoinHandle<String>,
}

impl Served {
    fn start(name: &str, arguments: &[&str]) -> Self {
        let place = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("igtl-{name}"));
        if place.exists() {
            std::fs::remove_dir_all(&place).unwrap();
        }
        std::fs::create_dir_all(&place).unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_needle-steer"))
            .args(["run", "--json", "--igtl=127.0.0.1:0", "--out", "x"])
            .args(arguments)
            .current_dir(place)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap());
        let mut told = String::new();
        let port = loop {
            let mut line = String::new();
            assert!(lines.read_line(&mut line).unwrap() > 0, "{told}");
            if let Some(port) = line.trim().strip_prefix("OpenIGTLink: 127.0.0.1:") {
                break port.to_owned();
            }
            told.push_str(&line);
        };
        let rest = std::thread::spawn(move || {
            let _ = lines.read_to_string(&mut told);
            told
        });
        Self { child, port, rest }
    }

    /// What the run printed, when it has ended by itself.
    fn end(mut self) -> serde_json::Value {
        let mut out = String::new();
        let mut stdout = self.child.stdout.take().unwrap();
        stdout.read_to_string(&mut out).unwrap();
        self.child.wait().unwrap();
        let told = self.rest.join().unwrap();
        serde_json::from_str(&out).unwrap_or_else(|error| panic!("{error}: {out}\n{told}"))
    }
}

/// A Python with pyigtl, or why there is none.
fn python() -> Option<std::ffi::OsString> {
    let python = std::env::var_os("NEEDLE_STEER_PEERS");
    if python.is_none() {
        assert!(
            std::env::var_os("NEEDLE_STEER_REQUIRE_IGTL").is_none(),
            "NEEDLE_STEER_PEERS names no Python with pyigtl"
        );
        eprintln!("skipped: NEEDLE_STEER_PEERS names no Python with pyigtl");
    }
    python
}

fn conversation(name: &str, arguments: &[&str], more: &[&str]) {
    let Some(python) = python() else {
        return;
    };
    let served = Served::start(
        name,
        &[
            &["--set", "igtl.autostart=false", "--set", "igtl.stay=false"],
            arguments,
        ]
        .concat(),
    );
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/slicer.py");
    let played = Command::new(python)
        .arg(script)
        .arg(&served.port)
        .args(more)
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&played.stderr).into_owned();
    if !played.status.success() {
        let mut served = served;
        served.child.kill().unwrap();
        panic!("{told}\n{}", served.rest.join().unwrap());
    }
    eprintln!("{told}");
    let summary = served.end();
    assert_eq!(summary["ended"], "interrupted", "{summary}");
}

#[test]
fn pyigtl_watches_a_run_and_commands_it() {
    conversation("shape", &["--sensor", "shape"], &[]);
}

#[test]
fn pyigtl_sees_the_images_of_a_run_in_version_3() {
    conversation("images", &["--set", "igtl.version=3"], &["images"]);
}
