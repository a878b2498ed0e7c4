//! Calibrations that we write, opened by other programs' own readers: ROS's (`camera_calibration_parsers`, which
//! `camera_info_manager` reads with) and one of Kalibr's `camchain`. OpenCV's is in `files.rs`.
#![expect(clippy::unwrap_used, reason = "a test")]

use std::path::{Path, PathBuf};
use std::process::Command;

use hal::Transform;
use nalgebra::{Isometry3, Vector3};
use serde_json::Value;
use vision::StereoRig;
use vision::camera::{Camera, Distortion};
use vision::files::{camchain, camera_info};

/// What numbers may lose on their way through a text and back, relative.
const LOSS: f64 = 1e-12;

/// Both cameras with lenses of one kind, or of two.
fn rig(lenses: [Distortion; 2]) -> StereoRig {
    let camera = |distortion, shift| Camera {
        width: 640,
        height: 480,
        fx: 701.512_345_678_901_2 + shift,
        fy: 702.25 - shift / 3.0,
        cx: 318.0 + shift / 7.0,
        cy: 241.5,
        distortion,
    };
    let pose = Isometry3::new(Vector3::new(-0.08, 0.001, 0.008), Vector3::y() * 0.2);
    StereoRig {
        left: camera(lenses[0], 0.0),
        right: camera(lenses[1], -3.5),
        right_from_left: Transform::assume(pose),
        container: None,
    }
}

fn file(name: &str, text: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("readers");
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

/// What `script` prints of a file; nothing where this Python has not got `module`.
fn read(python: &str, module: &str, script: &str, path: &Path) -> Option<Value> {
    let import = format!("import {module}");
    let there = Command::new(python).args(["-c", &import]).output();
    if !there.is_ok_and(|done| done.status.success()) {
        return None;
    }
    let done = Command::new(python).args(["-c", script]).arg(path).output();
    let done = done.unwrap();
    let errors = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{}: {errors}", path.display());
    Some(serde_json::from_slice(&done.stdout).unwrap())
}

fn numbers(value: &Value) -> Vec<f64> {
    let all = value.as_array().unwrap().iter();
    all.map(|x| x.as_f64().unwrap()).collect()
}

fn same(name: &str, found: &Value, written: &[f64]) {
    let found = numbers(found);
    assert_eq!(found.len(), written.len(), "{name}");
    for (a, b) in found.iter().zip(written) {
        assert!((a - b).abs() <= LOSS * b.abs().max(1.0), "{name}: {a} {b}");
    }
}

#[test]
fn ros_reads_our_camera_info() {
    const SCRIPT: &str = "
import json, sys
import camera_calibration_parsers as parsers
name, info = parsers.readCalibration(sys.argv[1])
print(json.dumps({'name': name, 'size': [info.width, info.height], 'model': info.distortion_model,
                  'D': info.D, 'K': info.K, 'R': info.R, 'P': info.P}))
";
    let five = [-0.11, 0.09, 0.0003, -0.0006, 0.01];
    for lens in [
        Distortion::from_array(five),
        Distortion::radtan([-0.11, 0.09, 0.0003, -0.0006]),
        Distortion::rational([0.1, 0.09, 0.0003, -0.0006, 0.01, 0.4, -0.02, 1e-7]),
        Distortion::equidistant([-0.01, 0.09, -0.03, 0.006]),
    ] {
        for info in camera_info(&rig([lens, lens])) {
            let path = file("info.yaml", &info.to_yaml());
            // Debian installs ROS for its own Python.
            let module = "camera_calibration_parsers";
            let Some(found) = read("/usr/bin/python3", module, SCRIPT, &path) else {
                let required = std::env::var_os("NEEDLE_STEER_REQUIRE_ROS").is_some();
                assert!(!required, "python3-camera-calibration-parsers is missing");
                println!("skipped: no python3-camera-calibration-parsers (scripts/setup)");
                return;
            };
            assert_eq!(found["name"], info.name);
            same("size", &found["size"], &[640.0, 480.0]);
            let (model, coefficients) = lens.ros();
            assert_eq!(found["model"], model);
            same("D", &found["D"], &coefficients);
            let rows = |m: &dyn Fn(usize, usize) -> f64, columns: usize| {
                let places = (0..3).flat_map(|i| (0..columns).map(move |j| (i, j)));
                places.map(|(i, j)| m(i, j)).collect::<Vec<f64>>()
            };
            let matrix = info.camera.matrix();
            same("K", &found["K"], &rows(&|i, j| matrix[(i, j)], 3));
            same(
                "R",
                &found["R"],
                &rows(&|i, j| info.rectification[(i, j)], 3),
            );
            same("P", &found["P"], &rows(&|i, j| info.projection[(i, j)], 4));
        }
    }
}

/// Kalibr itself is a catkin workspace for Ubuntu, and nowhere packaged. `ds-msp` has a reader of its own, made after
/// Kalibr's sources.
#[test]
#[expect(
    clippy::disallowed_methods,
    reason = "tests are told where the reader is"
)]
fn a_reader_of_kalibrs_camchain_reads_ours() {
    const SCRIPT: &str = "
import json, sys
from ds_msp.io import kalibr
cameras = [kalibr.load_kalibr_with_resolution(sys.argv[1], cam) for cam in ('cam0', 'cam1')]
names = {'radtan': 'k1 k2 p1 p2', 'kb': 'k1 k2 k3 k4'}
print(json.dumps({
    'models': [model.name for model, _ in cameras],
    'values': [[getattr(model, k) for k in ('fx fy cx cy ' + names[model.name]).split()] for model, _ in cameras],
    'sizes': [list(size) for _, size in cameras],
    'pose': kalibr.load_kalibr_extrinsics(sys.argv[1], 'cam1').ravel().tolist()}))
";
    let radtan = Distortion::radtan([-0.11, 0.09, 0.0003, -0.0006]);
    let fisheye = Distortion::equidistant([-0.01, 0.09, -0.03, 0.006]);
    let python = ["NEEDLE_STEER_PYTHON", "NEEDLE_STEER_PEERS"].map(std::env::var);
    let python = python.into_iter().find_map(Result::ok);
    let python = python.unwrap_or_else(|| "python3".to_owned());
    for lenses in [[radtan, radtan], [fisheye, fisheye], [radtan, fisheye]] {
        let rig = rig(lenses);
        let path = file("camchain.yaml", &camchain(&rig).unwrap());
        let Some(found) = read(&python, "ds_msp.io.kalibr", SCRIPT, &path) else {
            println!("skipped: no Python with ds-msp");
            return;
        };
        for (k, camera) in [rig.left, rig.right].iter().enumerate() {
            let lens = camera.distortion;
            let equidistant = lens == fisheye;
            assert_eq!(
                found["models"][k],
                if equidistant { "kb" } else { "radtan" }
            );
            let focal = [camera.fx, camera.fy, camera.cx, camera.cy];
            let written = [&focal[..], &lens.coefficients()].concat();
            same("camera", &found["values"][k], &written);
            same("size", &found["sizes"][k], &[640.0, 480.0]);
        }
        let pose = rig.right_from_left.to_homogeneous().transpose();
        same("pose", &found["pose"], pose.as_slice());
    }
}
