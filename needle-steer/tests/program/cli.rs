//! Smoke tests of the command line: exit codes, messages, files.

use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::json;

use super::{BIN, emulator, folder, interrupt, needle_steer, stderr, stdout};

#[test]
fn a_run_ends_with_a_verdict_and_writes_its_results() {
    let out = folder("run");
    let output = needle_steer(&["run", "--json", "--out", out.to_str().unwrap()]);
    assert!(output.status.success(), "{}", stderr(&output));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["ended"], "target passed");
    assert!(
        summary["true_error_mm"].as_f64().unwrap() < 0.3,
        "{summary}"
    );
    assert!(summary["measured_error_mm"].is_number() && summary["duration_s"].is_number());
    for file in ["summary.json", "series.csv", "run.svg", "config.toml"] {
        assert!(out.join(file).metadata().unwrap().len() > 100, "{file}");
    }
    // The configuration that a run writes gives the same run.
    let again = needle_steer(&["run", "--json", out.join("config.toml").to_str().unwrap()]);
    let again: serde_json::Value = serde_json::from_slice(&again.stdout).unwrap();
    assert_eq!(summary["true_error_mm"], again["true_error_mm"]);
    // Results are not written over.
    let before = std::fs::read(out.join("run.mcap")).unwrap();
    let refused = needle_steer(&["run", "--out", out.to_str().unwrap()]);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("nothing is written over"));
    assert_eq!(before, std::fs::read(out.join("run.mcap")).unwrap());
}

#[test]
fn the_same_seed_gives_the_same_run_bit_for_bit_and_another_seed_another() {
    let run = |seed: &str, name: &str| {
        let out = folder(name);
        let output = needle_steer(&[
            "run",
            "--seed",
            seed,
            "--json",
            "--out",
            out.to_str().unwrap(),
        ]);
        assert!(output.status.code().is_some());
        std::fs::read(out.join("series.csv")).unwrap()
    };
    let first = run("7", "seed-7-a");
    assert!(first == run("7", "seed-7-b"), "seed 7 differs from itself");
    assert!(first != run("8", "seed-8"), "seeds 7 and 8 are alike");
}

