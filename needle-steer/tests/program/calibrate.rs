//! `calibrate` on made-up boards and poses: what it finds, what it refuses, what it leaves alone.

use std::path::Path;
use std::process::Output;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use serde_json::{Value, json};

use super::{folder, needle_steer};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const FOCAL_PX: f64 = 600.0;
const BASELINE_M: f64 = 0.08;
const SQUARE_M: f64 = 0.02;

fn calibrate(arguments: &[&str]) -> Output {
    needle_steer(&[&["calibrate"], arguments].concat())
}

/// Refused with exit 2 and a message that holds `named`.
fn refused(output: &Output, named: &str) {
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{named}: {message}");
    assert!(message.contains(named), "{named}: {message}");
    assert!(output.stdout.is_empty());
}

/// The pixel of a point in the left camera's frame, in the left (0) or right (1) image.
fn pixel(p: &Point3<f64>, side: usize) -> [f64; 2] {
    let x = if side == 0 { p.x } else { p.x - BASELINE_M };
    [FOCAL_PX * x / p.z + 319.5, FOCAL_PX * p.y / p.z + 239.5]
}

/// A photograph (PGM) of a board of 9 x 6 inner corners.
fn photograph(left_from_board: &Isometry3<f64>, side: usize, size: (usize, usize)) -> Vec<u8> {
    photograph_of(left_from_board, side, size, |x, y| {
        let (column, row) = ((x / SQUARE_M + 1.0).floor(), (y / SQUARE_M + 1.0).floor());
        let inside = (0.0..10.0).contains(&column) && (0.0..7.0).contains(&row);
        inside && (column + row).rem_euclid(2.0) < 1.0
    })
}

/// A photograph (PGM) of a plane that is dark where `dark` says so of x, y \[m\].
fn photograph_of(
    left_from_board: &Isometry3<f64>,
    side: usize,
    (width, height): (usize, usize),
    dark: impl Fn(f64, f64) -> bool,
) -> Vec<u8> {
    let board_from_left = left_from_board.inverse();
    let eye = board_from_left * Point3::new(if side == 0 { 0.0 } else { BASELINE_M }, 0.0, 0.0);
    let grey = |u: f64, v: f64| {
        let ray = Vector3::new((u - 319.5) / FOCAL_PX, (v - 239.5) / FOCAL_PX, 1.0);
        let ray = board_from_left.rotation * ray;
        let at = eye + ray * (-eye.z / ray.z);
        if dark(at.x, at.y) { 30.0 } else { 220.0 }
    };
    let mut file = format!("P5\n{width} {height}\n255\n").into_bytes();
    for row in 0..height {
        for column in 0..width {
            let mut sum = 0.0_f64;
            for sample in 0..16 {
                let offset = |k: usize| (k as f64 + 0.5) / 4.0 - 0.5;
                sum += grey(
                    column as f64 + offset(sample % 4),
                    row as f64 + offset(sample / 4),
                );
            }
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "30 to 220"
            )]
            file.push((sum / 16.0).round() as u8);
        }
    }
    file
}

/// Poses of a board seen by both cameras: five tilted ones, then three that are parallel.
fn boards() -> Vec<Isometry3<f64>> {
    let tilts = [
        (0.4, 0.0, 0.0, 0.00, 0.00, 0.42),
        (-0.4, 0.1, 0.1, 0.03, 0.02, 0.46),
        (0.1, 0.45, -0.1, -0.02, 0.01, 0.44),
        (0.0, -0.45, 0.1, 0.02, -0.02, 0.48),
        (0.3, 0.3, 0.2, 0.00, -0.01, 0.40),
        (0.0, 0.0, 0.0, 0.00, 0.00, 0.42),
        (0.0, 0.0, 0.0, 0.03, 0.02, 0.46),
        (0.0, 0.0, 0.0, -0.02, -0.02, 0.50),
    ];
    tilts
        .into_iter()
        .map(|(a, b, c, x, y, z)| {
            let turn = UnitQuaternion::from_euler_angles(a, b, c);
            let middle = turn * Vector3::new(4.0, 2.5, 0.0) * SQUARE_M;
            let place = Vector3::new(x + BASELINE_M / 2.0, y, z) - middle;
            Isometry3::from_parts(Translation3::from(place), turn)
        })
        .collect()
}

