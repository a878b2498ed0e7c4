//! Two processes through a master: the emulated laboratory and the controller.

use std::io::Read;
use std::time::Duration;

use crate::master::Master;
use crate::{alone, nodes, ready, signal, start};

/// On the wall clock, at the time's own pace; interrupted on the way.
#[test]
fn the_controller_moves_an_arm_in_another_process() {
    let Some(master) = Master::start() else {
        return;
    };
    let _alone = alone();
    let mut laboratory = start(&master, &["emulate", "ros"]);
    let _said = ready(&mut laboratory);
    let out = master.home().join("back-end");
    // How soon silence is a fault has its own tests; here a busy machine must not fail.
    let arguments = [
        "run",
        "--backend",
        "ros",
        "--set",
        "ros.late_ms=1000",
        "--json",
        "--out",
        out.to_str().unwrap(),
    ];
    let mut run = start(&master, &arguments);
    std::thread::sleep(Duration::from_secs(8));
    signal(&run.0, "-TERM");
    let mut text = String::new();
    run.0
        .stdout
        .take()
        .unwrap()
        .read_to_string(&mut text)
        .unwrap();
    assert_eq!(run.0.wait().unwrap().code(), Some(1), "{text}");
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(summary["ended"], "interrupted", "{text}");
    assert!(summary["steps"].as_u64().unwrap() > 100, "{text}");
    let series = std::fs::read_to_string(out.join("series.csv")).unwrap();
    let depth = |line: &str| line.split(',').nth(1).unwrap().parse::<f64>().unwrap();
    let (first, last) = (
        series.lines().nth(1).unwrap(),
        series.lines().last().unwrap(),
    );
    // 1 mm/s for most of 8 s.
    assert!(depth(last) - depth(first) > 3.0, "{first}\n{last}");
    signal(&laboratory.0, "-TERM");
    assert!(laboratory.0.wait().unwrap().success());
    let left = nodes(&master);
    assert!(!left.contains("needle_steer"), "{left}");
}
