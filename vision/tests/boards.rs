//! Boards of other kinds than chessboards, drawn by this project, found and calibrated from.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test")]
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "a board has few squares"
)]
#![expect(clippy::print_stdout, reason = "a test reports what it measured")]

mod synthetic;

use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use synthetic::{render_of, rig, rng};
use vision::calibrate::{
    Board, BoardPair, BoardView, StereoOptions, calibrate_mono, calibrate_stereo,
};
use vision::camera::Camera;
use vision::detect::{BoardKind, CharucoBoard, RefineOptions};

const SQUARE_M: f64 = 0.022;
const DARK: f64 = 30.0;
const BRIGHT: f64 = 215.0;
const GROUND: f64 = 110.0;

/// The grey of a board's plane at x, y \[m\] from its first point.
fn drawn(kind: &BoardKind) -> Box<dyn Fn(f64, f64) -> f64> {
    match kind {
        BoardKind::Charuco(board) => charuco(*board),
        _ => circles(Board::new(kind, SQUARE_M).points()),
    }
}

fn charuco(board: CharucoBoard) -> Box<dyn Fn(f64, f64) -> f64> {
    let (codes, side) = (board.dictionary.codes(), board.dictionary.side());
    let (cols, rows) = (board.squares.cols as i32, board.squares.rows as i32);
    Box::new(move |x, y| {
        let (u, v) = (x / SQUARE_M + 1.0, y / SQUARE_M + 1.0);
        let (c, r) = (u.floor() as i32, v.floor() as i32);
        if c < 0 || r < 0 || c >= cols || r >= rows {
            let margin =
                u > -0.5 && v > -0.5 && u < f64::from(cols) + 0.5 && v < f64::from(rows) + 0.5;
            return if margin { BRIGHT } else { GROUND };
        }
        if (c + r) % 2 == 0 {
            return DARK;
        }
        // Markers of seven tenths of a square, numbered row by row.
        let cells = side as i32 + 2;
        let cell = |f: f64| (((f - 0.5) / 0.7 + 0.5) * f64::from(cells)).floor() as i32;
        let (i, j) = (cell(u - f64::from(c)), cell(v - f64::from(r)));
        if i < 0 || j < 0 || i >= cells || j >= cells {
            return BRIGHT;
        }
        if i == 0 || j == 0 || i + 1 == cells || j + 1 == cells {
            return DARK;
        }
        let id = (0..r * cols + c)
            .filter(|k| (k / cols + k % cols) % 2 == 1)
            .count();
        let bit = side * side - 1 - (j - 1) as usize * side - (i - 1) as usize;
        if codes[id] >> bit & 1 == 1 {
            BRIGHT
        } else {
            DARK
        }
    })
}

fn circles(points: Vec<Point2<f64>>) -> Box<dyn Fn(f64, f64) -> f64> {
    let far = points
        .iter()
        .fold(Point2::origin(), |m: Point2<f64>, p| m.sup(p));
    Box::new(move |x, y| {
        let margin = 1.5 * SQUARE_M;
        if x < -margin || y < -margin || x > far.x + margin || y > far.y + margin {
            return GROUND;
        }
        let at = Point2::new(x, y);
        let disc = points.iter().any(|p| (p - at).norm() < 0.55 * SQUARE_M);
        if disc { DARK } else { BRIGHT }
    })
}

/// Poses tilted about both axes before a camera, every other one with a part of the board outside
/// its image where a part counts.
fn poses(kind: &BoardKind, count: usize) -> Vec<Isometry3<f64>> {
    let points = Board::new(kind, SQUARE_M).points();
    let sum = points
        .iter()
        .fold(Vector3::zeros(), |s, p| s + Vector3::new(p.x, p.y, 0.0));
    let middle = sum / points.len() as f64;
    let part = matches!(kind, BoardKind::Charuco(_));
    (0..count)
        .map(|k| {
            let a = k as f64;
            let turn = UnitQuaternion::from_euler_angles(
                0.45 * (1.3 * a).cos(),
                0.45 * (2.1 * a).sin(),
                0.8 * (0.7 * a).sin(),
            );
            let aside = if part && k % 2 == 1 {
                0.09 * (-1.0_f64).powi(k as i32 / 2)
            } else {
                0.0
            };
            let place = Vector3::new(
                0.04 + aside,
                0.02 * (1.9 * a).sin(),
                0.32 + 0.02 * (0.9 * a).sin(),
            );
            Isometry3::from_parts(Translation3::from(place - turn * middle), turn)
        })
        .collect()
}

fn truth(camera: &Camera, pose: &Isometry3<f64>, kind: &BoardKind) -> Vec<Point2<f64>> {
    let points = Board::new(kind, SQUARE_M).points();
    let project = |p: &Point2<f64>| {
        let at = pose * Point3::new(p.x, p.y, 0.0);
        camera.project(&at.coords).unwrap().0
    };
    points.iter().map(project).collect()
}

