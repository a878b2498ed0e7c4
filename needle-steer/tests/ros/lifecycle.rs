//! A node that is killed, and one whose name another node takes: the insertion stops.

use std::io::Read;
use std::process::Stdio;
use std::time::Duration;

use crate::master::{Master, Running, wait_until};
use crate::{BINARY, among_others, call, nodes, phase};

/// An insertion on the simulated arm, once it steers; what it says on standard error is kept.
fn steering(master: &Master, out: &str) -> Running {
    let mut command = std::process::Command::new(BINARY);
    master.environment(&mut command);
    command
        .args(["run", "--sensor", "shape", "--set", "ros.publish=true"])
        .args(["--out", out])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let run = Running(command.spawn().unwrap());
    let steers = wait_until(Duration::from_secs(30), || {
        phase(master).contains("Steering")
    });
    assert!(steers, "{}", phase(master));
    run
}

/// The run has ended by itself, with its results, and says why.
fn ends_because(run: &mut Running, summary: &std::path::Path, words: &str) {
    let ended = wait_until(Duration::from_secs(15), || {
        run.0.try_wait().unwrap().is_some()
    });
    assert!(ended, "the insertion goes on");
    assert_eq!(run.0.wait().unwrap().code(), Some(1));
    let mut said = String::new();
    let mut stderr = run.0.stderr.take().unwrap();
    stderr.read_to_string(&mut said).unwrap();
    assert!(said.contains(words), "{said}");
    // It cannot stay to withdraw the needle, and says what does.
    assert!(
        said.contains("cannot stay") && said.contains("withdraw /"),
        "{said}"
    );
    let text = std::fs::read_to_string(summary).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    let ended = summary["ended"].as_str().unwrap();
    assert!(ended.contains(words), "{text}");
    assert_eq!(summary["cause"], "operator", "{text}");
}

#[test]
fn a_killed_node_stops_its_insertion_and_keeps_the_results() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let out = master.home().join("killed");
    let mut run = steering(&master, out.to_str().unwrap());
    master.output(20, "rosnode", &["kill", "/needle_steer"]);
    ends_because(&mut run, &out.join("summary.json"), "asked to shut down");
    let mut command = std::process::Command::new(BINARY);
    command.arg("withdraw").arg(out.join("run.mcap"));
    let output = command.output().unwrap();
    assert!(output.status.success(), "{output:?}");
}

#[test]
fn a_second_node_of_the_same_name_stops_the_insertion_of_the_first() {
    let Some(master) = Master::start() else {
        return;
    };
    let _others = among_others();
    let out = master.home().join("replaced");
    let mut run = steering(&master, out.to_str().unwrap());
    let script = "import rospy\nfrom std_srvs.srv import Trigger, TriggerResponse\n\
        rospy.init_node('needle_steer', disable_signals=True)\n\
        s = rospy.Service('~stop', Trigger, lambda _: TriggerResponse(True, 'at rest'))\n\
        rospy.rostime.wallsleep(60)\n";
    let _second = master.python(script);
    ends_because(&mut run, &out.join("summary.json"), "took the name");
    // The name is the second one's: the first did not fight for it.
    let (stopped, answer) = call(&master, "/needle_steer/stop");
    assert!(stopped, "{answer}");
    assert!(nodes(&master).contains("/needle_steer"));
}
