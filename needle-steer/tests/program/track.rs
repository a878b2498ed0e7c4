//! `needle-steer track` on images of the phantom's cameras, against truth.

use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};

use hal::{GrayImage, Stamp, Transform};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use needle_steer::cameras::calibrated;
use phantom::NeedleView;
use phantom::camera::{CameraSettings, StereoRig};
use serde_json::Value;
use vision::files::{StereoFile, stereo_yml};

use super::{folder, program, stderr};

const DIAMETER: f64 = 0.7e-3;
const BEVEL_DEG: f64 = 24.0;
const FRAMES: usize = 40;
/// Frames without an image: five in a row.
const BLANK: core::ops::Range<usize> = 18..23;

/// A recorded insertion on disk.
struct Film {
    folder: PathBuf,
    left: Vec<String>,
    right: Vec<String>,
    /// O and the sharp point in the left camera's frame.
    tips: Vec<[Point3<f64>; 2]>,
    /// Where O and a point of the shaft behind it appear in the first pair.
    first: [[f64; 4]; 2],
}

fn path_in_gel(z: f64) -> Vector3<f64> {
    let bent = z.max(0.0).powi(2);
    Vector3::new(0.3 * bent, -0.9 * bent, z)
}

fn save(path: &Path, image: &GrayImage) {
    image::save_buffer(
        path,
        image.pixels(),
        image.width() as u32,
        image.height() as u32,
        image::ExtendedColorType::L8,
    )
    .unwrap();
}

impl Film {
    /// Renders an insertion of 0.25 mm a frame with ideal cameras, and writes images and
    /// calibration, the container in it.
    fn new(name: &str, bevel_angle: f64, blank: core::ops::Range<usize>) -> Self {
        let folder = folder(name);
        let world_from_phantom = Isometry3::new(
            Vector3::new(0.4, 0.0, 0.25),
            Vector3::x() * core::f64::consts::PI,
        );
        let mut rig = StereoRig::new(&CameraSettings::ideal(), &world_from_phantom, 3).unwrap();
        let left_from_world = *rig.truth().left_from_world.isometry();
        let stereo = calibrated(rig.truth());
        let file = StereoFile {
            rig: stereo,
            covariance: None,
            corner_sigma_px: None,
        };
        std::fs::write(folder.join("stereo.yml"), stereo_yml(&file)).unwrap();
        let mut film = Self {
            folder,
            left: Vec::new(),
            right: Vec::new(),
            tips: Vec::new(),
            first: [[0.0; 4]; 2],
        };
        for frame in 0..FRAMES {
            let depth = 0.045 + 0.25e-3 * frame as f64;
            let in_world = |z: f64| (world_from_phantom * Point3::from(path_in_gel(z))).coords;
            let axis = (path_in_gel(depth) - path_in_gel(depth - 1e-5)).normalize();
            let upright = UnitQuaternion::rotation_between(&Vector3::z(), &axis).unwrap();
            let turned = upright * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.8);
            let phantom_from_tip = Isometry3::from_parts(path_in_gel(depth).into(), turned);
            let needle = NeedleView {
                stamp: Stamp::from_secs(frame as f64 / 30.0),
                centreline: (0..=252)
                    .map(|i| in_world(depth - 0.126 + 0.5e-3 * f64::from(i)))
                    .collect(),
                world_from_tip: Transform::assume(world_from_phantom * phantom_from_tip),
                outer_diameter: DIAMETER,
                bevel_angle,
                entry_arc: 0.126 - depth,
            };
            let in_left = |z: f64| left_from_world * Point3::from(in_world(z));
            let point =
                phantom_from_tip * Point3::new(0.0, -0.5 * DIAMETER, DIAMETER / bevel_angle.tan());
            film.tips.push([
                in_left(depth),
                left_from_world * (world_from_phantom * point),
            ]);
            if frame == 0 {
                let px = |k: usize, z: f64| {
                    let at = stereo.views()[k].project(&in_left(z).coords);
                    at.unwrap().0
                };
                film.first = [0, 1].map(|k| {
                    let (behind, tip) = (px(k, depth - 0.025), px(k, depth));
                    // As exactly as a finger points.
                    [behind.x + 2.0, behind.y - 1.5, tip.x - 1.0, tip.y + 2.0]
                });
            }
            let images = rig.render(&needle, frame as u64);
            for (side, image) in ["left", "right"].into_iter().zip(images) {
                let path = film.folder.join(format!("{side}_{frame:03}.png"));
                if blank.contains(&frame) {
                    save(
                        &path,
                        &GrayImage::filled(image.width(), image.height(), 255),
                    );
                } else {
                    save(&path, &image);
                }
                let list = if side == "left" {
                    &mut film.left
                } else {
                    &mut film.right
                };
                list.push(path.to_str().unwrap().to_owned());
            }
        }
        film
    }

    fn path(&self, name: &str) -> String {
        self.folder.join(name).to_str().unwrap().to_owned()
    }

    /// Runs `track` on the film with further arguments.
    fn track(&self, out: &str, more: &[&str]) -> Output {
        self.track_files(&self.left, &self.right, out, more)
    }

    fn track_files(&self, left: &[String], right: &[String], out: &str, more: &[&str]) -> Output {
        program()
            .args(["track", "--out", &self.path(out), "--left"])
            .args(left)
            .arg("--right")
            .args(right)
            .args(if more.contains(&"--calibration") {
                vec![]
            } else {
                vec!["--calibration".to_owned(), self.path("stereo.yml")]
            })
            .args(more)
            .stdin(Stdio::null())
            .output()
            .unwrap()
    }

    fn lines(&self, out: &str) -> Vec<Value> {
        let text = std::fs::read_to_string(self.folder.join(out)).unwrap();
        text.lines()
            .map(|l| serde_json::from_str(l).unwrap())
            .collect()
    }

    /// Largest error of the tip O over the tracked frames \[m\], and their number.
    fn error(&self, lines: &[Value]) -> (f64, usize) {
        let errors: Vec<f64> = lines
            .iter()
            .zip(&self.tips)
            .filter(|(line, _)| line["status"] == "tracked")
            .map(|(line, tip)| (point(&line["tip_m"]) - tip[0]).norm())
            .collect();
        (errors.iter().copied().fold(0.0, f64::max), errors.len())
    }
}

