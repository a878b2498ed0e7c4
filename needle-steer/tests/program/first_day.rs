//! What somebody meets who uses the program for the first time: words that name the cause and what to
//! do about it.

use std::io::Write as _;
use std::process::Stdio;

use super::{emulator, folder, needle_steer, stderr};

/// Refused as bad usage, with words that hold each of `told`.
fn refused(arguments: &[&str], told: &[&str]) {
    let output = needle_steer(arguments);
    let words = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {words}");
    for told in told {
        assert!(words.contains(told), "{arguments:?}, {told}: {words}");
    }
}

#[test]
fn a_needle_that_buckles_in_air_does_not_pass_the_check() {
    let thin = [
        "needle.outer_diameter_mm=0.5",
        "needle.inner_diameter_mm=0.0",
        "needle.young_modulus_gpa=70",
    ];
    let with = |command: &[&str], more: &[&str]| {
        let sets = thin.iter().chain(more).flat_map(|set| ["--set", *set]);
        needle_steer(&command.iter().copied().chain(sets).collect::<Vec<_>>())
    };
    let checked = with(&["check"], &[]);
    let words = stderr(&checked);
    assert_eq!(checked.status.code(), Some(1), "{words}");
    for told in [
        "buckles in air",
        "held at its base",
        " N of friction",
        "support = \"guide\"",
    ] {
        assert!(words.contains(told), "{told}: {words}");
    }
    let dry = with(&["run", "--dry-run"], &[]);
    assert!(
        stderr(&dry).contains("note: the needle buckles in air"),
        "{}",
        stderr(&dry)
    );
    let stiffer = with(&["check"], &["needle.outer_diameter_mm=0.65"]);
    assert!(stiffer.status.success(), "{}", stderr(&stiffer));
}

#[test]
fn lengths_in_metres_are_told_as_such() {
    refused(
        &["check", "--set", "needle.length_mm=0.126"],
        &["needle.length_mm", "in metres? 0.126 m are 126 mm"],
    );
    // An arm's place is not to blame for where the tissue lies.
    refused(
        &["check", "--set", "tissue.entry_mm=[0.4,0.0,0.25]"],
        &["note: tissue.entry_mm", "[400.0, 0.0, 250.0]"],
    );
    let board = ["--board", "9x6", "--square-mm", "0.025", "--out", "nowhere"];
    let mono = ["calibrate", "mono", "a.png"];
    let stereo = ["calibrate", "stereo", "--left", "a.png", "--right", "b.png"];
    for command in [&mono[..], &stereo] {
        refused(
            &[command, &board].concat(),
            &["--square-mm 0.025", "0.025 m are 25 mm"],
        );
    }
    let film = [
        "track",
        "--left",
        "a.png",
        "--calibration",
        "c.yaml",
        "--out",
        "x.jsonl",
    ];
    refused(
        &[&film[..], &["--plane", "0,0,0.35,0,0,1"]].concat(),
        &["--plane", "0.35 m are 350 mm"],
    );
    refused(
        &[
            &film[..],
            &["--plane", "0,0,350,0,0,1", "--diameter-mm", "0.0007"],
        ]
        .concat(),
        &["--diameter-mm", "0.0007 m are 0.7 mm"],
    );
}

#[test]
fn a_preset_with_a_needle_of_its_own_says_so() {
    refused(
        &["run", "--phantom", "gel-guide", "--dry-run"],
        &["run.phantom", "200 mm through a guide", "length_mm = 200"],
    );
}

#[test]
fn a_place_that_is_suggested_is_pasted_over_the_table_that_there_is() {
    let at = folder("suggested");
    let file = at.join("arm.toml");
    let text =
        "[run]\nlaw = \"paper\"\n[arm]\ntip_link = \"needle_base\"\nbase_mm = [900.0, 0.0, 0.0]\n";
    std::fs::write(&file, text).unwrap();
    let suggested = needle_steer(&["check", "--suggest", file.to_str().unwrap()]);
    assert!(suggested.status.success(), "{}", stderr(&suggested));
    let table = String::from_utf8(suggested.stdout).unwrap();
    assert!(table.contains("in the place of the table [arm]"), "{table}");
    // As it is said: the old table goes, this one comes.
    let kept = text.split("[arm]").next().unwrap();
    std::fs::write(&file, format!("{kept}{table}")).unwrap();
    let checked = needle_steer(&["check", file.to_str().unwrap()]);
    assert!(checked.status.success(), "{table}: {}", stderr(&checked));
    assert!(table.contains("tip_link"), "{table}");
}