#[test]
fn a_bad_configuration_names_file_line_and_key_and_writes_nothing() {
    let folder = folder("bad-config");
    let cases = [
        (
            "unknown.toml",
            "[run]\nsede = 4\n",
            ":2: key `run.sede`",
            "did you mean `seed`",
        ),
        (
            "unit.toml",
            "[needle]\nlength_m = 0.1\n",
            ":2: key `needle.length_m`",
            "length_mm",
        ),
        (
            "nan.toml",
            "\n[needle]\nlength_mm = nan\n",
            ":3: key `needle.length_mm`",
            "found NaN",
        ),
        (
            "law.toml",
            "[run]\nlaw = \"papre\"\n",
            ":2: key `run.law`",
            "paper",
        ),
        (
            "phantom.toml",
            "[run]\nphantom = \"gel\"\n",
            ":2: key `run.phantom`",
            "paper",
        ),
        ("syntax.toml", "[run\n", ":1: not valid TOML", ""),
    ];
    for (name, text, place, expectation) in cases {
        let file = folder.join(name);
        std::fs::write(&file, text).unwrap();
        let out = folder.join("results");
        let (file, target) = (file.to_str().unwrap(), out.to_str().unwrap());
        let output = needle_steer(&["run", file, "--out", target]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{name}: {message}");
        assert!(
            message.contains(&format!("{name}{place}")),
            "{name}: {message}"
        );
        assert!(message.contains(expectation), "{name}: {message}");
        assert!(
            output.stdout.is_empty() && !out.exists(),
            "{name}: something was written"
        );
    }
    let output = needle_steer(&["run", "no-such-file.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("no-such-file.toml: cannot be read"));
}

#[cfg(unix)]
#[test]
fn ctrl_c_stops_the_arm_and_keeps_the_results() {
    let out = folder("ctrl-c");
    // A speed at which the run takes hours of simulated time: it is stopped, or it never ends.
    let child = Command::new(BIN)
        .args(["run", "--json", "--set", "run.insertion_speed_mm_s=0.001"])
        .args([
            "--set",
            "run.max_duration_s=86400",
            "--out",
            out.to_str().unwrap(),
        ])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let log = out.join("run.mcap");
    while !log.metadata().is_ok_and(|file| file.len() > 100_000) {
        std::thread::yield_now();
    }
    let output = interrupt(child);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["ended"], "interrupted");
    for file in ["summary.json", "series.csv", "run.svg", "run.mcap"] {
        assert!(out.join(file).exists(), "{file}");
    }
}

#[test]
fn shape_solves_a_reference_case_and_names_what_is_wrong() {
    let folder = folder("shape");
    let data = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../tests/data/needle/ustk_equilibria.json"
    );
    let cases: serde_json::Value = serde_json::from_slice(&std::fs::read(data).unwrap()).unwrap();
    let case = folder.join("case.json");
    std::fs::write(&case, cases[0].to_string()).unwrap();
    let output = needle_steer(&["shape", case.to_str().unwrap()]);
    assert!(output.status.success(), "{}", stderr(&output));
    let solved: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for axis in 0..3 {
        let expected = cases[0]["expected"]["tip_m"][axis].as_f64().unwrap();
        // UsTK's own accuracy at the tip.
        assert!((solved["tip_m"][axis].as_f64().unwrap() - expected).abs() < 1e-6);
    }
    assert_eq!(solved["j_tip_base"].as_array().unwrap().len(), 6);
}

/// Every kind of bad case: exit 2, the field named, nothing written.
#[test]
fn a_bad_case_for_shape_names_its_field_and_writes_nothing() {
    let folder = folder("bad-shape");
    let data = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../tests/data/needle/ustk_equilibria.json"
    );
    let cases: serde_json::Value = serde_json::from_slice(&std::fs::read(data).unwrap()).unwrap();
    let good = &cases[3];
    let with = |pointer: &str, value: serde_json::Value| {
        let mut broken = good.clone();
        *broken.pointer_mut(pointer).unwrap() = value;
        broken.to_string()
    };
    let mut swapped = good.clone();
    swapped["springs"].as_array_mut().unwrap().swap(3, 4);
    let mut unknown = good.clone();
    unknown["spring"] = json!([]);
    let mut missing = good.clone();
    missing["needle"]
        .as_object_mut()
        .unwrap()
        .remove("young_modulus_pa");
    let text = good.to_string();
    let bad = [
        (
            with("/springs/1/stiffness_n_per_m", json!(-1.0)),
            "springs[1]: stiffness_n_per_m",
        ),
        (
            with("/springs/1/stiffness_n_per_m", json!(0)),
            "springs[1]: stiffness_n_per_m",
        ),
        (
            with("/springs/2/rest_m", json!([0.0, 0.0])),
            "springs[2].rest_m",
        ),
        (
            with("/springs/2/rest_m/1", json!("a")),
            "springs[2].rest_m[1]",
        ),
        (
            with("/springs/2/rest_m/1", serde_json::Value::Null),
            "springs[2].rest_m[1]",
        ),
        (with("/needle/length_m", json!(0.0)), "length_m"),
        (with("/needle/length_m", json!(0.09)), "length_m"),
        (
            with("/needle/outer_diameter_m", json!(1e-90)),
            "inner_diameter_m",
        ),
        (
            with("/needle/inner_diameter_m", json!(1e-3)),
            "inner_diameter_m",
        ),
        (
            with("/needle/young_modulus_pa", json!(0)),
            "young_modulus_pa",
        ),
        (with("/world_from_base/0/0", json!(2.0)), "world_from_base"),
        (
            with("/world_from_base/3", json!([0, 0, 0, 2])),
            "world_from_base",
        ),
        (
            with("/world_from_base/2", json!([0, 0, 1])),
            "world_from_base[2]",
        ),
        (with("/tip_force_n", json!("0.1")), "tip_force_n"),
        (swapped.to_string(), "spring 4 is out of order"),
        (unknown.to_string(), "spring"),
        (missing.to_string(), "young_modulus_pa"),
        (
            text.replacen("\"tip_force_n\":", "\"tip_force_n\":NaN,\"x\":", 1),
            "tip_force_n",
        ),
        (
            text.replacen("\"length_m\":", "\"length_m\":1e999,\"x\":", 1),
            "length_m",
        ),
        (format!("{text}{text}"), "after the case"),
        (text[..text.len() / 2].to_owned(), "line 1"),
        (String::new(), "case.json"),
        ("[]".to_owned(), "case.json"),
    ];
    let case = folder.join("case.json");
    for (text, named) in bad {
        std::fs::write(&case, &text).unwrap();
        let output = needle_steer(&["shape", case.to_str().unwrap()]);
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{named}: {said}");
        assert!(output.stdout.is_empty(), "{named}");
        assert!(
            said.contains(named) && said.contains("case.json"),
            "{named}: {said}"
        );
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1, "{named}");
    }
}

