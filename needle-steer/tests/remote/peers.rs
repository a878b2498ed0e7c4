//! Whole runs watched and commanded by independent implementations.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A run that is served at a free port, and the port.
pub(crate) struct Served {
    child: Child,
    pub(crate) port: String,
    rest: std::thread::JoinHandle<String>,
}

impl Served {
    /// A run that says where it is served after `said`.
    pub(crate) fn start(name: &str, said: &str, arguments: &[&str]) -> Self {
        let place = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("remote-{name}"));
        if place.exists() {
            std::fs::remove_dir_all(&place).unwrap();
        }
        std::fs::create_dir_all(&place).unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_needle-steer"))
            .args(["run", "--json", "--out", "x"])
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
            if let Some(port) = line.trim().strip_prefix(said) {
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
    pub(crate) fn end(mut self) -> serde_json::Value {
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

/// Debian's reference library in a program of ours, made anew; nothing where it is missing.
fn reference() -> Option<Command> {
    const INCLUDE: &str = "/usr/include/openigtlink";
    let program = Path::new(env!("CARGO_TARGET_TMPDIR")).join("remote-reference");
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/reference.cxx");
    let made = Path::new(INCLUDE).is_dir().then(|| {
        Command::new("c++")
            .args(["-O1", "-w", "-I", INCLUDE, source, "-lOpenIGTLink", "-o"])
            .arg(&program)
            .status()
    });
    if let Some(Ok(status)) = made {
        assert!(status.success());
        return Some(Command::new(program));
    }
    assert!(
        std::env::var_os("NEEDLE_STEER_REQUIRE_IGTL").is_none(),
        "libopenigtlink-dev or a C++ compiler is missing"
    );
    eprintln!("skipped: libopenigtlink-dev or a C++ compiler is missing");
    None
}

/// A peer's program that is a script of Python.
pub(crate) fn script(name: &str) -> Option<Command> {
    let mut command = Command::new(python()?);
    command.arg(format!("{}/tests/peers/{name}", env!("CARGO_MANIFEST_DIR")));
    Some(command)
}

/// Plays a peer against a run that waits for its start.
fn conversation(
    name: &str,
    peer: Option<Command>,
    [kind, said]: [&str; 2],
    arguments: &[&str],
    more: &[&str],
) {
    let Some(mut peer) = peer else {
        return;
    };
    let serve = format!("--{kind}=127.0.0.1:0");
    let (autostart, stay) = (
        format!("{kind}.autostart=false"),
        format!("{kind}.stay=false"),
    );
    let mut all = vec![serve.as_str(), "--set", &autostart, "--set", &stay];
    all.extend(arguments);
    let mut served = Served::start(name, said, &all);
    let played = peer
        .arg(&served.port)
        .args(more)
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&played.stderr).into_owned();
    if !played.status.success() {
        served.child.kill().unwrap();
        panic!("{told}\n{}", served.rest.join().unwrap());
    }
    eprintln!("{told}");
    let summary = served.end();
    let ended = summary["ended"].as_str().unwrap_or_default();
    assert!(ended == "interrupted" || ended == "retracted", "{summary}");
}

const IGTL: [&str; 2] = ["igtl", "OpenIGTLink: 127.0.0.1:"];
#[cfg(feature = "live")]
const LIVE: [&str; 2] = ["live", "live view: ws://127.0.0.1:"];

#[test]
fn pyigtl_watches_a_run_and_commands_it() {
    let peer = script("slicer.py");
    conversation("igtl-shape", peer, IGTL, &["--sensor", "shape"], &[]);
}

#[test]
fn pyigtl_sees_the_images_of_a_run_in_version_3() {
    let arguments = ["--set", "igtl.version=3"];
    conversation(
        "igtl-images",
        script("slicer.py"),
        IGTL,
        &arguments,
        &["images"],
    );
}

#[test]
fn the_reference_library_watches_a_run_and_commands_it() {
    let arguments = ["--sensor", "shape"];
    conversation("igtl-reference", reference(), IGTL, &arguments, &[]);
}

#[test]
#[cfg(feature = "live")]
fn a_websocket_client_subscribes_calls_every_service_and_fetches_meshes() {
    // An arm whose description names a mesh.
    let package = Path::new(env!("CARGO_TARGET_TMPDIR")).join("drawn_arm");
    std::fs::create_dir_all(package.join("meshes")).unwrap();
    let urdf = package.join("arm.urdf");
    let plain = include_str!("../../../robots/urdf/viper_s650.urdf");
    let link = "<link name=\"drawn\"><visual><geometry><mesh filename=\"package://drawn_arm/meshes/a.stl\"/>\
                </geometry></visual></link><joint name=\"drawn\" type=\"fixed\"><parent link=\"tool0\"/>\
                <child link=\"drawn\"/></joint></robot>";
    std::fs::write(&urdf, plain.replace("</robot>", link)).unwrap();
    std::fs::write(package.join("meshes/a.stl"), "solid of a test").unwrap();
    let set = format!("arm.urdf={:?}", urdf.to_str().unwrap());
    let mesh = ["images", "mesh=package://drawn_arm/meshes/a.stl"];
    let peer = script("foxglove.py");
    conversation("live-images", peer, LIVE, &["--set", &set], &mesh);
}
