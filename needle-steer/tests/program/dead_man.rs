//! The dead-man's switch in a terminal: a held key on a pseudo-terminal.

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rustix::fs::OFlags;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{LocalModes, tcgetattr};

use super::{BIN, folder, interrupt, stderr};

/// Bytes of a log that holds steps: what describes the arm before them takes a quarter.
const BEGUN: u64 = 100_000;

/// Both ends of a new terminal: the keyboard's, and the program's.
fn terminal() -> (File, File) {
    let keyboard = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&keyboard).unwrap();
    unlockpt(&keyboard).unwrap();
    let name = ptsname(&keyboard, Vec::new()).unwrap();
    let flags = OFlags::RDWR | OFlags::NOCTTY;
    let program = rustix::fs::open(name.as_c_str(), flags, rustix::fs::Mode::empty()).unwrap();
    (keyboard.into(), program.into())
}

fn run(place: &Path, input: Stdio, arguments: &[&str]) -> Child {
    Command::new(BIN)
        .args(["run", "--json", "--sensor", "shape", "--out", "x"])
        .args(arguments)
        .current_dir(place)
        .stdin(input)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// How far the needle's base has gone down since the first step, for every step [mm].
fn advances(place: &Path) -> Vec<f64> {
    let series = std::fs::read_to_string(place.join("x/series.csv")).unwrap();
    let advance = |line: &str| -line.split(',').nth(7).unwrap().parse::<f64>().unwrap();
    series.lines().skip(1).map(advance).collect()
}

#[test]
fn a_held_key_keeps_a_run_going_and_a_released_one_ends_it() {
    let place = folder("dead-man-key");
    let (mut keyboard, program) = terminal();
    let before = tcgetattr(&program).unwrap();
    let input = Stdio::from(program.try_clone().unwrap());
    let child = run(&place, input, &["--set", "supervisor.dead_man_ms=2000"]);
    let released = AtomicBool::new(false);
    let output = std::thread::scope(|scope| {
        scope.spawn(|| {
            let raw = || {
                !tcgetattr(&program)
                    .unwrap()
                    .local_modes
                    .contains(LocalModes::ICANON)
            };
            while !raw() {
                std::thread::sleep(Duration::from_millis(20));
            }
            // Held for three times as long as one key press lasts.
            for _ in 0..120 {
                keyboard.write_all(b" ").unwrap();
                std::thread::sleep(Duration::from_millis(50));
            }
            released.store(true, Ordering::Release);
        });
        let output = child.wait_with_output().unwrap();
        assert!(released.load(Ordering::Acquire), "{}", stderr(&output));
        output
    });
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("hold any key"));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let ended = summary["ended"].as_str().unwrap();
    assert!(ended.contains("dead-man's switch released"), "{ended}");
    let advance = *advances(&place).last().unwrap();
    // Between 6 s and 8 s at 1 mm/s, less the time before the first key.
    assert!((2.0..9.0).contains(&advance), "{advance} mm");
    // The keys were not shown, and the terminal is as it was.
    let after = tcgetattr(&program).unwrap();
    assert_eq!(before.local_modes, after.local_modes);
    rustix::io::ioctl_fionbio(&keyboard, true).unwrap();
    let mut shown = Vec::new();
    let _ = keyboard.read_to_end(&mut shown);
    assert!(!shown.contains(&b' '), "{shown:?}");
}

#[test]
fn ctrl_c_in_the_terminal_still_ends_a_run_that_waits_for_its_key() {
    let place = folder("dead-man-ctrl-c");
    let (_keyboard, program) = terminal();
    let input = Stdio::from(program.try_clone().unwrap());
    let child = run(&place, input, &["--set", "supervisor.dead_man_ms=2000"]);
    while !place
        .join("x/run.mcap")
        .metadata()
        .is_ok_and(|log| log.len() > BEGUN)
    {
        std::thread::sleep(Duration::from_millis(20));
    }
    let output = interrupt(child);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let moved = *advances(&place).last().unwrap();
    assert!(moved.abs() < 0.01, "moved {moved} mm before any key");
}

#[test]
fn a_run_that_nobody_can_keep_alive_is_refused() {
    let place = folder("dead-man-nobody");
    let dead_man = ["--set", "supervisor.dead_man_ms=500"];
    let output = run(&place, Stdio::null(), &dead_man)
        .wait_with_output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(
        stderr(&output).contains("nothing can refresh"),
        "{}",
        stderr(&output)
    );
    assert!(output.stdout.is_empty() && !place.join("x").exists());
    // Many runs in a row have nobody either.
    let campaign = "laws = [\"paper\"]\nseeds = { first = 1, count = 1 }\n\
        [[target]]\nkind = \"aligned\"\n[config.supervisor]\ndead_man_ms = 500.0\n";
    std::fs::write(place.join("c.toml"), campaign).unwrap();
    for arguments in [
        vec![
            "reproduce",
            "--set",
            "supervisor.dead_man_ms=500",
            "--out",
            "y",
        ],
        vec!["campaign", "c.toml", "--out", "y"],
    ] {
        let many = Command::new(BIN)
            .args(&arguments)
            .current_dir(&place)
            .output()
            .unwrap();
        assert_eq!(
            many.status.code(),
            Some(2),
            "{arguments:?}: {}",
            stderr(&many)
        );
        assert!(stderr(&many).contains("dead_man_ms"), "{}", stderr(&many));
        assert!(!place.join("y").exists());
    }
}
