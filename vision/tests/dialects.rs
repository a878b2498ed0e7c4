//! Calibrations as other programs write them, and as people type them.
#![expect(
    clippy::unwrap_used,
    clippy::float_cmp,
    reason = "a test; files hold every digit"
)]

use std::path::PathBuf;

use nalgebra::Vector3;
use vision::StereoRig;
use vision::camera::{Distortion, LensModel};
use vision::files::{
    ReadCalibration, ReadOptions, StereoFile, camchain, camera_info, read_calibration, read_camera,
    stereo_yml,
};

fn folder(name: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::create_dir_all(&path).unwrap();
    path
}

/// Writes files into a folder of their own and reads them as one calibration.
fn read(
    name: &str,
    files: &[(&str, String)],
    options: &ReadOptions,
) -> Result<ReadCalibration, String> {
    let folder = folder(name);
    let paths: Vec<PathBuf> = files
        .iter()
        .map(|(file, text)| {
            let path = folder.join(file);
            std::fs::write(&path, text).unwrap();
            path
        })
        .collect();
    read_calibration(&paths, options).map_err(|e| e.to_string())
}

fn one(name: &str, text: &str) -> Result<ReadCalibration, String> {
    read(
        name,
        &[("stereo.yml", text.to_owned())],
        &ReadOptions::default(),
    )
}

const K1: [f64; 9] = [701.5, 0.0, 318.0, 0.0, 702.25, 241.5, 0.0, 0.0, 1.0];
const K2: [f64; 9] = [698.0, 0.0, 322.5, 0.0, 699.5, 238.0, 0.0, 0.0, 1.0];
const D1: [f64; 5] = [-0.11, 0.09, 0.0003, -0.0006, 0.01];
const D2: [f64; 5] = [-0.12, 0.1, -0.0002, 0.0004, -0.02];
const SIZE: &str = "image_width: 640\nimage_height: 480\n";

fn r() -> Vec<f64> {
    let (s, c) = 0.2_f64.sin_cos();
    vec![c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c]
}

fn matrix(name: &str, rows: usize, data: &[f64]) -> String {
    let cols = data.len() / rows;
    format!(
        "{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: {data:?}\n"
    )
}

/// Matrices under the given names, T in metres.
fn rig(names: [&str; 6]) -> String {
    [
        matrix(names[0], 3, &K1),
        matrix(names[1], 1, &D1),
        matrix(names[2], 3, &K2),
        matrix(names[3], 1, &D2),
        matrix(names[4], 3, &r()),
        matrix(names[5], 3, &[-0.08, 0.001, 0.008]),
    ]
    .concat()
}

const OURS: [&str; 6] = ["M1", "D1", "M2", "D2", "R", "T"];

fn opencv(names: [&str; 6]) -> String {
    format!("%YAML:1.0\n---\n{SIZE}{}", rig(names))
}

fn check(read: &ReadCalibration) {
    let rig = &read.file.rig;
    assert_eq!(
        (rig.left.fx, rig.left.cy, rig.right.fy),
        (701.5, 241.5, 699.5)
    );
    assert_eq!(rig.left.distortion, Distortion::from_array(D1));
    assert_eq!(rig.right.distortion, Distortion::from_array(D2));
    assert_eq!((rig.left.width, rig.right.height), (640, 480));
    let pose = rig.right_from_left.isometry();
    assert!((pose.translation.vector - Vector3::new(-0.08, 0.001, 0.008)).norm() < 1e-12);
    assert!((pose.rotation.scaled_axis() - Vector3::new(0.0, 0.2, 0.0)).norm() < 1e-4);
}

