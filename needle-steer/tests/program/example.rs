//! A newcomer's first commands: examples that other commands read, pages that are shown.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use super::{BIN, folder, words};

/// Runs a line as a shell would, in `place`.
fn shell(place: &Path, line: &str) -> Output {
    let bin = Path::new(BIN).parent().unwrap().display();
    Command::new("sh")
        .args(["-c", &format!("PATH={bin}:$PATH; {line}")])
        .current_dir(place)
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

/// The output of a line that succeeds.
fn done(place: &Path, line: &str) -> String {
    let output = shell(place, line);
    assert!(output.status.success(), "{line}: {}", words(&output.stderr));
    words(&output.stdout) + &words(&output.stderr)
}

/// The commands that an example names.
fn next(told: &str) -> Vec<&str> {
    let lines = told.lines().map(str::trim);
    lines
        .filter(|line| line.starts_with("needle-steer "))
        .collect()
}

#[test]
fn images_calibrate_and_track_as_they_say() {
    let place = folder("example-images");
    let told = done(&place, "needle-steer example images samples");
    let [calibrate, track] = next(&told)[..] else {
        panic!("{told}");
    };
    let calibrated = done(&place, calibrate);
    assert!(
        calibrated.contains("15 pairs, 0 rejections"),
        "{calibrated}"
    );
    let tracked = done(&place, &format!("{track} --json"));
    let summary: serde_json::Value =
        serde_json::from_str(tracked.lines().find(|line| line.starts_with('{')).unwrap()).unwrap();
    let [frames, found] = ["frames", "tracked"].map(|key| summary[key].as_u64().unwrap());
    // No needle is in sight in the first pair.
    assert!(frames > 30 && found + 2 >= frames, "{summary}");
    let again = shell(&place, "needle-steer example images samples");
    assert_eq!(again.status.code(), Some(2));
    assert!(
        words(&again.stderr).contains("not empty"),
        "{}",
        words(&again.stderr)
    );
}

#[test]
fn recordings_identify_a_needle_that_predicts_another() {
    let place = folder("example-recordings");
    let told = done(&place, "needle-steer example recordings samples");
    let [estimate, validate] = next(&told)[..] else {
        panic!("{told}");
    };
    let estimated = done(&place, estimate);
    assert!(!estimated.contains("NOT IDENTIFIED"), "{estimated}");
    let validated = done(&place, validate);
    assert!(validated.contains("slope"), "{validated}");
}

#[test]
fn a_run_shows_its_page_or_says_where_it_is() {
    let place = folder("example-open");
    let browser = place.join("bin/xdg-open");
    std::fs::create_dir(place.join("bin")).unwrap();
    std::fs::write(
        &browser,
        "#!/bin/sh\necho \"$1\" > shown.part; mv shown.part shown\n",
    )
    .unwrap();
    std::fs::set_permissions(&browser, PermissionsExt::from_mode(0o755)).unwrap();
    let run = "needle-steer run --open --sensor shape --set target.kind=aligned --out";
    done(
        &place,
        &format!("PATH={}:$PATH; {run} first", place.join("bin").display()),
    );
    let shown = place.join("shown");
    while !shown.exists() {
        std::thread::yield_now();
    }
    let shown = std::fs::read_to_string(shown).unwrap();
    let page = place.join("first/report.html").canonicalize().unwrap();
    assert_eq!(shown.trim(), page.display().to_string());
    // Where nothing opens pages: the run counts all the same.
    let told = done(
        &place,
        &format!("PATH=$PWD; {BIN} {} second", &run["needle-steer ".len()..]),
    );
    assert!(told.contains("open it by hand"), "{told}");
    assert!(place.join("second/report.html").exists());
}
