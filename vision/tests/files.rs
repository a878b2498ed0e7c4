//! Files written, read back, and read by OpenCV's own reader where it is installed.
#![expect(
    clippy::unwrap_used,
    clippy::float_cmp,
    reason = "a test; files hold every digit"
)]

use std::path::PathBuf;
use std::process::Command;

use hal::Transform;
use nalgebra::{DMatrix, Isometry3, Unit, Vector3};
use vision::camera::{Camera, Container, Distortion, FlatWindow, StereoRig};
use vision::files::{
    FileError, Pixels, StereoFile, camchain, camera_info, read_camera_info, read_images,
    read_stereo, stereo_yml, write_all,
};

fn folder(name: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    // Nothing is written over what an earlier run left.
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).unwrap();
    path
}

fn file() -> StereoFile {
    let camera = |f: f64| Camera {
        width: 640,
        height: 480,
        fx: f,
        fy: f + 0.125,
        cx: 341.7,
        cy: 236.1,
        distortion: Distortion::from_array([-0.29, 0.12, 0.0013, -0.0002, -0.04]),
    };
    let window = FlatWindow {
        normal: Unit::new_normalize(Vector3::new(0.1, 0.0, 1.0)),
        distance: 0.44,
        thickness: 0.003,
        wall_index: 1.49,
        gel_index: 1.34,
    };
    StereoFile {
        rig: StereoRig {
            left: camera(533.0),
            right: camera(537.0),
            right_from_left: Transform::assume(Isometry3::new(
                Vector3::new(-0.0832, 0.0009, -0.0001),
                Vector3::new(0.006, 0.004, -0.0035),
            )),
            container: Some(Container {
                left: window,
                right: window,
            }),
        },
        covariance: Some(DMatrix::from_fn(24, 24, |i, j| {
            1e-3 / (1.0 + (i + j) as f64)
        })),
        corner_sigma_px: Some(0.15),
    }
}

#[test]
fn stereo_yml_comes_back_as_it_was() {
    let path = folder("roundtrip").join("stereo.yml");
    let written = file();
    write_all(&[(path.clone(), stereo_yml(&written))]).unwrap();
    let back = read_stereo(&path).unwrap();
    assert_eq!(back.rig.left, written.rig.left);
    assert_eq!(back.rig.right, written.rig.right);
    assert_eq!(back.covariance, written.covariance);
    let (a, b) = (back.rig.right_from_left, written.rig.right_from_left);
    // The rotation goes through a matrix.
    assert!((a.to_homogeneous() - b.to_homogeneous()).amax() < 1e-15);
    let (a, b) = (back.rig.container.unwrap(), written.rig.container.unwrap());
    assert!((a.left.normal.into_inner() - b.left.normal.into_inner()).amax() < 1e-15);
    assert_eq!(a.right.distance, b.right.distance);
}

#[test]
fn camera_info_comes_back_as_it_was() {
    let folder = folder("camera_info");
    for info in camera_info(&file().rig) {
        let path = folder.join(format!("{}.yaml", info.name));
        write_all(&[(path.clone(), info.to_yaml())]).unwrap();
        assert_eq!(read_camera_info(&path).unwrap(), info);
    }
}

/// What YAML 1.1 takes for a number with an exponent: a point, and a sign before the power.
fn is_number_of_yaml_1_1(word: &str) -> bool {
    let Some((mantissa, power)) = word.split_once('e') else {
        return word.parse::<f64>().is_ok();
    };
    mantissa.contains('.') && power.starts_with(['+', '-']) && word.parse::<f64>().is_ok()
}

#[test]
fn every_number_that_is_written_is_one_to_python_too() {
    let mut written = file();
    written.rig.left.distortion.k3 = 0.0;
    written.rig.right.distortion.k3 = 0.0;
    let [left, right] = camera_info(&written.rig).map(|info| info.to_yaml());
    let kalibr = camchain(&written.rig).unwrap();
    for text in [stereo_yml(&written), left, right, kalibr] {
        let words = text.split(|c: char| c.is_whitespace() || "[],".contains(c));
        let numbers = words.filter(|w| w.starts_with(|c: char| c.is_ascii_digit() || c == '-'));
        let mut count = 0;
        for number in numbers.filter(|w| w.contains('.')) {
            assert!(is_number_of_yaml_1_1(number), "{number}");
            count += 1;
        }
        assert!(count > 20, "{text}");
    }
}

