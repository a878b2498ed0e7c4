//! The photographs and OpenCV's results on them, where they are.
#![allow(
    dead_code,
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::allow_attributes,
    reason = "for tests, of which each uses a part"
)]

use std::path::PathBuf;

use hal::GrayImage;
use nalgebra::Point2;

/// Folder of the stereo photographs; `None` (with a message) where there are none.
#[expect(
    clippy::disallowed_methods,
    reason = "tests are told where the photographs are"
)]
pub(crate) fn folder() -> Option<PathBuf> {
    if let Ok(path) = std::env::var("NEEDLE_STEER_REFERENCE") {
        let folder = PathBuf::from(path).join("stereo");
        assert!(folder.is_dir(), "{} is no folder", folder.display());
        return Some(folder);
    }
    let installed = [
        "/usr/share/doc/opencv-doc/examples/data",
        "/usr/share/doc/opencv-doc/opencv4/samples/data",
        "/usr/share/doc/opencv-doc/samples/data",
    ];
    let found = installed
        .iter()
        .map(PathBuf::from)
        .find(|p| p.join("left01.jpg").exists());
    if found.is_none() {
        println!("skipped: no photographs (set NEEDLE_STEER_REFERENCE or install opencv-doc)");
    }
    found
}

/// A photograph.
pub(crate) fn photograph(name: &str) -> Option<GrayImage> {
    let path = folder()?.join(name);
    let image = image::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let image = image.into_luma8();
    let (w, h) = (image.width() as usize, image.height() as usize);
    Some(GrayImage::from_pixels(w, h, image.into_raw()).unwrap())
}

/// OpenCV's results, where they are.
pub(crate) fn opencv() -> Option<serde_json::Value> {
    let path = folder()?.join("opencv_reference.json");
    if !path.exists() {
        println!("skipped: no opencv_reference.json");
        return None;
    }
    Some(serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap())
}

/// OpenCV's corners of a photograph.
pub(crate) fn opencv_corners(reference: &serde_json::Value, name: &str) -> Vec<Point2<f64>> {
    let list = reference["corners_px"][name].as_array().unwrap();
    // The file holds the shortest decimals of OpenCV's single-precision corners.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "restores OpenCV's own rounding"
    )]
    let exact = |v: &serde_json::Value| f64::from(v.as_f64().unwrap() as f32);
    list.iter()
        .map(|p| Point2::new(exact(&p[0]), exact(&p[1])))
        .collect()
}

/// `left01.jpg`, `right01.jpg`, ... of the nine pairs.
pub(crate) fn names() -> Vec<String> {
    (1..=9)
        .flat_map(|k| [format!("left{k:02}.jpg"), format!("right{k:02}.jpg")])
        .collect()
}