/// Kalibr has no third radial coefficient: its file is written of the lenses that it knows.
fn kalibrs_lens(at: &Path, left: &[String], right: &[String]) {
    assert!(!at.join("out/camchain.yaml").exists());
    let kalibr = at.join("radtan");
    let mut arguments = vec!["stereo", "--board", "9x6", "--square-mm", "20"];
    arguments.extend([
        "--lens",
        "radtan",
        "--out",
        kalibr.to_str().unwrap(),
        "--left",
    ]);
    arguments.extend(left.iter().map(String::as_str));
    arguments.push("--right");
    arguments.extend(right.iter().map(String::as_str));
    assert!(calibrate(&arguments).status.success());
    let rigs = ["camchain.yaml", "stereo.yml"]
        .map(|name| vision::files::read_stereo(&kalibr.join(name)).unwrap().rig);
    assert!((rigs[0].left.fx - rigs[1].left.fx).abs() < 1e-9);
    assert_eq!(rigs[0].left.distortion, rigs[1].left.distortion);
}

/// What an earlier calibration wrote stays as it is, whichever of its files are left.
fn what_was_written_stays(out: &Path, again: impl Fn() -> Output) {
    let files = ["report.html", "left.yaml", "right.yaml", "stereo.yml"];
    for file in files {
        std::fs::write(out.join(file), "kept").unwrap();
    }
    refused(&again(), "nothing is written over");
    std::fs::remove_file(out.join("report.html")).unwrap();
    refused(&again(), "left.yaml");
    for file in &files[1..] {
        assert_eq!(std::fs::read_to_string(out.join(file)).unwrap(), "kept");
    }
    assert!(!out.join("report.html").exists());
}

