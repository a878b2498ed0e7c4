//! Cameras of another make: encodings, padded rows, stamps that part.

use std::io::Read;
use std::process::Stdio;
use std::time::Duration;

use crate::master::{Master, Running};
use crate::{alone, ready, signal, start};

fn other_cameras(master: &Master, form: &str) -> Running {
    let child = master
        .command("python3")
        .args(["-c", include_str!("images.py"), form])
        .stdout(Stdio::piped())
        .spawn();
    let mut cameras = Running(child.unwrap());
    ready(&mut cameras);
    cameras
}

/// A run of the back end `ros` that sees with these cameras.
fn start_run(master: &Master, name: &str) -> Running {
    let out = master.home().join(name);
    // A busy machine must not fail: how soon silence is a fault has tests of its own.
    let arguments = [
        "run",
        "--backend",
        "ros",
        "--set",
        "ros.late_ms=1000",
        "--set",
        "supervisor.image_age_ms=500",
        "--json",
        "--out",
        out.to_str().unwrap(),
        "--set",
        if name == "compressed" {
            "ros.images=compressed"
        } else {
            "ros.images=raw"
        },
        "left/image_raw:=/other/left/image_raw",
        "right/image_raw:=/other/right/image_raw",
        "left/image_raw/compressed:=/other/left/image_raw/compressed",
        "right/image_raw/compressed:=/other/right/image_raw/compressed",
    ];
    let mut command = std::process::Command::new(crate::BINARY);
    master.environment(&mut command);
    command
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    Running(command.spawn().unwrap())
}

fn end(mut run: Running) -> (String, String) {
    let (mut text, mut errors) = (String::new(), String::new());
    let stdout = &mut run.0.stdout;
    stdout.take().unwrap().read_to_string(&mut text).unwrap();
    let stderr = &mut run.0.stderr;
    stderr.take().unwrap().read_to_string(&mut errors).unwrap();
    assert_eq!(run.0.wait().unwrap().code(), Some(1), "{text}{errors}");
    (text, errors)
}

#[test]
fn images_of_other_encodings_and_padded_rows_steer() {
    let Some(master) = Master::start() else {
        return;
    };
    let _alone = alone();
    for form in ["bgr8", "mono16", "padded", "compressed"] {
        let mut laboratory = start(&master, &["emulate", "ros"]);
        let _said = ready(&mut laboratory);
        let _cameras = other_cameras(&master, form);
        let run = start_run(&master, form);
        std::thread::sleep(Duration::from_secs(12));
        signal(&run.0, "-TERM");
        let (text, errors) = end(run);
        let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(summary["ended"], "interrupted", "{form}: {text}{errors}");
        let steps = summary["steps"].as_u64().unwrap();
        assert!(steps > 100, "{form}: {text}");
        signal(&laboratory.0, "-TERM");
        laboratory.0.wait().unwrap();
    }
}

#[test]
fn what_keeps_images_from_being_pairs_is_said_before_anything_moves() {
    let Some(master) = Master::start() else {
        return;
    };
    let mut laboratory = start(&master, &["emulate", "ros"]);
    let _said = ready(&mut laboratory);
    for (form, words) in [
        (
            "yuv422",
            vec!["left/image_raw: encoding \"yuv422\"", "bgr8"],
        ),
        ("late", vec!["6.0 ms apart, more than 2 ms"]),
    ] {
        let cameras = other_cameras(&master, form);
        let (text, errors) = end(start_run(&master, form));
        for word in words {
            assert!(errors.contains(word), "{form}: {text}{errors}");
        }
        drop(cameras);
    }
    let (_, errors) = end(start_run(&master, "nothing"));
    assert!(
        errors.contains("nothing comes on left/image_raw"),
        "{errors}"
    );
}
