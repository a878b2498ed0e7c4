//! Results are written by one process, never over others, and outlive Ctrl-C and a full disk.

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;

use super::{BIN, folder, interrupt, stderr};

/// Bytes of a log that holds steps: what describes the arm before them takes a quarter.
const BEGUN: u64 = 100_000;
/// A run of a second of computing.
const SHORT: [&str; 11] = [
    "run",
    "--json",
    "--sensor",
    "shape",
    "--law",
    "none",
    "--set",
    "target.kind=aligned",
    "--set",
    "target.depth_mm=20",
    "--set=run.check_reach=false",
];
/// A run that lasts until it is interrupted.
const ENDLESS: [&str; 6] = [
    "run",
    "--json",
    "--set",
    "run.insertion_speed_mm_s=0.001",
    "--set",
    "run.max_duration_s=86400",
];

fn start(place: &Path, arguments: &[&str]) -> Child {
    piped(Command::new(BIN).args(arguments), place)
}

/// Started where no file may grow beyond `kib`: what a full disk looks like to a program.
fn start_on_small_disk(place: &Path, kib: u32, arguments: &[&str]) -> Child {
    let script = format!("trap '' XFSZ; ulimit -f {}; exec \"$0\" \"$@\"", 2 * kib);
    let mut shell = Command::new("sh");
    piped(shell.args(["-c", &script, BIN]).args(arguments), place)
}

fn piped(command: &mut Command, place: &Path) -> Child {
    let piped = command.stdin(Stdio::null()).stdout(Stdio::piped());
    piped
        .stderr(Stdio::piped())
        .current_dir(place)
        .spawn()
        .unwrap()
}

fn needle_steer(place: &Path, arguments: &[&str]) -> Output {
    start(place, arguments).wait_with_output().unwrap()
}

fn wait_for(mut there: impl FnMut() -> bool) {
    while !there() {
        std::thread::yield_now();
    }
}

fn json(text: &[u8]) -> Value {
    serde_json::from_slice(text).unwrap()
}

fn grown(file: &Path, bytes: u64) -> bool {
    file.metadata().is_ok_and(|file| file.len() > bytes)
}

#[test]
fn a_second_run_into_the_folder_of_a_running_one_is_refused() {
    let place = folder("results-one-folder");
    let first = start(&place, &[&ENDLESS[..], &["--out", "x"]].concat());
    // As soon as the first one has the folder, before it has written anything.
    wait_for(|| place.join("x/run.mcap").exists());
    let second = needle_steer(&place, &[&SHORT[..], &["--out", "x"]].concat());
    assert_eq!(second.status.code(), Some(2), "{}", stderr(&second));
    assert!(stderr(&second).contains("another"), "{}", stderr(&second));
    assert!(second.stdout.is_empty());
    wait_for(|| grown(&place.join("x/run.mcap"), BEGUN));
    let third = needle_steer(&place, &[&SHORT[..], &["--out", "x"]].concat());
    assert_eq!(third.status.code(), Some(2), "{}", stderr(&third));
    let first = interrupt(first);
    assert_eq!(json(&first.stdout)["log_complete"], true);
    let replayed = needle_steer(&place, &["replay", "x/run.mcap", "--json"]);
    assert_eq!(json(&replayed.stdout)["complete"], true);
}

#[test]
fn runs_at_the_same_time_take_a_folder_each() {
    let place = folder("results-next-folder");
    let runs: Vec<Child> = (0..3).map(|_| start(&place, &SHORT)).collect();
    let mut folders: Vec<String> = runs
        .into_iter()
        .map(|run| {
            let summary = json(&run.wait_with_output().unwrap().stdout);
            let folder = summary["out"].as_str().unwrap().to_owned();
            let written = std::fs::read(place.join(&folder).join("summary.json")).unwrap();
            assert_eq!(json(&written)["out"], summary["out"]);
            folder
        })
        .collect();
    folders.sort();
    folders.dedup();
    assert_eq!(folders.len(), 3, "{folders:?}");
}