#[test]
fn stereo_finds_made_up_cameras_and_refuses_by_name() {
    let at = folder("made_up_stereo");
    let write = |name: &str, bytes: &[u8]| {
        let path = at.join(name);
        std::fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let mut images: [Vec<String>; 2] = [vec![], vec![]];
    for (k, board) in boards().iter().enumerate() {
        for side in 0..2 {
            let picture = photograph(board, side, (WIDTH, HEIGHT));
            images[side].push(write(
                &format!("{}{k}.pgm", ["left", "right"][side]),
                &picture,
            ));
        }
    }
    let out = at.join("out");
    let run_to = |out: &Path, left: &[String], right: &[String], board: &str, square: &str| {
        let mut arguments = vec!["stereo", "--board", board, "--square-mm", square, "--json"];
        arguments.extend(["--out", out.to_str().unwrap(), "--left"]);
        arguments.extend(left.iter().map(String::as_str));
        arguments.push("--right");
        arguments.extend(right.iter().map(String::as_str));
        calibrate(&arguments)
    };
    let (left, right) = (&images[0], &images[1]);
    let done = run_to(&out, &left[..5], &right[..5], "9x6", "20");
    assert!(
        done.status.success(),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    let found: Value = serde_json::from_slice(&done.stdout).unwrap();
    // Noise-free but for 8-bit pixels: corners to 0.02 px, focal length to 0.2 %.
    let focal = found["left"]["camera_matrix"][0][0].as_f64().unwrap();
    assert!((focal / FOCAL_PX - 1.0).abs() < 2e-3, "{focal}");
    let baseline = found["right_from_left"][0][3].as_f64().unwrap();
    assert!((baseline + BASELINE_M).abs() < 0.2e-3, "{baseline}");
    assert!(found["rejected"].as_array().unwrap().is_empty());

    kalibrs_lens(&at, &left[..5], &right[..5]);

    what_was_written_stays(&out, || run_to(&out, &left[..5], &right[..5], "9x6", "20"));

    // From here on everything is refused, and nothing is left of it.
    let out = at.join("fresh");
    let run = |left: &[String], right: &[String], board: &str, square: &str| {
        run_to(&out, left, right, board, square)
    };
    let replaced = |k: usize, by: String| {
        let mut list = left[..5].to_vec();
        list[k] = by;
        list
    };
    let garbage = write("garbage.pgm", b"no image");
    refused(
        &run(&replaced(1, garbage), &right[..5], "9x6", "20"),
        "garbage.pgm",
    );
    let missing = at.join("missing.pgm").to_str().unwrap().to_owned();
    refused(
        &run(&replaced(2, missing), &right[..5], "9x6", "20"),
        "missing.pgm",
    );
    let small = write("small.pgm", &photograph(&boards()[0], 0, (320, 240)));
    refused(
        &run(&replaced(3, small), &right[..5], "9x6", "20"),
        "small.pgm",
    );
    refused(&run(&left[..5], &right[..5], "8x6", "20"), "left0.pgm");
    refused(&run(&left[..5], &right[..5], "nine", "20"), "--board nine");
    refused(&run(&left[..5], &right[..5], "9x6", "-1"), "--square-mm");
    refused(&run(&left[..5], &right[..4], "9x6", "20"), "--right 4");
    refused(&run(&left[..2], &right[..2], "9x6", "20"), "2 usable pairs");
    refused(
        &run(&left[5..], &right[5..], "9x6", "20"),
        "degenerate views",
    );
    // Photographs of no board, until too few are left.
    let mut blank = format!("P5\n{WIDTH} {HEIGHT}\n255\n").into_bytes();
    blank.resize(blank.len() + WIDTH * HEIGHT, 128);
    let blank = write("blank.pgm", &blank);
    let blanks = [
        blank.clone(),
        blank.clone(),
        blank.clone(),
        left[3].clone(),
        left[4].clone(),
    ];
    refused(&run(&blanks, &right[..5], "9x6", "20"), "blank.pgm");
    assert!(!out.exists());
    // One alone is set aside by name.
    let done = run(&replaced(0, blank), &right[..5], "9x6", "20");
    let found: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert!(
        found["rejected"][0].as_str().unwrap().contains("blank.pgm"),
        "{found}"
    );
}

#[test]
fn circles_calibrate_cameras_and_boards_are_named_by_kind() {
    const STEP_M: f64 = 0.015;
    let at = folder("made_up_circles");
    let disc = |x: f64, y: f64| {
        (0..9).any(|row| {
            let far = |col: i32| {
                let centre = f64::from(2 * col + row % 2) * STEP_M;
                (x - centre).hypot(y - f64::from(row) * STEP_M)
            };
            (0..4).any(|col| far(col) < 0.5 * STEP_M)
        })
    };
    let mut images: [Vec<String>; 2] = [vec![], vec![]];
    for (k, board) in boards().iter().take(5).enumerate() {
        for side in 0..2 {
            let path = at.join(format!("{}{k}.pgm", ["left", "right"][side]));
            let picture = photograph_of(board, side, (WIDTH, HEIGHT), disc);
            std::fs::write(&path, picture).unwrap();
            images[side].push(path.to_str().unwrap().to_owned());
        }
    }
    let run = |command: &str, board: &str| {
        let out = at.join(board.replace(':', "-"));
        let mut arguments = vec![command, "--board", board, "--json"];
        if command != "corners" {
            arguments.extend(["--square-mm", "15", "--out", out.to_str().unwrap()]);
        }
        let side = |k: usize| images[k].iter().map(String::as_str);
        if command == "stereo" {
            arguments.push("--left");
            arguments.extend(side(0));
            arguments.push("--right");
            arguments.extend(side(1));
        } else {
            arguments.extend(side(0));
        }
        calibrate(&arguments)
    };
    let json = |done: &Output| -> Value {
        assert!(
            done.status.success(),
            "{}",
            String::from_utf8_lossy(&done.stderr)
        );
        serde_json::from_slice(&done.stdout).unwrap()
    };
    let found = json(&run("stereo", "circles:4x9"));
    let focal = found["left"]["camera_matrix"][0][0].as_f64().unwrap();
    assert!((focal / FOCAL_PX - 1.0).abs() < 3e-3, "{focal}");
    let baseline = found["right_from_left"][0][3].as_f64().unwrap();
    assert!((baseline + BASELINE_M).abs() < 0.3e-3, "{baseline}");
    let found = json(&run("mono", "circles:4x9"));
    let focal = found["camera"]["camera_matrix"][0][0].as_f64().unwrap();
    assert!((focal / FOCAL_PX - 1.0).abs() < 3e-3, "{focal}");
    let found = json(&run("corners", "circles:4x9"));
    assert_eq!(found[0]["corners_px"].as_array().unwrap().len(), 36);
    refused(&run("corners", "circles:4x11"), "44 circles");
    refused(&run("corners", "9x6"), "no chessboard");
    refused(&run("stereo", "charuco:7x5:DICT_4X4_50"), "markers");
    refused(&run("mono", "charuco:7x5:ARUCO"), "DICT_4X4_50");
    refused(&run("corners", "dots:4x9"), "circles:4x11");
}

/// A pinhole rig as OpenCV's FileStorage has it, with the left camera's focal length.
fn stereo_yml(focal_px: f64) -> String {
    let matrix = |key: &str, rows: usize, cols: usize, data: &[f64]| {
        format!(
            "{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: {data:?}\n"
        )
    };
    let camera = |f: f64| [f, 0.0, 319.5, 0.0, f, 239.5, 0.0, 0.0, 1.0];
    let unit = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    [
        "%YAML:1.0\n---\n".to_owned(),
        format!("image_width: {WIDTH}\nimage_height: {HEIGHT}\n"),
        matrix("M1", 3, 3, &camera(focal_px)),
        matrix("D1", 1, 5, &[0.0; 5]),
        matrix("M2", 3, 3, &camera(FOCAL_PX)),
        matrix("D2", 1, 5, &[0.0; 5]),
        matrix("R", 3, 3, &unit),
        matrix("T", 3, 1, &[-BASELINE_M, 0.0, 0.0]),
    ]
    .concat()
}

fn rows(pose: &Isometry3<f64>) -> Value {
    let m = pose.to_homogeneous();
    json!(
        (0..4)
            .map(|r| (0..4).map(|c| m[(r, c)]).collect())
            .collect::<Vec<Vec<f64>>>()
    )
}

/// Where the cameras stand, and what they see of a point on a moving flange.
fn recorded(count: usize) -> (Isometry3<f64>, Value) {
    let world_from_left =
        Isometry3::new(Vector3::new(0.4, -0.1, 0.6), Vector3::new(3.0, 0.1, -0.2));
    let on_flange = Point3::new(0.01, 0.0, 0.12);
    let poses: Vec<Value> = (0..count)
        .map(|k| {
            let a = k as f64;
            let seen = Point3::new(
                0.04 + 0.05 * (1.3 * a).sin(),
                0.05 * (2.1 * a).cos(),
                0.42 + 0.06 * (0.7 * a).sin(),
            );
            let turn = UnitQuaternion::from_euler_angles(
                0.3 * a.sin(),
                0.3 * (1.7 * a).cos(),
                0.5 * (0.9 * a).sin(),
            );
            let at = world_from_left * seen - turn * on_flange.coords;
            let flange = Isometry3::from_parts(Translation3::from(at.coords), turn);
            json!({
                "name": format!("pose {k}"),
                "world_from_flange": rows(&flange),
                "left_px": [pixel(&seen, 0)],
                "right_px": [pixel(&seen, 1)],
            })
        })
        .collect();
    (
        world_from_left,
        json!({"target": {"point": {}}, "poses": poses}),
    )
}

/// The same calibration in two files and in millimetres gives the same registration, in any order
/// of the arguments, and the same cameras in a run's configuration.
fn two_files_in_millimetres(path: &dyn Fn(&str) -> String, out: &str, found: &Value) {
    let whole = stereo_yml(FOCAL_PX).replace(
        &format!("{:?}", [-BASELINE_M, 0.0, 0.0]),
        &format!("{:?}", [-1e3 * BASELINE_M, 0.0, 0.0]),
    );
    let (intrinsics, extrinsics) = whole.split_at(whole.find("R: ").unwrap());
    std::fs::write(path("intrinsics.yml"), intrinsics).unwrap();
    std::fs::write(path("extrinsics.yml"), extrinsics).unwrap();
    let poses = path("poses.json");
    let (one, two) = (path("intrinsics.yml"), path("extrinsics.yml"));
    let files = ["--calibration", &one, &two];
    let rest = ["--out", out, "--json"];
    for order in [
        [&["register", &poses][..], &files[..]],
        [&["register"], &files],
    ] {
        let mut arguments = order.concat();
        if !arguments.contains(&poses.as_str()) {
            arguments.push(&poses);
        }
        arguments.extend(rest);
        std::fs::remove_file(out).unwrap();
        refused(&calibrate(&arguments), "--unit-mm 1");
        arguments.extend(["--unit-mm", "1"]);
        let done = calibrate(&arguments);
        let again: Value = serde_json::from_slice(&done.stdout).unwrap();
        let entry = |v: &Value| v["world_from_left_camera"][0][3].as_f64().unwrap();
        assert!((entry(&again) - entry(found)).abs() < 1e-9);
    }
    let mut config = needle_steer::config::Config::default();
    config.cameras.calibration = one;
    config.cameras.second_calibration = two;
    out.clone_into(&mut config.cameras.registration);
    let error = needle_steer::cameras::measured(&config)
        .unwrap_err()
        .to_string();
    assert!(error.contains("cameras.unit_mm"), "{error}");
    config.cameras.unit_mm = 1.0;
    let rig = needle_steer::cameras::measured(&config)
        .unwrap()
        .unwrap()
        .rig;
    assert!((rig.baseline() - BASELINE_M).abs() < 1e-12);
    // Cameras that look from the side with their baseline along the needle see no depth.
    let mut along = found.clone();
    along["world_from_left_camera"] =
        json!([[0, 0, -1, 0.8], [0, 1, 0, 0], [1, 0, 0, 0.25], [0, 0, 0, 1]]);
    config.cameras.registration = path("along.json");
    std::fs::write(path("along.json"), along.to_string()).unwrap();
    let error = needle_steer::rig::Rig::new(&config).err().unwrap();
    assert!(error.to_string().contains("in one plane"), "{error}");
}

#[test]
fn register_finds_the_cameras_and_refuses_by_name() {
    let at = folder("made_up_register");
    let path = |name: &str| at.join(name).to_str().unwrap().to_owned();
    std::fs::write(path("stereo.yml"), stereo_yml(FOCAL_PX)).unwrap();
    std::fs::write(path("other.yml"), stereo_yml(0.7 * FOCAL_PX)).unwrap();
    std::fs::write(path("broken.yml"), "M1: 3\n").unwrap();
    let out = path("registration.json");
    let run_to = |out: &str, poses: &str, calibration: &str| {
        let (poses, calibration) = (path(poses), path(calibration));
        calibrate(&[
            "register",
            &poses,
            "--calibration",
            &calibration,
            "--out",
            out,
            "--json",
        ])
    };
    let fresh = path("fresh.json");
    let run = |poses: &str, calibration: &str| run_to(&fresh, poses, calibration);
    let given = |poses: &Value| {
        std::fs::write(path("poses.json"), poses.to_string()).unwrap();
        run("poses.json", "stereo.yml")
    };
    let (truth, good) = recorded(20);
    std::fs::write(path("poses.json"), good.to_string()).unwrap();
    let done = run_to(&out, "poses.json", "stereo.yml");
    assert!(
        done.status.success(),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    let found: Value = serde_json::from_slice(&done.stdout).unwrap();
    let written: Value = serde_json::from_str(&std::fs::read_to_string(&out).unwrap()).unwrap();
    assert_eq!(found, written);
    // Exact pixels: to rounding of the solver, far below the arm's 0.1 mm.
    let expected = truth.to_homogeneous();
    for r in 0..4 {
        for c in 0..4 {
            let value = found["world_from_left_camera"][r][c].as_f64().unwrap();
            assert!((value - expected[(r, c)]).abs() < 1e-6, "{r} {c}: {value}");
        }
    }
    assert!(found["fre_mm"].as_f64().unwrap() < 1e-3);
    two_files_in_millimetres(&path, &out, &found);
    assert!(found["predicted_tre_mm"].as_f64().unwrap() > 0.0);

    // An earlier registration stays.
    refused(
        &run_to(&out, "poses.json", "stereo.yml"),
        "nothing is written over",
    );
    let kept: Value = serde_json::from_str(&std::fs::read_to_string(&out).unwrap()).unwrap();
    assert_eq!(kept, found);

    // From here on everything is refused, and nothing is left of it.
    refused(&run("nowhere.json", "stereo.yml"), "nowhere.json");
    refused(&run("poses.json", "nowhere.yml"), "nowhere.yml");
    refused(&run("poses.json", "broken.yml"), "broken.yml");
    std::fs::write(path("text.json"), "{ poses").unwrap();
    refused(&run("text.json", "stereo.yml"), "text.json");
    // Another camera's calibration: both images contradict each other.
    refused(&run("poses.json", "other.yml"), "disagree");
    refused(&given(&recorded(2).1), "2 poses");
    let mut bad = good.clone();
    bad["poses"][3]["world_from_flange"][0][0] = json!(2.0);
    refused(&given(&bad), "pose 3");
    let mut bad = good.clone();
    bad["poses"][4]["left_px"] = json!([]);
    refused(&given(&bad), "pose 4");
    let mut bad = good.clone();
    bad["poses"][5].as_object_mut().unwrap().remove("right_px");
    refused(&given(&bad), "right_px");
    let mut bad = good.clone();
    let first = bad["poses"][0].clone();
    for pose in bad["poses"].as_array_mut().unwrap() {
        *pose = first.clone();
    }
    refused(&given(&bad), "do not determine");
    let mut bad = good;
    bad["arm_position_sigma_mm"] = json!(-1.0);
    refused(&given(&bad), "positive");
    assert!(!Path::new(&fresh).exists());
}