fn point(value: &Value) -> Point3<f64> {
    let numbers: Vec<f64> = serde_json::from_value(value.clone()).unwrap();
    Point3::from_slice(&numbers)
}

/// Tip error asked of ideal cameras, the container known \[m\].
const TIP: f64 = 1e-4;

#[test]
fn a_flat_tip_is_found_and_followed_with_and_without_start_points() {
    let film = Film::new("track-flat", 89.9_f64.to_radians(), 0..0);
    let output = film.track(
        "auto.jsonl",
        &["--json", "--overlay", &film.path("overlay")],
    );
    assert!(output.status.success(), "{}", stderr(&output));
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["frames"], FRAMES);
    assert_eq!(summary["out"], film.path("auto.jsonl"));
    let lines = film.lines("auto.jsonl");
    assert_eq!(lines.len(), FRAMES);
    let (worst, tracked) = film.error(&lines);
    println!("automatic start: {worst:.2e} m, {tracked} tracked");
    assert_eq!(summary["tracked"], tracked);
    assert!(tracked >= FRAMES - 1, "{tracked} tracked");
    assert!(worst <= TIP, "tip {worst:.2e} m");
    for (k, line) in lines.iter().enumerate() {
        assert_eq!(line["frame"], k);
        let shape = line["shape_m"].as_array().unwrap();
        let end = point(shape.last().unwrap());
        assert!((end - point(&line["tip_m"])).norm() < 1e-9);
        let covariance = line["tip_covariance_m2"].as_array().unwrap();
        assert!((0..3).all(|i| covariance[i][i].as_f64().unwrap() > 0.0));
        assert!(line["left_tip_px"][1].is_number() && line["right_tip_px"][1].is_number());
        assert!(line["tip_point_m"].is_null(), "a flat tip has no point");
    }
    let pictures = std::fs::read_dir(film.folder.join("overlay")).unwrap();
    assert_eq!(pictures.count(), FRAMES);
    let picture = image::open(film.folder.join("overlay/frame-000000.png")).unwrap();
    assert_eq!((picture.width(), picture.height()), (1280, 480));
    let red = |p: &image::Rgb<u8>| *p == image::Rgb([255, 0, 0]);
    assert!(picture.to_rgb8().pixels().filter(|p| red(p)).count() > 100);

    let clicks = film.first.map(|p| p.map(|v| v.to_string()).join(","));
    let starts = ["--start-left", &clicks[0], "--start-right", &clicks[1]];
    let output = film.track("clicked.jsonl", &starts);
    assert!(output.status.success(), "{}", stderr(&output));
    let lines = film.lines("clicked.jsonl");
    let (worst, tracked) = film.error(&lines);
    println!("clicked start: {worst:.2e} m, {tracked} tracked");
    assert!(
        tracked == FRAMES && worst <= TIP,
        "{tracked}, {worst:.2e} m"
    );
}