#[test]
fn a_configuration_in_the_folder_of_the_results_is_not_written_over() {
    let place = folder("results-own-config");
    let text = "[run]\nseed = 3\n";
    std::fs::write(place.join("config.toml"), text).unwrap();
    let output = needle_steer(
        &place,
        &[&SHORT[..], &["config.toml", "--out", "."]].concat(),
    );
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("config.toml"));
    let kept = std::fs::read_to_string(place.join("config.toml")).unwrap();
    assert_eq!(kept, text);
    assert_eq!(std::fs::read_dir(&place).unwrap().count(), 1);
}

#[test]
fn a_refused_target_leaves_no_folder() {
    let place = folder("results-refused");
    let output = needle_steer(
        &place,
        &["run", "--set", "target.offset_mm=60", "--out", "x"],
    );
    assert!(!output.status.success());
    // A verdict may be kept; half a log may not.
    let files = std::fs::read_dir(place.join("x")).map_or(0, Iterator::count);
    assert!(files == 0 || place.join("x/summary.json").exists());
    assert!(files > 0 || !place.join("x").exists());
}

#[test]
fn a_full_disk_ends_no_insertion_and_takes_no_verdict() {
    let place = folder("results-full-disk");
    let run = start_on_small_disk(&place, 100, &[&SHORT[..], &["--out", "x"]].concat());
    let output = run.wait_with_output().unwrap();
    let summary = json(&output.stdout);
    assert_eq!(summary["ended"], "target passed", "{}", stderr(&output));
    assert_eq!(summary["log_complete"], false);
    assert_eq!(output.status.code(), Some(1), "a log is missing");
    let kept = std::fs::read(place.join("x/summary.json")).unwrap();
    assert_eq!(json(&kept)["log_complete"], false);
    // Nothing is half written but the log, which says so itself.
    assert!(!place.join("x/series.csv").exists() || !stderr(&output).contains("series.csv"));
}

#[test]
fn a_verdict_nobody_can_read_is_in_the_files() {
    let place = folder("results-no-stdout");
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full");
    let output = Command::new(BIN)
        .args(SHORT)
        .args(["--out", "x"])
        .current_dir(&place)
        .stdout(full.unwrap())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let kept = std::fs::read(place.join("x/summary.json")).unwrap();
    assert_eq!(json(&kept)["ended"], "target passed");
}

#[test]
fn seeds_beyond_what_a_configuration_holds_are_refused_in_true_words() {
    let place = folder("results-seeds");
    let largest = "9223372036854775807";
    for seed in ["9223372036854775808", "18446744073709551615"] {
        let set = format!("run.seed={seed}");
        for arguments in [
            ["run", "--seed", seed],
            ["run", "--set", &set],
            ["reproduce", "--seed", seed],
        ] {
            let output = needle_steer(&place, &arguments);
            let said = stderr(&output);
            assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
            assert!(said.contains(largest), "{arguments:?}: {said}");
            assert!(!said.contains("string"), "{arguments:?}: {said}");
        }
    }
    let output = needle_steer(&place, &[&SHORT[..], &["--seed", largest]].concat());
    assert_eq!(
        json(&output.stdout)["seed"],
        i64::MAX,
        "{}",
        stderr(&output)
    );
    let beyond = [
        "reproduce",
        "--seed",
        largest,
        "--runs",
        "18446744073709551615",
    ];
    let output = needle_steer(&place, &beyond);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("the last seed is above"));
}

/// One experiment without control, on the fast sensor.
const E1: [&str; 6] = [
    "reproduce",
    "--experiments",
    "e1",
    "--sensor",
    "shape",
    "--json",
];

#[test]
fn reproduce_heeds_every_change_or_refuses_it() {
    let place = folder("results-heeded");
    for (change, reason) in [
        ("run.seed=5", "--seed"),
        ("run.law=hybrid", "--law"),
        ("run.phantom=harsh", "--phantom"),
        ("run.sensor=images", "--sensor"),
        ("run.check_reach=true", "out of reach"),
        ("target.offset_mm=3", "the paper"),
        ("target.kind=stereo", "the paper"),
    ] {
        let output = needle_steer(
            &place,
            &[&E1[..], &["--set", change, "--out", "x"]].concat(),
        );
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{change}: {said}");
        assert!(said.contains(reason), "{change}: {said}");
        assert!(!place.join("x").exists());
    }
    let depth = |depth: &str| {
        let set = format!("target.depth_mm={depth}");
        let output = needle_steer(&place, &[&E1[..], &["--runs", "1", "--set", &set]].concat());
        let document = json(&output.stdout);
        assert_eq!(document["set"][0], set);
        let run = &document["experiments"][0]["runs"][0];
        run["duration_s"].as_f64().unwrap()
    };
    let (shallow, deep) = (depth("20"), depth("40"));
    assert!(deep > shallow + 15.0, "{shallow} s, {deep} s");
}

