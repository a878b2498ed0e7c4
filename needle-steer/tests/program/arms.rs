//! Arms of other laboratories at the command line: `fk`, `ik`, `check`, `arms`, `run`.

use std::path::Path;
use std::process::Output;

use super::{needle_steer, stderr};

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/tests/data/arms");

fn stdout(output: &Output) -> String {
    assert!(output.status.success(), "{}", stderr(output));
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// A changed copy of one of the arms.
fn changed(arm: &str, name: &str, changes: &[(&str, &str)]) -> String {
    let mut text = std::fs::read_to_string(format!("{FOLDER}/{arm}.urdf")).unwrap();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&file, text).unwrap();
    file.to_str().unwrap().to_owned()
}

/// `needle-steer COMMAND` for an arm and an aligned target seen by the fast sensor.
fn with_arm(command: &[&str], file: &str, more: &[&str]) -> Output {
    let urdf = format!("arm.urdf={file:?}");
    let mut arguments = command.to_vec();
    for set in [
        urdf.as_str(),
        "arm.tip_link=tool0",
        "run.sensor=shape",
        "target.kind=aligned",
    ] {
        arguments.extend(["--set", set]);
    }
    for set in more {
        arguments.extend(["--set", set]);
    }
    needle_steer(&arguments)
}

#[test]
fn the_table_of_arms_is_what_the_command_makes() {
    let table = stdout(&needle_steer(&["arms", FOLDER]));
    let page = include_str!("../../../docs/ARMS.md");
    assert!(table.lines().count() > 12);
    for line in table.lines() {
        assert!(page.contains(line), "docs/ARMS.md lacks {line}");
    }
}

#[test]
fn a_chain_begins_at_a_base_and_holds_what_it_is_told() {
    let rail = "<link name=\"floor\"/><joint name=\"rail\" type=\"prismatic\"><parent link=\"floor\"/>\
        <child link=\"base_link\"/><axis xyz=\"0 1 0\"/><limit lower=\"0\" upper=\"1\" velocity=\"1\"/>\
        </joint></robot>";
    let file = changed("ur5", "rail.urdf", &[("</robot>", rail)]);
    let plain = format!("{FOLDER}/ur5.urdf");
    let fk = |file: &str, more: &[&str]| {
        let joints = "--joints=0.1,-0.5,0.7,0.2,-1.1,0.4";
        needle_steer(&[&["fk", "--urdf", file, "--tip", "tool0", joints], more].concat())
    };
    let refused = fk(&file, &[]);
    assert_eq!(refused.status.code(), Some(2));
    for part in ["rail.urdf", "--base base_link", "--hold rail="] {
        assert!(stderr(&refused).contains(part), "{}", stderr(&refused));
    }
    let expected = stdout(&fk(&plain, &[]));
    assert_eq!(stdout(&fk(&file, &["--base", "base_link"])), expected);
    assert_eq!(stdout(&fk(&file, &["--hold", "rail=0"])), expected);
    let nonsense = fk(&file, &["--hold", "rail"]);
    assert!(
        stderr(&nonsense).contains("NAME=VALUE"),
        "{}",
        stderr(&nonsense)
    );
    let more = ["arm.held_joints_mm.rail=0.0"];
    assert!(with_arm(&["check"], &file, &more).status.success());
    assert!(
        with_arm(&["check"], &file, &["arm.base_link=base_link"])
            .status
            .success()
    );
}

#[test]
fn inverse_kinematics_says_whether_its_search_is_exhaustive() {
    let pose = "--pose=1,0,0,0.4,0,-1,0,0.1,0,0,-1,0.3,0,0,0,1";
    for (arm, exhaustive) in [("ur5", true), ("kuka_iiwa7", false)] {
        let urdf = format!("{FOLDER}/{arm}.urdf");
        let text = stdout(&needle_steer(&[
            "ik", "--urdf", &urdf, "--tip", "tool0", pose,
        ]));
        let items: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(items[0]["exhaustive"], exhaustive, "{arm}");
        assert!(
            !items[0]["solutions"].as_array().unwrap().is_empty(),
            "{arm}"
        );
    }
}

#[test]
fn speeds_that_a_urdf_lacks_come_from_the_configuration() {
    let file = changed(
        "abb_irb120",
        "slow.urdf",
        &[("velocity=\"4.36332\"", "velocity=\"0\"")],
    );
    let refused = with_arm(&["run", "--dry-run"], &file, &[]);
    assert!(!refused.status.success());
    for part in ["joint_1, joint_2, joint_3", "arm.joint_speed_deg_s"] {
        assert!(stderr(&refused).contains(part), "{}", stderr(&refused));
    }
    let taken = with_arm(
        &["run", "--dry-run"],
        &file,
        &["arm.joint_speed_deg_s=120.0"],
    );
    assert!(taken.status.success(), "{}", stderr(&taken));
    assert!(
        stderr(&taken).contains("120 deg/s for joint_1"),
        "{}",
        stderr(&taken)
    );
}