#[test]
fn the_same_matrices_are_read_under_the_names_of_many_programs() {
    for names in [
        OURS,
        ["K1", "D1", "K2", "D2", "R", "T"],
        [
            "cameraMatrix1",
            "distCoeffs1",
            "cameraMatrix2",
            "distCoeffs2",
            "R",
            "T",
        ],
        [
            "camera_matrix_left",
            "dist_coeffs_left",
            "camera_matrix_right",
            "dist_coeffs_right",
            "rotation",
            "translation",
        ],
        [
            "left_camera_matrix",
            "left_distortion_coefficients",
            "right_camera_matrix",
            "right_distortion_coefficients",
            "R",
            "T",
        ],
        ["mtxL", "distL", "mtxR", "distR", "rot", "trans"],
        [
            "K_l",
            "D_l",
            "K_r",
            "D_r",
            "rotation_matrix",
            "translation_vector",
        ],
        [
            "Camera_Matrix_0",
            "Dist_Coeffs_0",
            "Camera_Matrix_1",
            "Dist_Coeffs_1",
            "Rmat",
            "tvec",
        ],
        ["LEFT.K", "LEFT.D", "RIGHT.K", "RIGHT.D", "R", "T"],
    ] {
        check(&one("names", &opencv(names)).unwrap_or_else(|e| panic!("{names:?}: {e}")));
    }
}

#[test]
fn intrinsics_and_extrinsics_apart_take_their_size_from_the_images_and_their_unit_from_the_user() {
    let whole = rig(OURS)
        .replace("-0.08", "-80.0")
        .replace("0.001,", "1.0,")
        .replace("0.008", "8.0");
    let (intrinsics, extrinsics) = whole.split_at(whole.find("R: ").unwrap());
    let head = "%YAML:1.0\n---\n";
    let files = [
        ("intrinsics.yml", format!("{head}{intrinsics}")),
        ("extrinsics.yml", format!("{head}{extrinsics}")),
    ];
    let options = ReadOptions {
        unit: Some(1e-3),
        image_sizes: Some([(640, 480); 2]),
    };
    check(&read("apart", &files, &options).unwrap());
    let no_size = ReadOptions {
        image_sizes: None,
        ..options
    };
    let error = read("apart", &files, &no_size).unwrap_err();
    assert!(
        error.contains("no `image_width`") && error.contains("M1, D1, M2"),
        "{error}"
    );
    let no_unit = ReadOptions {
        unit: None,
        ..options
    };
    let error = read("apart", &files, &no_unit).unwrap_err();
    assert!(
        error.contains("baseline 80.4")
            && error.contains("--unit-mm 1")
            && error.contains("extrinsics.yml: key `T`"),
        "{error}"
    );
    let error = read("apart", &files[..1], &options).unwrap_err();
    assert!(error.contains("no `R`"), "{error}");
}

#[test]
fn sizes_are_read_as_a_list_and_for_each_camera() {
    let list = opencv(OURS).replace(SIZE, "image_size: [640, 480]\n");
    check(&one("sizes", &list).unwrap());
    let two = opencv(OURS).replace(
        SIZE,
        &format!("{SIZE}right_image_width: 704\nright_image_height: 512\n"),
    );
    let rig = one("sizes", &two).unwrap().file.rig;
    assert_eq!(
        (rig.left.width, rig.right.width, rig.right.height),
        (640, 704, 512)
    );
}

#[test]
fn yaml_that_opencv_reads_is_read() {
    let text = opencv(OURS);
    check(&one("liberties", &text.replace("data: [", "data:[")).unwrap());
    check(&one("liberties", &format!("# left bench\n{text}")).unwrap());
    check(
        &one(
            "liberties",
            &format!("\u{feff}{}", text.replace('\n', "\r\n")),
        )
        .unwrap(),
    );
    check(
        &one(
            "liberties",
            &text
                .replace("   rows", "\trows")
                .replace("   cols", "\tcols")
                .replace("   dt", "\tdt")
                .replace("   data", "\tdata"),
        )
        .unwrap(),
    );
}

#[test]
fn four_decimals_of_a_rotation_are_made_orthonormal_and_said() {
    let four: Vec<f64> = r().iter().map(|v| (v * 1e4).round() / 1e4).collect();
    let text = opencv(OURS).replace(&format!("{:?}", r()), &format!("{four:?}"));
    let found = one("decimals", &text).unwrap();
    check(&found);
    assert!(found.notes[0].contains("orthonormal"), "{:?}", found.notes);
    let wrong = text.replace("0.9801", "0.9");
    assert!(
        one("decimals", &wrong)
            .unwrap_err()
            .contains("rotation matrix")
    );
}

