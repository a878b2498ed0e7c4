//! An electromagnetic tip that another process measures closes the loop, and what becomes of a run
//! whose tracker falls silent.

use std::path::Path;
use std::process::Stdio;

use needle_steer::{config, rig};

use crate::peers::{Served, script};

/// The tracker's frame in World: origin \[mm\] and roll, pitch, yaw \[deg\].
const PLACE: [&str; 6] = ["300", "-200", "100", "10", "-20", "130"];

/// A stage in front of the entry and an aligned target, as a file.
fn stage(name: &str) -> String {
    let urdf = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/urdf/stage.urdf");
    let sets = [
        format!("arm.urdf={urdf:?}"),
        "arm.tip_link=needle_base".to_owned(),
        "arm.mechanism=true".to_owned(),
        "target.kind=aligned".to_owned(),
        "target.depth_mm=40".to_owned(),
        "run.sensor=em".to_owned(),
    ];
    let config = rig::placed(&config::load(None, &sets).unwrap()).unwrap();
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.toml"));
    std::fs::write(&file, toml::to_string(&config).unwrap()).unwrap();
    file.to_str().unwrap().to_owned()
}

/// Runs with `tracker.py` as the tracker, a server like PLUS where there is a `port`; nothing where
/// there is no such peer.
fn run(name: &str, port: Option<u16>, more: &[&str]) -> Option<serde_json::Value> {
    let mut peer = script("tracker.py")?;
    let [x, y, z, roll, pitch, yaw] = PLACE;
    let sets = [
        format!("tracker.position_mm=[{x},{y},{z}]"),
        format!("tracker.rpy_deg=[{roll},{pitch},{yaw}]"),
        "igtl.autostart=false".to_owned(),
        "igtl.stay=false".to_owned(),
        "igtl.poses_hz=50".to_owned(),
    ];
    let (file, serve) = (stage(name), "--igtl=127.0.0.1:0");
    let tracker = port.map_or("--tracker".to_owned(), |port| {
        format!("--tracker=127.0.0.1:{port}")
    });
    let mut arguments = vec![file.as_str(), serve, &tracker];
    for set in &sets {
        arguments.extend(["--set", set]);
    }
    let served = Served::start(name, "OpenIGTLink: 127.0.0.1:", &arguments);
    let played = peer
        .arg(&served.port)
        .arg(port.unwrap_or(0).to_string())
        .args(PLACE)
        .args(more)
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&played.stderr).into_owned();
    eprintln!("{told}{}", String::from_utf8_lossy(&played.stdout));
    let summary = served.end();
    assert!(played.status.success(), "{told}\n{summary}");
    Some(summary)
}

fn passes(summary: &serde_json::Value) {
    assert_eq!(summary["ended"], "target passed", "{summary}");
    let off = summary["true_error_mm"].as_f64().unwrap();
    eprintln!("{off:.3} mm off");
    // In process, with noise alike, it is below 0.2 mm (tests/src/devices.rs).
    assert!(off < 0.3, "{summary}");
}

/// A port that is free now.
fn free_port() -> u16 {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().port()
}

#[test]
fn a_tip_from_a_program_that_connects_closes_the_loop() {
    if let Some(summary) = run("tracker-client", None, &[]) {
        passes(&summary);
    }
}

#[test]
fn a_tip_from_a_server_closes_the_loop_and_a_gap_is_waited_for() {
    let gap = ["gap=5"];
    if let Some(summary) = run("tracker-server", Some(free_port()), &gap) {
        passes(&summary);
    }
}

#[test]
fn a_tracker_that_falls_silent_stops_the_run_and_is_named() {
    if let Some(summary) = run("tracker-silent", None, &["silent=5"]) {
        let ended = summary["ended"].as_str().unwrap();
        assert!(
            ended.contains("TRANSFORM of `NeedleTipToTracker`"),
            "{summary}"
        );
        assert_eq!(summary["cause"], "measurements_late", "{summary}");
    }
}
