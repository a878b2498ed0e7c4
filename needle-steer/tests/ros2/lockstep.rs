//! An emulated laboratory as one process and its controller as another, in lockstep over ROS 2.

use crate::peer::Domain;

fn error_mm(summary: &std::path::Path) -> f64 {
    let text = std::fs::read_to_string(summary).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(summary["ended"], "target passed", "{text}");
    summary["true_error_mm"].as_f64().unwrap()
}

#[test]
fn an_insertion_over_ros_2_is_that_of_one_process() {
    let Some(domain) = Domain::new() else { return };
    let seed = ["--seed", "3", "--sensor", "shape"];
    let here = domain
        .command(&[&["run", "--out", "here"][..], &seed].concat())
        .output();
    assert!(here.unwrap().status.success());
    let laboratory = [&["emulate", "ros", "--ros2", "--lockstep"][..], &seed].concat();
    let _laboratory = domain.start_ready(&laboratory);
    let there = [
        &["run", "--backend", "ros", "--set", "ros.version=2"][..],
        &["--set", "ros.clock=simulated", "--out", "there"],
        &seed,
    ];
    let there = domain.command(&there.concat()).output().unwrap();
    assert!(
        there.status.success(),
        "{}",
        String::from_utf8_lossy(&there.stderr)
    );
    let [a, b] =
        ["here", "there"].map(|out| error_mm(&domain.home().join(out).join("summary.json")));
    println!("{a} mm, {b} mm over ROS 2");
    assert!((a - b).abs() < 0.02, "{a} mm, {b} mm");
}