/// What red, green and blue pixels see of a grey scene, in a square that begins with red.
const COLOURS: [[f64; 2]; 2] = [[0.55, 1.0], [1.0, 0.4]];

#[test]
fn raw_images_of_a_colour_camera_are_tracked_where_they_are_said_to_be_raw() {
    let film = Film::new("track-raw", 89.9_f64.to_radians(), 0..0);
    let raw = |files: &[String]| -> Vec<String> {
        let first = files.iter().take(6);
        first
            .map(|file| {
                let mut picture = image::open(file).unwrap().to_luma8();
                for (x, y, pixel) in picture.enumerate_pixels_mut() {
                    let share = COLOURS[(y % 2) as usize][(x % 2) as usize];
                    pixel.0[0] = (f64::from(pixel.0[0]) * share).round() as u8;
                }
                let path = file.replace(".png", "-raw.png");
                picture.save(&path).unwrap();
                path
            })
            .collect()
    };
    let (left, right) = (raw(&film.left), raw(&film.right));
    let output = film.track_files(&left, &right, "raw.jsonl", &["--bayer", "rggb"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let (worst, tracked) = film.error(&film.lines("raw.jsonl"));
    println!("raw images: {worst:.2e} m, {tracked} tracked");
    assert!(tracked == 6 && worst <= TIP, "{tracked}, {worst:.2e} m");
    let colours = film.path("colours.png");
    let picture = image::open(&left[0]).unwrap().to_rgb8();
    picture.save(&colours).unwrap();
    let one = [colours];
    let output = film.track_files(&one, &right[..1], "no.jsonl", &["--bayer"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        stderr(&output).contains("colours.png: an image in colours"),
        "{}",
        stderr(&output)
    );
}

#[test]
fn a_bevel_is_followed_through_blank_frames() {
    let film = Film::new("track-bevel", BEVEL_DEG.to_radians(), BLANK);
    let bevel = DIAMETER / BEVEL_DEG.to_radians().tan();
    let bevel_mm = (1e3 * bevel).to_string();
    let output = film.track("out.jsonl", &["--bevel-mm", &bevel_mm]);
    assert!(output.status.success(), "{}", stderr(&output));
    let lines = film.lines("out.jsonl");
    let (worst, tracked) = film.error(&lines);
    println!("bevel: {worst:.2e} m, {tracked} tracked");
    for line in &lines {
        if line["status"] != "tracked" {
            println!("{} {} {}", line["frame"], line["status"], line["problem"]);
        }
    }
    assert!(worst <= TIP, "tip {worst:.2e} m");
    for frame in BLANK {
        let line = &lines[frame];
        assert_ne!(line["status"], "tracked", "{line}");
        let problem = line["problem"].as_str().unwrap();
        assert!(problem.contains("left image shows nothing"), "{problem}");
        assert_eq!(line["tip_m"].is_null(), line["status"] == "lost", "{line}");
    }
    assert_eq!(lines[BLANK.end - 1]["status"], "lost");
    // Found again within three frames.
    assert!(tracked >= FRAMES - BLANK.len() - 3, "{tracked} tracked");
    let points = lines.iter().zip(&film.tips);
    for (line, tip) in points.filter(|(line, _)| line["status"] == "tracked") {
        // On the axis below the sharp point, which lies a radius beside it.
        let beside = (point(&line["tip_point_m"]) - tip[1]).norm();
        assert!((beside - 0.5 * DIAMETER).abs() < 1.5 * TIP, "{beside:.2e}");
    }
}

/// Runs `track` on something that shows no needle: a line and a picture a frame all the same.
/// Answers the frames' reasons.
fn unfound(
    film: &Film,
    name: &str,
    left: &[String],
    right: &[String],
    more: &[&str],
) -> Vec<String> {
    let overlay = film.path(&format!("{name}-overlay"));
    let more: Vec<&str> = more
        .iter()
        .copied()
        .chain(["--overlay", &overlay])
        .collect();
    let out = format!("{name}.jsonl");
    let output = film.track_files(left, right, &out, &more);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("found in none of"), "{message}");
    assert!(message.contains(&out), "{message}");
    assert_eq!(std::fs::read_dir(&overlay).unwrap().count(), left.len());
    let lines = film.lines(&out);
    assert_eq!(lines.len(), left.len());
    let reasons = lines.iter().map(|line| {
        assert_eq!(line["status"], "lost", "{line}");
        assert!(line["tip_m"].is_null(), "{line}");
        line["reason"].as_str().unwrap().to_owned()
    });
    reasons.collect()
}

#[test]
fn images_without_a_needle_get_a_line_and_a_reason_each() {
    let film = Film::new("track-nothing", 89.9_f64.to_radians(), 0..0);
    for grey in [0, 255] {
        let files = ["left", "right"].map(|side| {
            let file = |k: usize| film.path(&format!("{side}-{grey}-{k}.png"));
            let files: Vec<String> = (0..4).map(file).collect();
            for file in &files {
                save(Path::new(file), &GrayImage::filled(640, 480, grey));
            }
            files
        });
        let reasons = unfound(&film, &format!("grey-{grey}"), &files[0], &files[1], &[]);
        let said = format!("the left image shows nothing: grey levels from {grey} to {grey}");
        for reason in reasons {
            assert!(reason.contains(&said), "{reason}");
        }
    }
}

#[test]
fn with_a_calibration_of_other_cameras_the_reason_is_that_the_images_disagree() {
    let film = Film::new("track-others", 89.9_f64.to_radians(), 0..0);
    // The same images' size, the right camera elsewhere along the needle: by 1 cm.
    let yml = std::fs::read_to_string(film.path("stereo.yml")).unwrap();
    let file = vision::files::read_stereo(Path::new(&film.path("stereo.yml"))).unwrap();
    let mut rig = file.rig;
    let mut right_from_left = *rig.right_from_left.isometry();
    right_from_left.translation.vector.y += 0.01;
    rig.right_from_left = Transform::assume(right_from_left);
    let other = stereo_yml(&StereoFile {
        rig,
        covariance: None,
        corner_sigma_px: None,
    });
    assert_ne!(yml, other);
    let path = film.path("other-cameras.yml");
    std::fs::write(&path, other).unwrap();
    let more = ["--calibration", path.as_str()];
    let reasons = unfound(&film, "others", &film.left[..6], &film.right[..6], &more);
    for reason in reasons {
        assert!(
            reason.contains("the images disagree about the tip by"),
            "{reason}"
        );
    }
}

/// A bright needle of 12 px before grid paper, blurred by 2 px, that advances 18 px a frame.
#[test]
fn one_camera_and_a_plane_place_a_bright_needle_that_advances_far() {
    let film = Film::new("track-plane", 89.9_f64.to_radians(), 0..0);
    let camera = "image_width: 640\nimage_height: 480\ncamera_name: one\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
        data: [2000, 0, 319.5, 0, 2000, 239.5, 0, 0, 1]\ndistortion_model: plumb_bob\n\
        distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0, 0, 0, 0, 0]\n\
        rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n\
        projection_matrix:\n  rows: 3\n  cols: 4\n  \
        data: [2000, 0, 319.5, 0, 0, 2000, 239.5, 0, 0, 0, 1, 0]\n";
    let calibration = film.path("camera.yaml");
    std::fs::write(&calibration, camera).unwrap();
    let column = |y: f64| 200.0 + 0.1 * y + 0.0002 * y * y;
    let mut files = Vec::new();
    let tips: Vec<f64> = (0..12).map(|k| 160.5 + 18.0 * f64::from(k)).collect();
    for (k, tip) in tips.iter().enumerate() {
        let mut image = GrayImage::filled(640, 480, 0);
        for (i, pixel) in image.pixels_mut().iter_mut().enumerate() {
            let (x, y) = ((i % 640) as f64, (i / 640) as f64);
            // Distances from the flanks and from the end, blurred by a logistic edge.
            let soft = |d: f64| 1.0 / (1.0 + (-d / 1.2).exp());
            let slope = 0.1 + 0.0004 * y;
            let across = (x - column(y)).abs() / f64::hypot(1.0, slope);
            let cover = soft(6.0 - across) * soft(tip - y);
            let grid = (i % 640) % 40 < 2 || (i / 640) % 40 < 2;
            let level = if grid { 60.0 } else { 80.0 } + 0.05 * x;
            let grain = (i * 7919 % 13) as f64 * 0.3;
            *pixel = (level + grain + cover * (200.0 - level)) as u8;
        }
        let path = film.path(&format!("bright-{k:02}.png"));
        save(Path::new(&path), &image);
        files.push(path);
    }
    let output = program()
        .args([
            "track",
            "--out",
            &film.path("plane.jsonl"),
            "--calibration",
            &calibration,
        ])
        .args(["--plane", "0,0,350,0,0,1", "--diameter-mm", "1.2", "--left"])
        .args(&files)
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let lines = film.lines("plane.jsonl");
    assert_eq!(lines.len(), tips.len());
    for (line, tip) in lines.iter().zip(&tips) {
        assert_eq!(line["status"], "tracked", "{}", line["reason"]);
        assert!(line["reason"].is_null() && line["right_tip_px"].is_null());
        let found = point(&line["tip_m"]);
        let truth = Point3::new(column(*tip) - 319.5, *tip - 239.5, 2000.0) * (0.35 / 2000.0);
        // 0.175 mm/px, a grid, and a logistic instead of a Gaussian edge: a pixel.
        assert!((found - truth).norm() < 0.2e-3, "{line}");
    }
}

#[test]
fn bad_input_is_named_and_nothing_is_written() {
    let film = Film::new("track-bad", 89.9_f64.to_radians(), 0..0);
    let (left, right) = (&film.left[..2], &film.right[..2]);
    let small = film.path("small.png");
    save(Path::new(&small), &GrayImage::filled(320, 240, 200));
    let text = film.path("text.png");
    std::fs::write(&text, "not an image").unwrap();
    let missing = film.path("missing.png");
    // Its header is right and its pixels are missing.
    let torn = film.path("torn.png");
    let whole = std::fs::read(&film.left[1]).unwrap();
    std::fs::write(&torn, &whole[..whole.len() / 2]).unwrap();
    for (bad, said) in [
        (&small, "320 x 240"),
        (&text, "not a readable image"),
        (&missing, "there is no such file"),
        (&torn, "not a readable image"),
    ] {
        let files = [left[0].clone(), bad.clone()];
        let output = film.track_files(&files, right, "bad.jsonl", &[]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(
            message.contains(bad.as_str()) && message.contains(said),
            "{message}"
        );
        assert!(!film.folder.join("bad.jsonl").exists());
    }
    let other = film.path("other.yml");
    let yml = std::fs::read_to_string(film.path("stereo.yml")).unwrap();
    let resized = yml.replace("image_width: 640", "image_width: 800");
    assert_ne!(yml, resized);
    std::fs::write(&other, resized).unwrap();
    std::fs::write(film.folder.join("there.jsonl"), "kept").unwrap();
    for (count, out, more, said) in [
        (1, "bad.jsonl", &[][..], "--left names 2 images, --right 1"),
        (
            2,
            "bad.jsonl",
            &["--calibration", other.as_str()],
            "other.yml",
        ),
        (
            2,
            "bad.jsonl",
            &["--calibration", missing.as_str()],
            "missing.png",
        ),
        (
            2,
            "bad.jsonl",
            &["--start-left", "1,2,3,4"],
            "--start-right",
        ),
        (
            2,
            "bad.jsonl",
            &["--start-left", "1,2,3", "--start-right", "1,2,3,4"],
            "--start-left 1,2,3:",
        ),
        (
            2,
            "bad.jsonl",
            &["--start-left", "1,2,3,4", "--start-right", "1,2,3,NaN"],
            "--start-right 1,2,3,NaN:",
        ),
        (2, "bad.jsonl", &["--rate-hz", "0"], "--rate-hz 0"),
        (
            2,
            "bad.jsonl",
            &["--diameter-mm", "NaN"],
            "--diameter-mm NaN",
        ),
        (2, "bad.jsonl", &["--bevel-mm=-1"], "--bevel-mm -1"),
        (2, "no/such/folder.jsonl", &[], "folder.jsonl"),
        (2, "there.jsonl", &[], "there.jsonl"),
    ] {
        let output = film.track_files(left, &right[..count], out, more);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{said}: {message}");
        assert!(message.contains(said), "{said}: {message}");
        assert!(!film.folder.join("bad.jsonl").exists(), "{said}");
    }
    let kept = std::fs::read_to_string(film.folder.join("there.jsonl")).unwrap();
    assert_eq!(kept, "kept");
}