#[test]
fn a_holder_off_the_axis_is_refused_with_the_tool_that_mends_it() {
    let straight = "rpy=\"0 1.570796326794897 0\"";
    let file = changed(
        "abb_irb120",
        "askew.urdf",
        &[(straight, "rpy=\"0 1.4835298641951802 0\"")],
    );
    for command in [&["check"][..], &["run", "--dry-run"], &["run"]] {
        let refused = with_arm(command, &file, &[]);
        assert!(!refused.status.success());
        let text = stderr(&refused);
        assert!(
            text.contains("askew.urdf: z of tool0 is 5.0 degrees off the axis of joint_6"),
            "{text}"
        );
        assert!(text.contains("arm.tip_rpy_deg = [0.0, 5.0, 0.0]"), "{text}");
    }
    let mended = with_arm(&["check"], &file, &["arm.tip_rpy_deg=[0.0,5.0,0.0]"]);
    assert!(mended.status.success(), "{}", stderr(&mended));
}

#[test]
fn a_place_that_is_suggested_works() {
    let file = format!("{FOLDER}/kuka_iiwa7.urdf");
    let refused = with_arm(&["check"], &file, &["arm.base_rpy_deg=[0.0,0.0,180.0]"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        stderr(&refused).contains("--suggest"),
        "{}",
        stderr(&refused)
    );
    let text = stdout(&with_arm(&["check", "--suggest"], &file, &[]));
    let place: toml::Table = text.parse().unwrap();
    let set = |key: &str| format!("arm.{key}={}", place["arm"][key]);
    let (mm, deg) = (set("base_mm"), set("base_rpy_deg"));
    let checked = stdout(&with_arm(&["check"], &file, &[&mm, &deg]));
    assert!(checked.contains("fits"), "{checked}");
}

#[test]
fn check_says_what_a_device_can_do() {
    for (device, can) in [
        ("stage", "device: insertion, spin, shift\n"),
        ("insertion_spin", "device: insertion, spin\n"),
        ("guide", "device: insertion, shift\n"),
    ] {
        let file = format!(
            "{}/../robots/urdf/{device}.urdf",
            env!("CARGO_MANIFEST_DIR")
        );
        let more = ["arm.tip_link=needle_base", "arm.mechanism=true"];
        let refused = with_arm(&["check"], &file, &more);
        assert!(
            stderr(&refused).contains("beside the start of the insertion"),
            "{}",
            stderr(&refused)
        );
        let text = stdout(&with_arm(&["check", "--suggest"], &file, &more));
        let place: toml::Table = text.parse().unwrap();
        let set = |key: &str| format!("arm.{key}={}", place["arm"][key]);
        let (mm, deg) = (set("base_mm"), set("base_rpy_deg"));
        let there = [more[0], more[1], &mm, &deg];
        let checked = stdout(&with_arm(&["check"], &file, &there));
        assert!(checked.ends_with(can), "{device}: {checked}");
    }
}

/// Series, log and report of devices whose joints slide.
#[test]
fn a_device_inserts_and_its_report_shows_it() {
    for (device, kind) in [("stage", "shifted"), ("insertion_spin", "aligned")] {
        let root = env!("CARGO_MANIFEST_DIR");
        let file = format!("{root}/../robots/urdf/{device}.urdf");
        let kind = format!("target.kind={kind}");
        let more = [
            "arm.tip_link=needle_base",
            "arm.mechanism=true",
            kind.as_str(),
        ];
        let text = stdout(&with_arm(&["check", "--suggest"], &file, &more));
        let place: toml::Table = text.parse().unwrap();
        let set = |key: &str| format!("arm.{key}={}", place["arm"][key]);
        let (mm, deg) = (set("base_mm"), set("base_rpy_deg"));
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("report-{device}"));
        let _ = std::fs::remove_dir_all(&folder);
        let there = [more[0], more[1], more[2], &mm, &deg];
        let out = ["run", "--json", "--out", folder.to_str().unwrap()];
        let text = stdout(&with_arm(&out, &file, &there));
        let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(summary["ended"], "target passed", "{text}");
        let log = folder.join("run.mcap");
        stdout(&needle_steer(&["report", log.to_str().unwrap()]));
        let page = std::fs::read_to_string(folder.join("run.html")).unwrap();
        assert!(page.contains("target passed"), "{device}");
        let replayed = stdout(&needle_steer(&["replay", log.to_str().unwrap()]));
        assert!(replayed.contains("0 with other commands"), "{replayed}");
    }
}