#[test]
fn an_interrupted_reproduction_keeps_its_finished_runs() {
    let place = folder("results-interrupted");
    // More runs than any memory holds.
    let runs = [
        "--runs",
        "18446744073709551615",
        "--out",
        "x",
        "--jobs",
        "1",
    ];
    let child = start(
        &place,
        &[&E1[..], &["--set", "target.depth_mm=10"], &runs].concat(),
    );
    let lines = place.join("x/runs.jsonl");
    wait_for(|| std::fs::read_to_string(&lines).is_ok_and(|text| text.lines().count() >= 2));
    let output = interrupt(child);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("interrupted"));
    let kept = json(&std::fs::read(place.join("x/reproduce.json")).unwrap());
    assert_eq!(kept, json(&output.stdout));
    let finished = kept["finished"].as_u64().unwrap();
    assert!(finished >= 2);
    let runs = kept["experiments"][0]["runs"].as_array().unwrap();
    assert_eq!(runs.len() as u64, finished);
    assert!(runs.iter().all(|run| run["ended"] != "interrupted"));
    assert!(!lines.exists());
    // Kept also from the next one.
    let again = needle_steer(&place, &[&E1[..], &["--runs", "1", "--out", "x"]].concat());
    assert_eq!(again.status.code(), Some(2), "{}", stderr(&again));
    assert!(stderr(&again).contains("reproduce.json"));
    let report = needle_steer(&place, &["report", "x/reproduce.json"]);
    assert!(report.status.success(), "{}", stderr(&report));
}

#[test]
fn a_reproduction_that_finds_the_disk_full_prints_what_it_found() {
    let place = folder("results-reproduce-full");
    let arguments = [
        "reproduce",
        "--experiments",
        "e1",
        "--sensor",
        "shape",
        "--runs",
        "3",
    ];
    let more = ["--set", "target.depth_mm=10", "--out", "x"];
    let run = start_on_small_disk(&place, 1, &[&arguments[..], &more].concat());
    let output = run.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let text = String::from_utf8(output.stdout).unwrap();
    let document = json(text.lines().last().unwrap().as_bytes());
    let runs = document["experiments"][0]["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 3, "{text}");
    assert!(!place.join("x/reproduce.json").exists());
    let lines = std::fs::read_to_string(place.join("x/runs.jsonl")).unwrap();
    assert!(!lines.is_empty());
}

#[test]
fn a_report_replaces_a_report_and_nothing_else() {
    let place = folder("results-report");
    let output = needle_steer(&place, &[&SHORT[..], &["--out", "x"]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let log = std::fs::read(place.join("x/run.mcap")).unwrap();
    let over = needle_steer(&place, &["report", "x/run.mcap", "-o", "x/run.mcap"]);
    assert_eq!(over.status.code(), Some(2), "{}", stderr(&over));
    assert_eq!(std::fs::read(place.join("x/run.mcap")).unwrap(), log);
    for _ in 0..2 {
        let page = needle_steer(&place, &["report", "x/run.mcap"]);
        assert!(page.status.success(), "{}", stderr(&page));
    }
    // Nor does an estimate write over the configuration it began from.
    std::fs::write(place.join("mine.toml"), "[run]\nseed = 2\n").unwrap();
    let own = [
        "estimate",
        "x/run.mcap",
        "--config",
        "mine.toml",
        "--out",
        "mine.toml",
    ];
    let refused = needle_steer(&place, &own);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    let kept = std::fs::read_to_string(place.join("mine.toml")).unwrap();
    assert_eq!(kept, "[run]\nseed = 2\n");
}