fn cameras_from(name: &str, fine_px: f64) {
    let kind: BoardKind = name.parse().unwrap();
    let (rig, mut rng) = (rig(), rng(1003));
    let pattern = drawn(&kind);
    let missing = Point2::new(f64::NAN, f64::NAN);
    let (mut pairs, mut views, mut parts) = (Vec::new(), Vec::new(), 0);
    for (k, pose) in poses(&kind, 7).iter().enumerate() {
        let right = rig.right_from_left.isometry() * pose;
        let [left, right] = [(&rig.left, *pose), (&rig.right, right)].map(|(camera, pose)| {
            let image = render_of(camera, &pose, 2.0, &mut rng, &pattern);
            let found = kind
                .detect(&image, &RefineOptions::default())
                .unwrap_or_else(|e| panic!("{name} {k}: {e}"));
            let off: Vec<f64> = found
                .iter()
                .zip(truth(camera, &pose, &kind))
                .filter_map(|(found, truth)| Some(((*found)? - truth).norm()))
                .collect();
            // A false label would be off by a square, 15 px and more; far ends of tilted boards and
            // corners beside squares that the border cuts are off by more than others.
            let worst = off.iter().copied().fold(0.0, f64::max);
            let far = off.iter().filter(|off| **off > fine_px).count();
            assert!(
                worst < 0.8 && 7 * far <= off.len(),
                "{name} {k}: {far} of {off:?}"
            );
            parts += usize::from(found.contains(&None));
            found
        });
        let points =
            |found: &[Option<Point2<f64>>]| found.iter().map(|p| p.unwrap_or(missing)).collect();
        pairs.push(BoardPair {
            left_name: format!("left{k}"),
            right_name: format!("right{k}"),
            left: points(&left),
            right: points(&right),
        });
        views.push(BoardView {
            name: format!("left{k}"),
            corners: left,
        });
    }
    assert_eq!(parts > 0, matches!(kind, BoardKind::Charuco(_)), "{parts}");
    let board = Board::new(&kind, SQUARE_M);
    let options = StereoOptions::default();
    let stereo = calibrate_stereo(&board, &pairs, (640, 480), vec![], &options).unwrap();
    let mono = calibrate_mono(&board.points(), &views, (640, 480), vec![], &options).unwrap();
    println!(
        "{name}: {} pairs ({parts} images of a part), fx {:.2} {:.2} ({:.2}), baseline {:.3} mm ({:.3}), {:.3} px",
        stereo.views.len(),
        stereo.rig.left.fx,
        mono.camera.fx,
        rig.left.fx,
        stereo.rig.baseline() * 1e3,
        rig.baseline() * 1e3,
        stereo.joint_rms_px,
    );
    assert_eq!(stereo.views.len(), 7, "{:?}", stereo.rejected);
    for fx in [stereo.rig.left.fx, mono.camera.fx] {
        assert!((fx / rig.left.fx - 1.0).abs() < 5e-3, "{fx}");
    }
    assert!((stereo.rig.baseline() - rig.baseline()).abs() < 0.4e-3);
    assert!(stereo.rectified_dy.rms_px < 0.3);
    assert!(vision::report::calibration_report(&stereo).is_ok());
}

#[test]
fn parts_of_charuco_boards_calibrate_both_cameras() {
    cameras_from("charuco:9x7:DICT_5X5_100", 0.4);
    cameras_from("charuco:8x6:DICT_4X4_50", 0.4);
}

#[test]
fn asymmetric_circles_calibrate_both_cameras() {
    cameras_from("circles:4x9", 0.6);
}

#[test]
fn another_board_than_the_one_asked_for_is_no_board() {
    let camera = rig().left;
    let mut rng = rng(1004);
    let kinds =
        ["charuco:9x7:DICT_5X5_100", "circles:4x9"].map(|n| n.parse::<BoardKind>().unwrap());
    for (kind, others) in kinds.iter().zip([
        [
            "charuco:9x7:DICT_6X6_250",
            "charuco:9x7:DICT_4X4_50",
            "9x7",
            "circles:4x9",
        ],
        [
            "circles:4x11",
            "circles:4x8",
            "circles:3x9",
            "charuco:7x5:DICT_4X4_50",
        ],
    ]) {
        let image = render_of(&camera, &poses(kind, 1)[0], 2.0, &mut rng, drawn(kind));
        assert!(kind.detect(&image, &RefineOptions::default()).is_ok());
        for other in others {
            let found = other
                .parse::<BoardKind>()
                .unwrap()
                .detect(&image, &RefineOptions::default());
            assert!(found.is_err(), "{kind:?} taken for {other}");
        }
    }
}
