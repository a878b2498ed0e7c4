//! A run exported to the formats of others, opened by their own readers.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{SystemTime, UNIX_EPOCH};

use super::{folder, needle_steer};

/// A short run with images; the file of its log.
fn run(place: &Path) -> PathBuf {
    let out = place.join("run");
    let ran = needle_steer(&[
        "run",
        "--set",
        "target.depth_mm=8",
        "--set",
        "target.offset_mm=0.2",
        "--out",
        out.to_str().unwrap(),
    ]);
    assert!(ran.status.success(), "{ran:?}");
    out.join("run.mcap")
}

fn export(log: &Path, to: &str, out: &Path) -> Output {
    let (log, out) = (log.to_str().unwrap(), out.to_str().unwrap());
    needle_steer(&["export", log, "--to", to, "--out", out])
}

fn unix_s() -> f64 {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    since_epoch.as_secs_f64()
}

#[test]
fn readers_of_others_open_what_is_exported() {
    let Some(python) = std::env::var_os("NEEDLE_STEER_PEERS") else {
        assert!(
            std::env::var_os("NEEDLE_STEER_REQUIRE_IGTL").is_none(),
            "NEEDLE_STEER_PEERS names no Python"
        );
        eprintln!(
            "skipped: NEEDLE_STEER_PEERS names no Python with rosbags, mcap-ros2-support and pandas"
        );
        return;
    };
    let place = folder("export");
    let before = unix_s();
    let log = run(&place);
    let after = unix_s();
    let mut arguments = vec![log.clone()];
    for (to, name) in [
        ("rosbag1", "run.bag"),
        ("rosbag2", "bag"),
        ("csv", "run.csv"),
        ("parquet", "run.parquet"),
    ] {
        let out = place.join(name);
        let exported = export(&log, to, &out);
        assert!(exported.status.success(), "{exported:?}");
        arguments.push(out);
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peers/exports.py");
    let read = Command::new(python)
        .arg(script)
        .args(&arguments)
        .args([before.to_string(), after.to_string()])
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&read.stderr);
    assert!(read.status.success(), "{told}");
    eprintln!("{told}");
}

#[test]
fn what_cannot_be_exported_is_refused_and_leaves_nothing() {
    let place = folder("export-refused");
    let (text, out) = (place.join("text.mcap"), place.join("out.bag"));
    std::fs::write(&text, "no log").unwrap();
    for to in ["rosbag1", "rosbag2", "csv", "parquet"] {
        let refused = export(&text, to, &out);
        assert_eq!(refused.status.code(), Some(2), "{refused:?}");
        let told = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(
            told.contains("text.mcap") && told.contains("a text file"),
            "{told}"
        );
        assert!(!out.exists(), "{to}");
    }
    std::fs::write(&out, "mine").unwrap();
    let refused = export(&text, "csv", &out);
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    assert_eq!(std::fs::read(&out).unwrap(), b"mine");
}

/// A killed process leaves a log without its end.
#[test]
fn a_log_that_breaks_off_is_exported_as_far_as_it_goes() {
    let place = folder("export-cut");
    let log = run(&place);
    let bytes = std::fs::read(&log).unwrap();
    let cut = place.join("cut.mcap");
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    for (to, name) in [
        ("rosbag1", "a.bag"),
        ("rosbag2", "b"),
        ("csv", "c.csv"),
        ("parquet", "d.pq"),
    ] {
        let exported = export(&cut, to, &place.join(name));
        let told = String::from_utf8_lossy(&exported.stderr).into_owned();
        assert!(exported.status.success(), "{told}");
        assert!(told.contains("breaks off"), "{told}");
    }
}
