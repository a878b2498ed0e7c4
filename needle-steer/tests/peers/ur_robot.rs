//! A UR5 of another laboratory (`ur_robot.py`): what the program is told of it, and where its needle ended.

use std::path::Path;
use std::process::Command;

/// Names of the robot's joints, base to flange.
const JOINTS: [&str; 6] = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
];
/// In World \[mm\]: 45 mm below the surface, 0.7 mm aside. Left alone, the bevel leads 2 mm off the axis.
const TARGET: [f64; 3] = [400.5, -0.5, 205.0];
/// Longest time from the last velocity to rest \[s\], as asked for.
pub(crate) const REST: f64 = 0.3;

/// The robot's description, with its maker's names.
fn description(folder: &Path) -> String {
    let file = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../robots/tests/data/arms/ur5.urdf"
    );
    let mut text = std::fs::read_to_string(file).unwrap();
    for (i, name) in JOINTS.iter().enumerate() {
        let ours = format!("name=\"joint_{}\"", i + 1);
        assert!(text.contains(&ours));
        text = text.replace(&ours, &format!("name=\"{name}\""));
    }
    let file = folder.join("robot.urdf");
    std::fs::write(&file, text).unwrap();
    file.to_str().unwrap().to_owned()
}

/// What the program is told of robot and target; `folder` keeps the robot's description.
pub(crate) fn told(folder: &Path) -> Vec<String> {
    let [x, y, z] = TARGET;
    [
        format!("arm.urdf={:?}", description(folder)),
        "arm.tip_link=tool0".to_owned(),
        "target.kind=world".to_owned(),
        format!("target.position_mm=[{x:.1}, {y:.1}, {z:.1}]"),
        // What its last joint can follow.
        "limits.spin_speed_deg_s=90".to_owned(),
    ]
    .into_iter()
    .flat_map(|set| ["--set".to_owned(), set])
    .collect()
}

/// Where the robot has to stand \[rad\], comma-separated.
pub(crate) fn start(binary: &str, told: &[String]) -> String {
    let mut dry = Command::new(binary);
    let dry = dry.args(["run", "--dry-run"]).args(told).output().unwrap();
    let said = String::from_utf8(dry.stderr).unwrap();
    assert!(said.contains("joints ["), "{said}");
    let (_, list) = said.split_once("joints [").unwrap();
    let (list, _) = list.split_once(']').unwrap();
    let radians = list.split(", ").map(|q| {
        let degrees: f64 = q.parse().unwrap();
        degrees.to_radians().to_string()
    });
    radians.collect::<Vec<_>>().join(",")
}

/// Distance of the target from the axis of the needle \[mm\], of which the robot says tip and direction.
pub(crate) fn off(tip: &str) -> f64 {
    let n: Vec<f64> = tip.split(' ').map(|x| x.parse().unwrap()).collect();
    let to: Vec<f64> = (0..3).map(|i| TARGET[i] - 1e3 * n[i]).collect();
    let ahead: f64 = (0..3).map(|i| to[i] * n[3 + i]).sum();
    let square: f64 = to.iter().map(|x| x * x).sum();
    (square - ahead * ahead).max(0.0).sqrt()
}

/// Whether the run's summary says that it has hit, and its verdict.
pub(crate) fn verdict(out: &Path) -> (bool, String) {
    let text = std::fs::read_to_string(out.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    (summary["hit"] == true, summary["ended"].to_string())
}