#[test]
fn the_viper_back_end_ends_at_the_target_too() {
    let output = needle_steer(&["run", "--backend", "viper", "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["ended"], "target passed");
    assert!(
        summary["true_error_mm"].as_f64().unwrap() < 0.3,
        "{summary}"
    );
}

#[cfg(unix)]
#[test]
fn the_emulated_controller_listens_until_it_is_interrupted() {
    use std::io::{BufRead, BufReader};
    let mut child = emulator().stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    for name in ["motion", "state"] {
        let line = lines.next().unwrap().unwrap();
        let (kind, address) = line.split_once(' ').unwrap();
        assert_eq!(kind, name);
        let address: std::net::SocketAddr = address.parse().unwrap();
        assert!(address.ip().is_loopback());
        std::net::TcpStream::connect_timeout(&address, std::time::Duration::from_secs(5)).unwrap();
    }
    assert_eq!(interrupt(child).status.code(), Some(0));
}

/// The photographs, where there are any.
fn photographs(side: &str) -> Option<Vec<String>> {
    let folder = std::env::var_os("NEEDLE_STEER_REFERENCE")?;
    let name = |k: usize| Path::new(&folder).join(format!("stereo/{side}{k:02}.jpg"));
    Some(
        (1..=9)
            .map(|k| name(k).to_str().unwrap().to_owned())
            .collect(),
    )
}

#[test]
fn a_calibration_from_photographs_writes_its_four_files() {
    let (Some(left), Some(right)) = (photographs("left"), photographs("right")) else {
        eprintln!("skipped: NEEDLE_STEER_REFERENCE is not set");
        return;
    };
    let out = folder("calibrate");
    let place = out.join("rig");
    let calibrate = |board: &str, right: &[String]| {
        let mut command = Command::new(BIN);
        command.args([
            "calibrate",
            "stereo",
            "--board",
            board,
            "--square-mm",
            "25",
            "--json",
        ]);
        command.arg("--out").arg(&place);
        command.arg("--left").args(&left).arg("--right").args(right);
        command.output().unwrap()
    };
    let wrong = calibrate("8x6", &right);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(stderr(&wrong).contains("left03.jpg"), "{}", stderr(&wrong));
    let unpaired = calibrate("9x6", &right[..8]);
    assert_eq!(unpaired.status.code(), Some(2));
    assert!(!place.exists(), "a refused calibration wrote something");
    let output = calibrate("9x6", &right);
    assert!(output.status.success(), "{}", stderr(&output));
    let result: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    // The RMS that OpenCV 5 reaches on these nine pairs, rounded up.
    assert!(
        result["joint_rms_px"].as_f64().unwrap() <= 0.2184,
        "{result}"
    );
    assert!(result["rectified_dy_rms_px"].as_f64().unwrap() <= 0.175);
    assert_eq!(result["corners_px"].as_object().unwrap().len(), 18);
    assert!(result["rejected"].as_array().unwrap().is_empty());
    for file in ["report.html", "left.yaml", "right.yaml", "stereo.yml"] {
        assert!(place.join(file).metadata().unwrap().len() > 500, "{file}");
    }
}

#[test]
fn an_unreachable_target_is_refused_before_anything_moves() {
    let aside = needle_steer(&["run", "--set", "target.offset_mm=60"]);
    assert_ne!(aside.status.code(), Some(0));
    assert!(
        stderr(&aside).contains("out of reach"),
        "{}",
        stderr(&aside)
    );
    let deep = needle_steer(&["run", "--set", "target.depth_mm=200"]);
    assert!(stderr(&deep).contains("too short"), "{}", stderr(&deep));
}

#[test]
fn a_dry_run_checks_and_moves_nothing() {
    let output = needle_steer(&["run", "--dry-run", "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(
        (&summary["ended"], &summary["steps"]),
        (&"dry run".into(), &0.into())
    );
}

#[test]
fn the_default_configuration_is_valid_as_printed() {
    let output = needle_steer(&["config", "default"]);
    let file = folder("config-default").join("default.toml");
    std::fs::write(&file, &output.stdout).unwrap();
    let check = needle_steer(&["check", file.to_str().unwrap()]);
    assert!(check.status.success(), "{}", stderr(&check));
}

#[test]
fn forward_kinematics_takes_negative_joints_and_refuses_nonsense() {
    let urdf = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../robots/urdf/viper_s650.urdf"
    );
    let fk = |joints: &str| {
        needle_steer(&[
            "fk", "--urdf", urdf, "--tip", "tool0", "--joints", joints, "--json",
        ])
    };
    let output = fk("-0.1,0,0,0,0,0");
    let items: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    // q1 = -0.1 turns the flange's (0.255, 0, 0.71) about z.
    let x = items[0]["transform"][0][3].as_f64().unwrap();
    assert!(
        (x - 0.255 * 0.1_f64.cos()).abs() < 1e-12,
        "{}",
        stdout(&output)
    );
    assert_eq!(items[0]["jacobian"].as_array().unwrap().len(), 6);
    for bad in ["1,2,3", "a,0,0,0,0,0", "nan,0,0,0,0,0"] {
        let output = fk(bad);
        assert_eq!(output.status.code(), Some(2), "{bad}");
        assert!(output.stdout.is_empty() && stderr(&output).contains("--joints"));
    }
    let output = needle_steer(&[
        "fk",
        "--urdf",
        urdf,
        "--tip",
        "hand",
        "--joints",
        "0,0,0,0,0,0",
    ]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("hand"), "{}", stderr(&output));
    // A file that is broken is named, and its element.
    let broken = folder("broken-urdf").join("broken.urdf");
    let text = std::fs::read_to_string(urdf).unwrap();
    for (from, to, named) in [
        ("<axis xyz=\"0 1 0\"/>", "<axis xyz=\"0 0 0\"/>", "joint_2"),
        ("<link name=\"tool0\"/>", "", "tool0"),
    ] {
        assert!(text.contains(from), "{from}");
        std::fs::write(&broken, text.replacen(from, to, 1)).unwrap();
        let file = broken.to_str().unwrap();
        let joints = "0,0,0,0,0,0";
        let output = needle_steer(&["fk", "--urdf", file, "--tip", "tool0", "--joints", joints]);
        assert_eq!(output.status.code(), Some(2), "{named}");
        let said = stderr(&output);
        assert!(output.stdout.is_empty() && said.contains(named), "{said}");
        assert!(said.contains("broken.urdf"), "{said}");
    }
    // What kinematics does not need, and joints without ends, are no hindrance.
    for (from, to) in [
        ("0.270 0 0", "0.270 0"),
        ("type=\"revolute\"", "type=\"continuous\""),
    ] {
        assert!(text.contains(from), "{from}");
        std::fs::write(&broken, text.replacen(from, to, 1)).unwrap();
        let file = broken.to_str().unwrap();
        let joints = "0,0,0,0,0,0";
        let output = needle_steer(&["fk", "--urdf", file, "--tip", "tool0", "--joints", joints]);
        assert!(output.status.success(), "{to}: {}", stderr(&output));
    }
}

#[test]
fn inverse_kinematics_finds_the_joints_again() {
    let urdf = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../robots/urdf/viper_s650.urdf"
    );
    let arm = ["--urdf", urdf, "--tip", "tool0", "--json"];
    let fk = needle_steer(&[&["fk", "--joints", "0.3,-1.2,2.1,0.4,-0.7,1.1"], &arm[..]].concat());
    let fk: serde_json::Value = serde_json::from_slice(&fk.stdout).unwrap();
    let pose: Vec<String> = fk[0]["transform"]
        .as_array()
        .unwrap()
        .iter()
        .flat_map(|row| row.as_array().unwrap().iter().map(ToString::to_string))
        .collect();
    let pose = pose.join(",");
    let ik = needle_steer(&[&["ik", "--pose", &pose], &arm[..]].concat());
    assert!(ik.status.success(), "{}", stderr(&ik));
    let ik: serde_json::Value = serde_json::from_slice(&ik.stdout).unwrap();
    let found = ik[0]["solutions"].as_array().unwrap().iter().any(|q| {
        let wanted = [0.3, -1.2, 2.1, 0.4, -0.7, 1.1];
        wanted
            .iter()
            .enumerate()
            .all(|(i, w)| (q[i].as_f64().unwrap() - w).abs() < 1e-9)
    });
    assert!(found, "{ik}");
    let bad = needle_steer(
        &[
            &["ik", "--pose", "2,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1"],
            &arm[..],
        ]
        .concat(),
    );
    assert_eq!(bad.status.code(), Some(2));
    assert!(stderr(&bad).contains("not a homogeneous transform"));
}

#[test]
fn bad_usage_exits_with_two() {
    for arguments in [
        &["rnu"][..],
        &["run", "--sed", "1"],
        &["reproduce", "--experiments", "e9"],
    ] {
        assert_eq!(
            needle_steer(arguments).status.code(),
            Some(2),
            "{arguments:?}"
        );
    }
    assert!(needle_steer(&["--help"]).status.success());
    assert!(needle_steer(&["run", "--help"]).status.success());
    assert!(!stdout(&needle_steer(&["--version"])).is_empty());
    assert!(!stdout(&needle_steer(&["completions", "bash"])).is_empty());
}