#[test]
fn what_cannot_be_read_is_told_in_words() {
    let at = folder("unread");
    let path = |name: &str| at.join(name).to_str().unwrap().to_owned();
    let missing = path("missing.toml");
    refused(
        &["check", &missing],
        &["missing.toml", "there is no such file"],
    );
    let wide: Vec<u8> = "\u{feff}[run]\nseed = 2\n"
        .encode_utf16()
        .flat_map(u16::to_le_bytes)
        .collect();
    std::fs::write(at.join("wide.toml"), wide).unwrap();
    refused(
        &["check", &path("wide.toml")],
        &["wide.toml", "save it as UTF-8"],
    );
    std::fs::write(
        at.join("poses.json"),
        "{\"target\": {\"point\": {}},\n  \"poses\": [,]}",
    )
    .unwrap();
    std::fs::write(at.join("cameras.yml"), calibration()).unwrap();
    let (poses, cameras, out) = (path("poses.json"), path("cameras.yml"), path("out.json"));
    refused(
        &[
            "calibrate",
            "register",
            &poses,
            "--calibration",
            &cameras,
            "--out",
            &out,
        ],
        &["poses.json:2:13: not the JSON", "expected value"],
    );
    let output = needle_steer(&["check", &path("missing.toml")]);
    assert!(!stderr(&output).contains("os error"), "{}", stderr(&output));
}

/// Two cameras as OpenCV writes them.
fn calibration() -> String {
    let matrix = |key: &str, rows: usize, cols: usize, data: &[f64]| {
        format!(
            "{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: {data:?}\n"
        )
    };
    let camera = [600.0, 0.0, 319.5, 0.0, 600.0, 239.5, 0.0, 0.0, 1.0];
    let unit = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    [
        "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n".to_owned(),
        matrix("M1", 3, 3, &camera),
        matrix("D1", 1, 5, &[0.0; 5]),
        matrix("M2", 3, 3, &camera),
        matrix("D2", 1, 5, &[0.0; 5]),
        matrix("R", 3, 3, &unit),
        matrix("T", 3, 1, &[-0.08, 0.0, 0.0]),
    ]
    .concat()
}

#[test]
fn negative_numbers_are_values_and_mirrors_are_no_poses() {
    refused(
        &["run", "--seed", "-1"],
        &["expected a whole number from 0 to"],
    );
    refused(
        &[
            "calibrate",
            "mono",
            "a.png",
            "--board",
            "9x6",
            "--square-mm",
            "-5",
            "--out",
            "x",
        ],
        &["--square-mm -5: expected millimetres"],
    );
    let urdf = format!("{}/../robots/urdf/ur5e.urdf", env!("CARGO_MANIFEST_DIR"));
    let ik = ["ik", "--urdf", &urdf, "--tip", "tool0", "--pose"];
    let mirrored = "1,0,0,0.4, 0,1,0,0, 0,0,-1,0.3, 0,0,0,1";
    refused(
        &[&ik[..], &[mirrored]].concat(),
        &["mirrored", "determinant is -1"],
    );
    let far = "1,0,0,400, 0,1,0,0, 0,0,1,300, 0,0,0,1";
    refused(&[&ik[..], &[far]].concat(), &["are these millimetres?"]);
}

#[test]
fn shards_that_are_given_twice_are_told() {
    let at = folder("twice");
    let file = at.join("few.toml");
    let text = "laws = [\"none\"]\nseeds = { first = 3, count = 2 }\n[[target]]\nkind = \"aligned\"\ndepth_mm = 8.0\n\
        [config.run]\nsensor = \"shape\"\ninsertion_speed_mm_s = 2.0\n";
    std::fs::write(&file, text).unwrap();
    let part = at.join("part");
    let part = part.to_str().unwrap();
    let done = needle_steer(&["campaign", file.to_str().unwrap(), "--out", part]);
    assert!(done.status.success(), "{}", stderr(&done));
    let merged = needle_steer(&["campaign", "merge", part, part]);
    assert!(merged.status.success(), "{}", stderr(&merged));
    assert!(
        stderr(&merged).contains("2 runs were given twice"),
        "{}",
        stderr(&merged)
    );
}

#[test]
fn a_dry_run_in_air_tells_no_truth_and_no_way_out() {
    let air = needle_steer(&[
        "run",
        "--dry-run=air",
        "--law",
        "none",
        "--set",
        "target.kind=aligned",
        "--set",
        "target.depth_mm=5",
    ]);
    let words = String::from_utf8_lossy(&air.stdout);
    assert!(air.status.success(), "{words}{}", stderr(&air));
    assert!(
        words.contains("in air") && words.contains("duration"),
        "{words}"
    );
    assert!(
        !words.contains("true error") && !words.contains("way out"),
        "{words}"
    );
}

#[test]
fn the_emulated_controller_answers_what_is_typed() {
    let mut child = emulator()
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut typed = child.stdin.take().unwrap();
    typed.write_all(b"e-stop\nnonsense\nhelp\n").unwrap();
    let mut answers = std::io::BufReader::new(child.stderr.take().unwrap());
    let mut lines = Vec::new();
    // The help of the beginning, an answer, a refusal with help, help.
    while lines
        .iter()
        .filter(|line: &&String| line.contains("late MS"))
        .count()
        < 3
    {
        let mut line = String::new();
        assert!(
            std::io::BufRead::read_line(&mut answers, &mut line).unwrap() > 0,
            "{lines:?}"
        );
        lines.push(line);
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(
        lines.iter().any(|line| line.trim() == "done: e-stop"),
        "{lines:?}"
    );
    assert!(
        lines
            .iter()
            .any(|line| line.contains("`nonsense` is no fault")),
        "{lines:?}"
    );
}