#[test]
fn xml_and_json_are_read() {
    let xml = |name: &str, rows: usize, data: &[f64]| {
        let words: Vec<String> = data.iter().map(f64::to_string).collect();
        format!(
            "<{name} type_id=\"opencv-matrix\"><rows>{rows}</rows><cols>{}</cols><dt>d</dt><data>\n{}</data></{name}>\n",
            data.len() / rows,
            words.join(" ")
        )
    };
    let matrices: [(&str, usize, Vec<f64>); 6] = [
        ("M1", 3, K1.to_vec()),
        ("D1", 1, D1.to_vec()),
        ("M2", 3, K2.to_vec()),
        ("D2", 1, D2.to_vec()),
        ("R", 3, r()),
        ("T", 3, vec![-0.08, 0.001, 0.008]),
    ];
    let body: String = matrices
        .iter()
        .map(|(n, rows, d)| xml(n, *rows, d))
        .collect();
    let text = format!(
        "<?xml version=\"1.0\"?>\n<opencv_storage>\n<image_width>640</image_width>\n<image_height>480</image_height>\n{body}</opencv_storage>\n"
    );
    check(
        &read(
            "xml",
            &[("stereo.xml", text.clone())],
            &ReadOptions::default(),
        )
        .unwrap(),
    );
    let other = text.replace("opencv_storage", "calibration");
    assert!(
        read("xml", &[("other.xml", other)], &ReadOptions::default())
            .unwrap_err()
            .contains("`calibration`")
    );
    let mut json = serde_json::json!({"image_width": 640, "image_height": 480});
    for (name, rows, data) in &matrices {
        json[*name] = serde_json::json!({"type_id": "opencv-matrix", "rows": rows, "cols": data.len() / rows, "dt": "d", "data": data});
    }
    check(
        &read(
            "json",
            &[("stereo.json", json.to_string())],
            &ReadOptions::default(),
        )
        .unwrap(),
    );
}

/// One camera's `camera_info`.
fn info(k: &[f64; 9], d: &[f64], turn: &[f64], shift: f64) -> String {
    let m = |name: &str, rows: usize, data: &[f64]| {
        format!(
            "{name}:\n  rows: {rows}\n  cols: {}\n  data: {data:?}\n",
            data.len() / rows
        )
    };
    [
        SIZE.to_owned(),
        "camera_name: one\ndistortion_model: plumb_bob\n".to_owned(),
        m("camera_matrix", 3, k),
        m("distortion_coefficients", 1, d),
        m("rectification_matrix", 3, turn),
        m(
            "projection_matrix",
            3,
            &[
                600.0, 0.0, 320.0, shift, 0.0, 600.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0,
            ],
        ),
    ]
    .concat()
}

#[test]
fn camera_info_of_both_cameras_gives_rotation_and_baseline() {
    let unit = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let files = [
        ("left.yaml", info(&K1, &D1, &r(), 0.0)),
        ("right.yaml", info(&K2, &D2, &unit, -60.0)),
    ];
    let rig = read("info", &files, &ReadOptions::default())
        .unwrap()
        .file
        .rig;
    let pose = rig.right_from_left.isometry();
    assert!((pose.translation.vector - Vector3::new(-0.1, 0.0, 0.0)).norm() < 1e-12);
    assert!((pose.rotation.scaled_axis() - Vector3::new(0.0, 0.2, 0.0)).norm() < 1e-12);
    let error = read("info", &files[..1], &ReadOptions::default()).unwrap_err();
    assert!(
        error.contains("one camera") && error.contains("right.yaml"),
        "{error}"
    );
    let twice = [files[0].clone(), files[0].clone()];
    let error = read("info", &twice, &ReadOptions::default()).unwrap_err();
    assert!(error.contains("one place"), "{error}");
    let (camera, _) = read_camera(&folder("info").join("left.yaml"), None).unwrap();
    assert_eq!(camera.cx, 318.0);
    let wide = files[1].1.replace("plumb_bob", "MEI");
    let error = read(
        "info",
        &[files[0].clone(), ("right.yaml", wide)],
        &ReadOptions::default(),
    )
    .unwrap_err();
    assert!(
        error.contains("`MEI`") && error.contains("right.yaml"),
        "{error}"
    );
}