/// The Python that tests are told to use.
#[expect(
    clippy::disallowed_methods,
    reason = "tests are told where OpenCV's package is"
)]
fn python() -> String {
    std::env::var("NEEDLE_STEER_PYTHON").unwrap_or_else(|_| "python3".to_owned())
}

#[test]
fn opencv_reads_our_file() {
    let python = &python();
    let cv2 = Command::new(python).args(["-c", "import cv2"]).output();
    if !cv2.is_ok_and(|o| o.status.success()) {
        println!("skipped: no Python with cv2");
        return;
    }
    let path = folder("opencv").join("stereo.yml");
    let written = file();
    write_all(&[(path.clone(), stereo_yml(&written))]).unwrap();
    // Reads every node with OpenCV, rectifies, and writes the rig back with OpenCV's writer.
    let script = r"
import cv2, sys
f = cv2.FileStorage(sys.argv[1], cv2.FILE_STORAGE_READ)
m = {k: f.getNode(k).mat() for k in 'M1 D1 M2 D2 R T E F R1 R2 P1 P2 covariance'.split()}
assert m['covariance'].shape == (24, 24)
assert f.getNode('left_window').getNode('gel_index').real() == 1.34
size = (int(f.getNode('image_width').real()), int(f.getNode('image_height').real()))
r = cv2.stereoRectify(m['M1'], m['D1'], m['M2'], m['D2'], size, m['R'], m['T'], alpha=0,
                      flags=cv2.CALIB_ZERO_DISPARITY)
for ours, theirs in zip(('R1', 'R2', 'P1', 'P2'), r[:4]):
    print(ours, abs(m[ours] - theirs).max() / abs(theirs).max())
g = cv2.FileStorage(sys.argv[2], cv2.FILE_STORAGE_WRITE)
g.write('image_width', size[0]); g.write('image_height', size[1])
for k, v in m.items(): g.write(k, v)
g.release()
";
    let theirs = path.with_file_name("opencv.yml");
    let run = Command::new(python)
        .args(["-c", script])
        .args([&path, &theirs])
        .output()
        .unwrap();
    let (out, error) = (
        String::from_utf8_lossy(&run.stdout),
        String::from_utf8_lossy(&run.stderr),
    );
    assert!(run.status.success(), "{out}{error}");
    println!("{out}");
    for line in out.lines() {
        let relative: f64 = line.split_whitespace().nth(1).unwrap().parse().unwrap();
        // OpenCV samples the borders in single precision.
        assert!(relative < 1e-5, "{line}");
    }
    let back = read_stereo(&theirs).unwrap();
    assert_eq!(back.rig.left, written.rig.left);
    assert_eq!(back.covariance, written.covariance);
}

#[test]
fn wrong_files_are_named_with_their_key() {
    let folder = folder("wrong");
    let good = stereo_yml(&file());
    let read = |text: &str| {
        let path = folder.join("stereo.yml");
        std::fs::write(&path, text).unwrap();
        read_stereo(&path).unwrap_err().to_string()
    };
    assert!(read(&good.replace("M2:", "M3:")).contains("no `M2`"));
    assert!(read(&good.replacen("cols: 3", "cols: 4", 1)).contains("`M1`"));
    assert!(read(&good.replace("gel_index: 1.3", "gel_index: 0.3")).contains("gel 0.34"));
    assert!(read("not: [closed").contains("stereo.yml"));
    assert!(read("").contains("mapping"));
    assert!(read(&good.replace("image_width: 640", "image_width: -1")).contains("image_width"));
    let missing = read_stereo(&folder.join("none.yml"));
    assert!(matches!(missing, Err(FileError::Io { .. })));
    let other = file().check_size(&folder.join("stereo.yml"), 1280, 960);
    assert!(matches!(other, Err(FileError::OtherCamera { .. })));
}

#[test]
fn unreadable_and_mixed_images_are_named() {
    let folder = folder("images");
    let image = |name: &str, width: u32| {
        let path = folder.join(name);
        image::GrayImage::new(width, 8).save(&path).unwrap();
        path
    };
    let paths = [image("a.png", 8), image("b.png", 9)];
    let mixed = read_images(&paths, Pixels::Plain).unwrap_err();
    assert!(mixed.to_string().contains("b.png"), "{mixed}");
    let broken = folder.join("c.png");
    std::fs::write(&broken, "no image").unwrap();
    let error = read_images(&[broken], Pixels::Plain).unwrap_err();
    assert!(matches!(error, FileError::Image { .. }), "{error}");
}
