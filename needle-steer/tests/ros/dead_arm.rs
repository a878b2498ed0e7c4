//! An arm whose link dies is not shown as alive, and no insertion starts on it.

use std::io::{BufRead, BufReader};
use std::time::Duration;

use crate::master::{Master, Running, wait_until};
use crate::{BINARY, among_others, call, nodes, start};

/// The Viper's emulated controller at the start of the default insertion, and its ports.
fn controller(master: &Master, ports: [&str; 2]) -> (Running, [String; 2]) {
    let output = std::process::Command::new(BINARY)
        .args(["run", "--dry-run"])
        .output()
        .unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    let (_, rest) = text.split_once("joints [").unwrap();
    let (list, _) = rest.split_once(']').unwrap();
    let joints = format!("--joints-deg={}", list.replace(", ", ","));
    let [motion, state] = ports;
    let mut process = start(
        master,
        &[
            "emulate",
            "viper",
            "--motion-port",
            motion,
            "--state-port",
            state,
            &joints,
        ],
    );
    let mut lines = BufReader::new(process.0.stdout.take().unwrap()).lines();
    let ports = [(); 2].map(|()| {
        let line = lines.next().unwrap().unwrap();
        line.rsplit(':').next().unwrap().to_owned()
    });
    (process, ports)
}

/// Messages of `joint_states` within 3 s.
fn readings(master: &Master) -> usize {
    let text = master.output(
        3,
        "rostopic",
        &["echo", "-n", "20", "/joint_states/header/seq"],
    );
    text.lines().filter(|line| line.trim() == "---").count()
}

#[test]
fn a_dead_arm_is_not_shown_as_alive_and_start_says_why_not() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let (emulator, [motion, state]) = controller(&master, ["0", "0"]);
    let ports = [
        format!("viper.motion_port={motion}"),
        format!("viper.state_port={state}"),
    ];
    let mut run = start(
        &master,
        &[
            "run",
            "--backend",
            "viper",
            "--sensor",
            "shape",
            "--set",
            "viper.emulate=false",
            "--set",
            "viper.host='127.0.0.1'",
            "--set",
            &ports[0],
            "--set",
            &ports[1],
            "--set",
            "ros.publish=true",
            "--set",
            "ros.autostart=false",
        ],
    );
    let up = wait_until(Duration::from_secs(20), || {
        let services = master.output(10, "rosservice", &["list"]);
        services.contains("/needle_steer/start")
    });
    assert!(up, "{}", nodes(&master));
    assert!(readings(&master) > 10, "a live arm is shown");
    drop(emulator);
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(readings(&master), 0, "a dead arm is shown as alive");
    let diagnostics = || master.output(10, "rostopic", &["echo", "-n", "1", "/diagnostics"]);
    let told = wait_until(Duration::from_secs(10), || {
        diagnostics().contains("the arm does not report")
    });
    assert!(told, "{}", diagnostics());
    let (started, answer) = call(&master, "/needle_steer/start");
    assert!(!started && answer.contains("viper"), "{answer}");
    assert!(run.0.try_wait().unwrap().is_none(), "the node stays");
    // Back on its ports, it is shown again.
    let _again = controller(&master, [&motion, &state]);
    let back = wait_until(Duration::from_secs(20), || readings(&master) > 10);
    assert!(back, "{}", diagnostics());
}