const KALIBR: &str = "cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.11, 0.09, 0.0003, -0.0006]
  distortion_model: radtan
  intrinsics: [701.5, 702.25, 318.0, 241.5]
  resolution: [640, 480]
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.09]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.12, 0.1, -0.0002, 0.0004]
  distortion_model: radtan
  intrinsics: [698.0, 699.5, 322.5, 238.0]
  resolution: [704, 512]
";

#[test]
fn kalibrs_camchain_is_read_with_its_models() {
    let rig = one("kalibr", KALIBR).unwrap().file.rig;
    assert_eq!(
        (rig.left.fy, rig.left.cx, rig.right.width),
        (702.25, 318.0, 704)
    );
    assert!((rig.right_from_left.isometry().translation.x + 0.09).abs() < 1e-15);
    let fisheye = one("kalibr", &KALIBR.replace("radtan", "equidistant")).unwrap();
    let lens = fisheye.file.rig.left.distortion;
    assert_eq!((lens.model, lens.k3), (LensModel::Equidistant, 0.0003));
    assert!(fisheye.notes[0].contains("equidistant"));
    // Some forks add the third radial coefficient.
    let five = KALIBR.replace("-0.0002, 0.0004]", "-0.0002, 0.0004, 0.02]");
    let lens = one("kalibr", &five).unwrap().file.rig.right.distortion;
    assert_eq!((lens.model, lens.k3), (LensModel::PlumbBob, 0.02));
    let error = one("kalibr", &KALIBR.replace("pinhole", "omni")).unwrap_err();
    assert!(error.contains("`omni`"), "{error}");
}

#[test]
fn what_is_read_and_written_again_is_the_same_in_every_dialect() {
    let near = |a: &StereoRig, b: &StereoRig, dialect: &str| {
        for (a, b) in [(&a.left, &b.left), (&a.right, &b.right)] {
            assert_eq!((a.width, a.height), (b.width, b.height));
            for (x, y) in a.intrinsics().iter().zip(b.intrinsics()) {
                assert!(
                    (x - y).abs() <= 1e-12 * x.abs().max(1.0),
                    "{dialect}: {x} {y}"
                );
            }
        }
        let pose = |rig: &StereoRig| rig.right_from_left.to_homogeneous();
        let off = (pose(a) - pose(b)).amax();
        assert!(off < 1e-12, "{dialect}: {off}");
    };
    for text in [
        KALIBR.to_owned(),
        KALIBR.replace("radtan", "equidistant"),
        opencv(OURS),
    ] {
        let rig = one("again", &text).unwrap().file.rig;
        let file = StereoFile {
            rig,
            covariance: None,
            corner_sigma_px: None,
        };
        let back = one("again", &stereo_yml(&file)).unwrap().file.rig;
        near(&rig, &back, "stereo.yml");
        assert_eq!(back.left.distortion.model, rig.left.distortion.model);
        let infos = camera_info(&rig).map(|info| info.to_yaml());
        let at = folder("again-info");
        let paths = ["left.yaml", "right.yaml"].map(|name| at.join(name));
        for (path, text) in paths.iter().zip(&infos) {
            std::fs::write(path, text).unwrap();
        }
        let back = read_calibration(&paths, &ReadOptions::default()).unwrap();
        near(&rig, &back.file.rig, "camera_info");
        if let Some(text) = camchain(&rig) {
            near(&rig, &one("again", &text).unwrap().file.rig, "camchain");
        } else {
            assert_ne!(rig.left.distortion.k3, 0.0);
        }
    }
}

