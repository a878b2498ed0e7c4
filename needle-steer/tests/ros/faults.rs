//! The emulated laboratory's faults as commands: what a run says of each, and that it goes on when
//! they are gone.

use std::io::{BufReader, Write};
use std::process::{ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

use crate::master::{Master, Running, wait_until};
use crate::velocity_arm::waiting;
use crate::{BINARY, among_others, call, phase, ready, signal};

struct Laboratory {
    process: Running,
    orders: ChildStdin,
    _said: BufReader<ChildStdout>,
}

impl Laboratory {
    fn start(master: &Master) -> Self {
        let mut command = Command::new(BINARY);
        master.environment(&mut command);
        let child = command
            .args(["emulate", "ros", "--sensor", "shape"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut process = Running(child);
        Self {
            _said: ready(&mut process),
            orders: process.0.stdin.take().unwrap(),
            process,
        }
    }

    fn order(&mut self, order: &str) {
        writeln!(self.orders, "{order}").unwrap();
        // Longer than a silence that does not count yet.
        std::thread::sleep(Duration::from_secs(1));
    }
}

/// Calls a service until it answers so; a withdrawal on a busy machine takes its time.
fn comes_to(master: &Master, service: &str, accepted: bool, words: &str) {
    let mut answer = String::new();
    let came = wait_until(Duration::from_secs(90), || {
        let (success, text) = call(master, service);
        answer = text;
        success == accepted && answer.contains(words)
    });
    assert!(came, "{service} without `{words}`: {answer}");
}

#[test]
fn faults_of_the_laboratory_are_told_and_can_be_cleared() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let mut laboratory = Laboratory::start(&master);
    let out = master.home().join("faults");
    let mut run = waiting(&master, &["--out", out.to_str().unwrap()]);
    let start = "/needle_steer/start";
    for (orders, told) in [
        (&["e-stop"][..], "EmergencyStop"),
        // The emergency stop took the power.
        (&["release"][..], "DrivesOff"),
        (&["power on", "power off"][..], "DrivesOff"),
        (&["power on", "manual"][..], "NotAutomatic"),
        (&["automatic", "error 7"][..], "ControllerError"),
        (&["error 0", "silent"][..], "last feedback"),
        (&["speak", "late 2000"][..], "behind"),
    ] {
        for order in orders {
            laboratory.order(order);
        }
        comes_to(&master, start, false, told);
    }
    laboratory.order("late 0");
    comes_to(&master, "/needle_steer/clear_fault", true, "no fault");
    comes_to(&master, start, true, "");
    let steers = wait_until(Duration::from_secs(40), || {
        phase(&master).contains("Steering")
    });
    assert!(steers, "{}", phase(&master));
    laboratory.order("e-stop");
    let summary = out.join("summary.json");
    let ended = wait_until(Duration::from_secs(20), || summary.exists());
    assert!(ended, "{}", phase(&master));
    let text = std::fs::read_to_string(&summary).unwrap();
    assert!(text.contains("EmergencyStop"), "{text}");
    // What is done then on an arm.
    laboratory.order("release");
    laboratory.order("power on");
    comes_to(&master, "/needle_steer/retract", true, "withdrawing");
    comes_to(
        &master,
        "/needle_steer/retract",
        true,
        "already at the start",
    );
    laboratory.order("creep 1 2");
    let diagnostics = || master.output(10, "rostopic", &["echo", "-n", "1", "/diagnostics"]);
    let told = wait_until(Duration::from_secs(10), || {
        diagnostics().contains("Faulted(")
    });
    assert!(told, "{}", diagnostics());
    laboratory.order("creep 1 0");
    comes_to(&master, "/needle_steer/clear_fault", true, "no fault");
    assert!(run.0.try_wait().unwrap().is_none(), "the node stays");
    signal(&run.0, "-TERM");
    run.0.wait().unwrap();
    signal(&laboratory.process.0, "-TERM");
    assert!(laboratory.process.0.wait().unwrap().success());
}
