//! Smoke tests of the command line: exit codes, messages, files.
#![expect(clippy::unwrap_used, reason = "a failed step is a failed test")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn needle_steer(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_needle-steer"))
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// A folder of this test's own, empty.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if folder.exists() {
        std::fs::remove_dir_all(&folder).unwrap();
    }
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

#[test]
fn a_run_ends_with_a_verdict_and_writes_its_results() {
    let out = folder("run");
    let output = needle_steer(&["run", "--json", "--out", out.to_str().unwrap()]);
    assert!(output.status.success(), "{}", stderr(&output));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["ended"], "target passed");
    assert!(
        summary["true_error_mm"].as_f64().unwrap() < 1.0,
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