#[test]
fn the_label_of_a_lens_is_honoured_in_every_dialect() {
    let four = opencv(OURS)
        .replace(&matrix("D1", 1, &D1), &matrix("D1", 1, &D1[..4]))
        .replace(&matrix("D2", 1, &D2), &matrix("D2", 1, &D2[..4]));
    let model = |label: &str| {
        one("labels", &four.replace(SIZE, &format!("{SIZE}{label}\n")))
            .map(|read| read.file.rig.right.distortion.model)
    };
    assert_eq!(
        model("distortion_model: plumb_bob"),
        Ok(LensModel::PlumbBob)
    );
    assert_eq!(
        model("distortion_model: equidistant"),
        Ok(LensModel::Equidistant)
    );
    assert_eq!(
        model("camera_model: KannalaBrandt8"),
        Ok(LensModel::Equidistant)
    );
    assert_eq!(model("fisheye: 1"), Ok(LensModel::Equidistant));
    assert!(model("model_type: MEI").unwrap_err().contains("`MEI`"));
    assert!(
        model("distortion_model: thin_prism_fisheye")
            .unwrap_err()
            .contains("thin_prism_fisheye")
    );
    let mut long = [0.0; 14];
    (long[0], long[7]) = (-0.1, 0.03);
    let rational = opencv(OURS).replace(&matrix("D1", 1, &D1), &matrix("D1", 1, &long));
    let lens = one("labels", &rational).unwrap().file.rig.left.distortion;
    assert_eq!((lens.model, lens.k6), (LensModel::RationalPolynomial, 0.03));
}

#[test]
fn lengths_that_no_bench_has_are_named_with_the_remedy() {
    let millimetres = opencv(OURS).replace("-0.08", "-80.0");
    let error = one("lengths", &millimetres).unwrap_err();
    assert!(
        error.contains("baseline 80.0") && error.contains("millimetres"),
        "{error}"
    );
    let nothing = opencv(OURS).replace("[-0.08, 0.001, 0.008]", "[0.0, 0.0, 0.0]");
    assert!(one("lengths", &nothing).unwrap_err().contains("one place"));
}

#[test]
fn missing_keys_are_named_with_those_that_are_there() {
    let error = one("missing", &opencv(["Q1", "D1", "Q2", "D2", "R", "T"])).unwrap_err();
    assert!(
        error.contains("no `M1`") && error.contains("Q1, D1, Q2, D2, R, T"),
        "{error}"
    );
    let error = one("missing", &opencv(["M1", "Q1", "M2", "Q2", "R", "T"])).unwrap_err();
    assert!(
        error.contains("distortion") && error.contains("M1, Q1"),
        "{error}"
    );
    let transposed = opencv(OURS).replace(
        &format!("{K1:?}"),
        "[701.5, 0., 0., 0., 702.25, 0., 318., 241.5, 1.]",
    );
    assert!(one("missing", &transposed).unwrap_err().contains("MATLAB"));
}

#[test]
fn files_of_other_kinds_are_named_for_what_they_are() {
    let named = |bytes: &[u8]| {
        let path = folder("kinds").join("file");
        std::fs::write(&path, bytes).unwrap();
        read_calibration(&[path], &ReadOptions::default())
            .unwrap_err()
            .to_string()
    };
    assert!(named(b"MATLAB 5.0 MAT-file, Platform: GLNXA64").contains("MATLAB"));
    assert!(named(b"\x89HDF\r\n\x1a\n\0").contains("MATLAB"));
    assert!(named(b"PK\x03\x04\x14\0").contains("NumPy"));
    assert!(named(b"[image]\n\nwidth\n640\n").contains("ost.txt"));
    assert!(
        named(b"/**:\n  ros__parameters:\n    camera_info_url: file:///a.yaml\n")
            .contains("ROS 2 parameter file")
    );
    assert!(named(b"\xff\xfe\x00\x01").contains("no text"));
    assert!(named(b"").contains("mapping of keys"));
}
