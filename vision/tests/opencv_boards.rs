//! Boards that OpenCV finds or draws, beside OpenCV itself.
//!
//! Needs `opencv-python-headless` in the Python that `NEEDLE_STEER_PYTHON` names (else `python3`);
//! without it these tests say so and pass.
#![expect(clippy::print_stdout, reason = "a test reports what it measured")]
#![expect(clippy::unwrap_used, reason = "a test")]

mod reference;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use nalgebra::Point2;
use serde_json::Value;
use vision::detect::{
    BoardSize, CharucoBoard, RefineOptions, detect_board, detect_charuco, detect_circles,
};
use vision::files::read_image;

/// What OpenCV answers; `None` where its package is missing.
#[expect(
    clippy::disallowed_methods,
    reason = "tests are told where OpenCV's package is"
)]
fn opencv(arguments: &[&str]) -> Option<Value> {
    let python = std::env::var("NEEDLE_STEER_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let there = Command::new(&python).args(["-c", "import cv2"]).output();
    if !there.is_ok_and(|done| done.status.success()) {
        println!("skipped: {python} has no opencv-python-headless");
        return None;
    }
    let script = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/reference/opencv_boards.py"
    );
    let done = Command::new(&python).arg(script).args(arguments).output();
    let done = done.unwrap();
    assert!(
        done.status.success(),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    Some(serde_json::from_slice(&done.stdout).unwrap())
}

fn points(value: &Value) -> Vec<Option<Point2<f64>>> {
    let point = |p: &Value| Some(Point2::new(p[0].as_f64()?, p[1].as_f64()?));
    value.as_array().unwrap().iter().map(point).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn photographs(folder: &Path) -> Vec<PathBuf> {
    // The samples' own: other pictures may lie beside them.
    let photograph = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let sample = ["left", "right", "imagem"]
            .iter()
            .any(|n| name.starts_with(n));
        sample && path.extension().is_some_and(|e| e == "jpg")
    };
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(photograph)
        .collect();
    files.sort();
    files
}

/// Every board of photographs that OpenCV finds is found, its corners where OpenCV refines them.
fn beside(folder: &Path, size: BoardSize, least: usize) {
    let files = photographs(folder);
    let board = format!("{}x{}", size.cols, size.rows);
    let mut arguments = vec!["find", &board];
    arguments.extend(files.iter().map(|f| f.to_str().unwrap()));
    let Some(theirs) = opencv(&arguments) else {
        return;
    };
    let (mut found, mut of_theirs, mut missed) = (0, 0, Vec::new());
    let mut distances = Vec::new();
    for file in &files {
        let ours = detect_board(&read_image(file).unwrap(), size, &RefineOptions::default());
        let answer = &theirs[file.to_str().unwrap()];
        let refined = ["classic", "sector"]
            .iter()
            .find_map(|name| answer[name].as_array().map(|_| points(&answer[name])));
        found += usize::from(ours.is_ok());
        let Some(refined) = refined else { continue };
        of_theirs += 1;
        match ours {
            Ok(ours) => distances.extend(refined.iter().flatten().map(|p| {
                let all = ours.corners.iter().map(|q| (p - q).norm());
                all.fold(f64::INFINITY, f64::min)
            })),
            Err(e) => missed.push(format!("{}: {e}", file.display())),
        }
    }
    assert!(missed.is_empty(), "{missed:#?}");
    let off = median(distances);
    println!(
        "{board}: {found} of {} found, {of_theirs} by OpenCV; {off:.3} px apart",
        files.len()
    );
    assert!(of_theirs >= least && off < 0.1, "{of_theirs} {off}");
}

#[test]
fn every_board_that_opencv_finds_in_photographs_is_found_where_opencv_refines_it() {
    let Some(folder) = reference::folder() else {
        return;
    };
    beside(&folder, BoardSize { cols: 9, rows: 6 }, 18);
    let webcam = folder.join("../real/photographs/calibration_camera");
    if webcam.is_dir() {
        beside(&webcam, BoardSize { cols: 8, rows: 4 }, 10);
    }
}

#[test]
fn a_part_of_a_board_is_no_board() {
    let Some(folder) = reference::folder() else {
        return;
    };
    for file in photographs(&folder) {
        let image = read_image(&file).unwrap();
        for (cols, rows) in [(8, 6), (9, 5), (7, 6), (6, 6), (5, 4)] {
            let part = detect_board(&image, BoardSize { cols, rows }, &RefineOptions::default());
            assert!(part.is_err(), "{}: {cols} x {rows}", file.display());
        }
    }
}

#[test]
#[expect(
    clippy::disallowed_methods,
    reason = "two programs are timed side by side"
)]
fn a_board_of_twelve_megapixels_is_found_no_slower_than_by_opencv() {
    let Some(folder) = reference::folder() else {
        return;
    };
    let size = BoardSize { cols: 9, rows: 6 };
    let small = folder.join("left05.jpg");
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("large.png");
    let files = [&small, &path].map(|p| p.to_str().unwrap());
    let Some(theirs) = opencv(&["time", "9x6", files[0], files[1]]) else {
        return;
    };
    let large = read_image(&path).unwrap();
    let mut ours = f64::INFINITY;
    for _ in 0..3 {
        let start = Instant::now();
        assert!(detect_board(&large, size, &RefineOptions::default()).is_ok());
        ours = ours.min(start.elapsed().as_secs_f64());
    }
    let theirs = theirs.as_f64().unwrap();
    println!(
        "{} x {}: {ours:.4} s, OpenCV {theirs:.4} s",
        large.width(),
        large.height()
    );
    assert!(ours <= theirs);
}

