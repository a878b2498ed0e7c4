//! The way out over ROS: after a stop in the node that stays, and after a node that was killed.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::master::{Master, Running, wait_until};
use crate::{BINARY, alone, among_others, call, nodes, phase, ready, signal, start, start_run};

fn ended(summary: &Path) -> String {
    let text = std::fs::read_to_string(summary).unwrap_or_default();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    summary["ended"].as_str().unwrap_or_default().to_owned()
}

#[test]
fn a_stopped_insertion_is_withdrawn_once_and_never_resumed() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let out = master.home().join("stopped");
    let mut run = start_run(&master, &[], &out);
    let steering = wait_until(Duration::from_mins(1), || {
        phase(&master).contains("Steering")
    });
    assert!(steering, "{}", phase(&master));
    let (stopped, answer) = call(&master, "/needle_steer/stop");
    assert!(stopped, "{answer}");
    let there = wait_until(Duration::from_secs(20), || {
        out.join("summary.json").exists()
    });
    assert!(there && ended(&out.join("summary.json")) == "interrupted");
    let (resumed, answer) = call(&master, "/needle_steer/start");
    assert!(!resumed && answer.contains("not resumed"), "{answer}");
    let (retracting, answer) = call(&master, "/needle_steer/retract");
    assert!(retracting && answer.contains("withdrawing"), "{answer}");
    // Neither while it comes out nor after.
    let (resumed, answer) = call(&master, "/needle_steer/start");
    assert!(!resumed, "{answer}");
    let summary = out.join("withdrawal-1").join("summary.json");
    let done = wait_until(Duration::from_mins(1), || summary.exists());
    assert!(
        done && ended(&summary) == "retracted",
        "{}",
        ended(&summary)
    );
    let log = out.join("withdrawal-1").join("run.mcap");
    assert!(log.metadata().unwrap().len() > 10_000);
    let (again, answer) = call(&master, "/needle_steer/retract");
    assert!(again && answer.contains("already at the start"), "{answer}");
    let (resumed, answer) = call(&master, "/needle_steer/start");
    assert!(!resumed && answer.contains("not resumed"), "{answer}");
    signal(&run.0, "-TERM");
    assert_eq!(run.0.wait().unwrap().code(), Some(1));
}

/// An insertion on the arm of the laboratory, once its log has grown; written by a process that may
/// write so many kB to a file, where `limit` says so.
fn inserting(master: &Master, out: &Path, limit: Option<u32>) -> Running {
    let limit = limit.map_or_else(String::new, |kb| format!("trap '' XFSZ; ulimit -f {kb}; "));
    let mut command = Command::new("bash");
    master.environment(&mut command);
    command
        .args(["-c", &format!("{limit}exec \"$0\" \"$@\""), BINARY])
        .args(["run", "--backend", "ros", "--sensor", "shape"])
        .args(["--set", "run.insertion_speed_mm_s=3"])
        // A busy machine must not fail; how soon silence is a fault has its own tests.
        .args(["--set", "ros.late_ms=1000"])
        .args(["--out", out.to_str().unwrap()])
        .stdin(Stdio::null())
        .stdout(Stdio::null());
    let mut run = Running(command.spawn().unwrap());
    let log = out.join("run.mcap");
    let grown = wait_until(Duration::from_mins(1), || {
        let ended = run.0.try_wait().unwrap().is_some();
        ended || log.metadata().is_ok_and(|file| file.len() > 400_000)
    });
    assert!(grown, "no log");
    run
}

/// The laboratory is another process; its arm outlives the controller's, whatever ends that.
#[test]
fn an_arm_behind_ros_is_withdrawn_by_its_log_after_kills_lost_links_and_full_disks() {
    let Some(master) = Master::start() else {
        return;
    };
    let _alone = alone();
    let mut laboratory = start(&master, &["emulate", "ros", "--set", "run.sensor=shape"]);
    let _said = ready(&mut laboratory);
    for stop in ["kill", "rosnode", "link", "disk"] {
        let out = master.home().join(stop);
        let mut run = inserting(&master, &out, (stop == "disk").then_some(500));
        let told = match stop {
            "kill" => {
                let _ = run.0.kill();
                [""; 2]
            }
            "rosnode" => {
                master.output(20, "rosnode", &["kill", "/needle_steer"]);
                ["shut down"; 2]
            }
            "link" => {
                signal(&laboratory.0, "-STOP");
                // Which of the two is due first depends on when the link went.
                ["the arm faulted", "no encoder reading"]
            }
            _ => {
                // On beyond the end of the log.
                std::thread::sleep(Duration::from_secs(2));
                let _ = Command::new("kill")
                    .args(["-INT", &run.0.id().to_string()])
                    .status();
                ["interrupted"; 2]
            }
        };
        run.0.wait().unwrap();
        if stop == "link" {
            signal(&laboratory.0, "-CONT");
            // As at a robot whose controller missed its commands.
            let (cleared, answer) = call(&master, "/needle_steer_laboratory/clear_fault");
            assert!(cleared, "{answer}");
        }
        let said = ended(&out.join("summary.json"));
        // On a busy machine the arm may have lost its velocities before: a stop of its own.
        let by_arm = said.contains("the arm faulted");
        let as_told = told.iter().any(|words| said.contains(words));
        assert!(by_arm || as_told, "{stop}: {said}");
        let log = out.join("run.mcap");
        let mut last = String::new();
        // A busy machine may miss a deadline, which stops the arm; the same command goes on.
        let out_at_last = (0..3).any(|_| {
            let mut command = Command::new(BINARY);
            master.environment(&mut command);
            let output = command
                .args(["withdraw", log.to_str().unwrap(), "--json"])
                .output()
                .unwrap();
            last = format!("{output:?}");
            output.status.success()
        });
        assert!(out_at_last, "{stop}: {last}");
        assert!(last.contains("retracted"), "{stop}: {last}");
    }
    signal(&laboratory.0, "-TERM");
    assert!(laboratory.0.wait().unwrap().success());
    let left = nodes(&master);
    assert!(!left.contains("needle_steer"), "{left}");
}