#[test]
fn boards_drawn_by_opencv_are_found_where_they_are() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("drawn");
    std::fs::create_dir_all(&folder).unwrap();
    let Some(boards) = opencv(&["draw", folder.to_str().unwrap()]) else {
        return;
    };
    for board in boards.as_array().unwrap() {
        let file = board["file"].as_str().unwrap();
        let image = read_image(Path::new(file)).unwrap();
        let name = board["board"].as_str().unwrap();
        let parts: Vec<&str> = name.split(':').collect();
        let (cols, rows) = parts[1].split_once('x').unwrap();
        let size = BoardSize {
            cols: cols.parse().unwrap(),
            rows: rows.parse().unwrap(),
        };
        let ours: Vec<Option<Point2<f64>>> = if parts[0] == "charuco" {
            let charuco = CharucoBoard {
                squares: size,
                dictionary: parts[2].parse().unwrap(),
            };
            detect_charuco(&image, &charuco, &RefineOptions::default())
                .unwrap_or_else(|e| panic!("{file}: {e}"))
        } else {
            let found = detect_circles(&image, size).unwrap_or_else(|e| panic!("{file}: {e}"));
            found.into_iter().map(Some).collect()
        };
        let (truth, theirs) = (points(&board["truth"]), points(&board["opencv"]));
        let off = |found: &[Option<Point2<f64>>]| -> Vec<f64> {
            let both = found.iter().zip(&truth);
            both.filter_map(|(a, b)| Some(((*a)? - (*b)?).norm()))
                .collect()
        };
        let (a, b) = (off(&ours), off(&theirs));
        let worst = a.iter().copied().fold(0.0, f64::max);
        println!(
            "{name} {}: {} of {}, OpenCV {}; {:.3} px off in the median, {worst:.3} at most, OpenCV {:.3}",
            Path::new(file).file_stem().unwrap().to_string_lossy(),
            a.len(),
            truth.len(),
            b.len(),
            median(a.clone()),
            median(b.clone()),
        );
        assert_eq!(ours.len(), truth.len());
        assert!(a.len() >= b.len(), "{file}: {} {}", a.len(), b.len());
        // The centre of a circle's ellipse is not its centre's image: OpenCV's are off by as much.
        let limit = if parts[0] == "circles" {
            0.01 + median(b)
        } else {
            0.1
        };
        assert!(median(a) < limit && worst < 0.5, "{file}");
    }
}
