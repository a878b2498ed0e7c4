//! What goes wrong in a laboratory, and that it is named.

mod synthetic;

use hal::GrayImage;
use nalgebra::{Isometry3, Point2, Vector3};
use synthetic::{BOARD, pairs, poses, render, rig, rng};
use vision::calibrate::{
    Board, BoardPair, CalibrationError, RejectReason, StereoCalibration, StereoOptions,
    calibrate_stereo,
};
use vision::detect::{BoardNotFound, BoardSize, RefineOptions, detect_board};
use vision::register::{RecordedPose, RegistrationError, RegistrationOptions, Target, register};

fn calibrate(pairs: &[BoardPair]) -> Result<StereoCalibration, CalibrationError> {
    calibrate_stereo(&BOARD, pairs, (640, 480), vec![], &StereoOptions::default())
}

fn image(seed: u64) -> GrayImage {
    let mut rng = rng(seed);
    let pose = poses(1, 0.5, &mut rng)[0];
    render(&rig().left, &pose, &BOARD, 3.0, &mut rng)
}

fn detect(image: &GrayImage, cols: usize, rows: usize) -> Result<Vec<Point2<f64>>, BoardNotFound> {
    let size = BoardSize { cols, rows };
    detect_board(image, size, &RefineOptions::default()).map(|b| b.corners)
}

#[test]
fn rendered_boards_are_found_where_they_are() {
    for seed in 0..6 {
        let mut rng = rng(seed);
        let pose = poses(1, 0.5, &mut rng)[0];
        let camera = rig().left;
        let image = render(&camera, &pose, &BOARD, 3.0, &mut rng);
        let truth = synthetic::pair(&rig(), &pose, 0.0, &mut rng).left;
        let found = detect(&image, 9, 6).unwrap();
        let square: f64 = found
            .iter()
            .zip(&truth)
            .map(|(a, b)| (a - b).norm_squared())
            .sum();
        let rms = (square / 54.0).sqrt();
        println!("seed {seed}: {rms:.3} px");
        assert!(rms < 0.1, "seed {seed}: {rms}");
    }
}

#[test]
fn a_wrong_size_is_refused() {
    let image = image(1);
    for (cols, rows) in [(8, 6), (9, 5), (7, 7), (10, 7), (6, 6)] {
        let error = detect(&image, cols, rows).unwrap_err();
        assert!(
            matches!(error, BoardNotFound::WrongSize { .. }),
            "{cols} x {rows}: {error}"
        );
    }
    assert!(matches!(
        detect(&image, 2, 9),
        Err(BoardNotFound::TooSmall { .. })
    ));
    // A board held the other way is the same board.
    assert_eq!(detect(&image, 6, 9).unwrap().len(), 54);
}

#[test]
fn missing_and_covered_boards_are_refused() {
    let empty = GrayImage::filled(640, 480, 120);
    assert!(matches!(
        detect(&empty, 9, 6),
        Err(BoardNotFound::Nothing { .. })
    ));
    let tiny = GrayImage::filled(3, 2, 0);
    assert!(detect(&tiny, 9, 6).is_err());
    // A hand over some corners.
    let mut covered = image(2);
    let corners = detect(&covered, 9, 6).unwrap();
    let at = corners[20];
    for (k, v) in covered.pixels_mut().iter_mut().enumerate() {
        let (x, y) = ((k % 640) as f64, (k / 640) as f64);
        if (x - at.x).hypot(y - at.y) < 30.0 {
            *v = 150;
        }
    }
    let error = detect(&covered, 9, 6).unwrap_err();
    assert!(matches!(error, BoardNotFound::WrongSize { .. }), "{error}");
}

#[test]
fn a_false_corner_is_noticed() {
    let mut rng = rng(3);
    let poses = poses(8, 0.6, &mut rng);
    let clean = pairs(&poses, 0.15, &mut rng);
    // A gross one by its own board,
    let mut gross = clean.clone();
    gross[2].right[17].x += 4.0;
    let c = calibrate(&gross).unwrap();
    assert!(
        matches!(
            &c.rejected[..],
            [r] if matches!(&r.reason, RejectReason::FalseCorner { image, corner: 17, .. } if image == "right02.png")
        ),
        "{:?}",
        c.rejected
    );
    // a small one by the fit.
    let mut small = clean.clone();
    small[5].left[30].y -= 1.6;
    let c = calibrate(&small).unwrap();
    assert!(
        matches!(
            &c.rejected[..],
            [r] if matches!(&r.reason, RejectReason::Corner { image, corner: 30, .. } if image == "left05.png")
        ),
        "{:?}",
        c.rejected
    );
    assert_eq!(c.views.len(), 8);
}

#[test]
fn the_end_of_a_line_bent_away_costs_its_corners_and_not_their_image() {
    let mut rng = rng(8);
    let poses = poses(8, 0.6, &mut rng);
    let mut views = pairs(&poses, 0.1, &mut rng);
    // Where a lens folds over, a column may run off smoothly: no single corner shows it.
    for (row, off) in [(2, 0.16), (3, 1.3), (4, 4.3), (5, 10.2)] {
        views[1].right[9 * row].x -= off;
    }
    let c = calibrate(&views).unwrap();
    let corners = c.rejected.iter().filter(|r| {
        matches!(&r.reason, RejectReason::Corner { image, corner, .. }
            if image == "right01.png" && corner % 9 == 0)
    });
    assert_eq!((c.views.len(), corners.count()), (8, 3), "{:?}", c.rejected);
    assert!((c.rig.left.fx / rig().left.fx - 1.0).abs() < 2e-3);
}

#[test]
fn a_view_that_the_others_contradict_is_rejected_by_name() {
    let mut rng = rng(4);
    let poses = poses(9, 0.6, &mut rng);
    let mut views = pairs(&poses, 0.15, &mut rng);
    // The board was bent: a smooth error that no single corner shows.
    for (k, p) in views[4].left.iter_mut().enumerate() {
        let (c, r) = ((k % 9) as f64 - 4.0, (k / 9) as f64 - 2.5);
        p.y += 0.2 * (c * c / 2.0 - r * r);
    }
    let c = calibrate(&views).unwrap();
    assert!(
        c.rejected
            .iter()
            .any(|r| r.left == "left04.png" && matches!(r.reason, RejectReason::View { .. })),
        "{:?}",
        c.rejected
    );
    assert_eq!(c.views.len(), 8);
}

#[test]
fn flipped_labels_are_named() {
    let mut rng = rng(5);
    let poses = poses(7, 0.6, &mut rng);
    let mut views = pairs(&poses, 0.15, &mut rng);
    views[3].right.reverse();
    let error = calibrate(&views).unwrap_err();
    assert!(
        matches!(&error, CalibrationError::Flipped { right, .. } if right == "right03.png"),
        "{error}"
    );
}

#[test]
fn too_few_and_parallel_views_are_refused() {
    let mut rng = rng(6);
    let few = poses(2, 0.6, &mut rng);
    let error = calibrate(&pairs(&few, 0.15, &mut rng)).unwrap_err();
    assert!(
        matches!(error, CalibrationError::TooFewViews { usable: 2, .. }),
        "{error}"
    );
    let parallel: Vec<_> = (0..8)
        .map(|k| {
            let k = f64::from(k);
            Isometry3::new(
                Vector3::new(-0.08 + 0.004 * k, -0.06, 0.36 + 0.02 * k),
                Vector3::zeros(),
            )
        })
        .collect();
    let error = calibrate(&pairs(&parallel, 0.15, &mut rng)).unwrap_err();
    println!("{error}");
    assert!(
        matches!(error, CalibrationError::Degenerate { .. }),
        "{error}"
    );
    let none = Board {
        square: f64::NAN,
        ..BOARD
    };
    let error = calibrate_stereo(&none, &[], (640, 480), vec![], &StereoOptions::default());
    assert!(matches!(error, Err(CalibrationError::Board { .. })));
    let mut short = pairs(&poses(4, 0.6, &mut rng), 0.1, &mut rng);
    short[1].left.pop();
    let error = calibrate(&short).unwrap_err();
    assert!(
        matches!(error, CalibrationError::CornerCount { found: 53, .. }),
        "{error}"
    );
}

fn recorded(count: usize, turning: bool) -> Vec<RecordedPose> {
    let mut rng = rng(7);
    let flange_from_board = Isometry3::translation(0.02, 0.01, 0.05);
    let boards = if turning {
        poses(count, 0.5, &mut rng)
    } else {
        (0..count)
            .map(|k| Isometry3::translation(-0.08 + 0.004 * k as f64, -0.06, 0.4))
            .collect()
    };
    pairs(&boards, 0.1, &mut rng)
        .into_iter()
        .zip(&boards)
        .map(|(pair, pose)| RecordedPose {
            name: pair.left_name,
            world_from_flange: hal::Transform::assume(pose * flange_from_board.inverse()),
            left: pair.left,
            right: pair.right,
        })
        .collect()
}

#[test]
fn registrations_that_cannot_be_are_refused() {
    let options = RegistrationOptions::default();
    let go = |rig: &vision::StereoRig, poses: &[RecordedPose]| {
        register(rig, None, &Target::Board(BOARD), poses, &options)
    };
    assert!(go(&rig(), &recorded(8, true)).is_ok());
    let error = go(&rig(), &recorded(2, true)).unwrap_err();
    assert!(matches!(error, RegistrationError::TooFewPoses { .. }));
    let error = go(&rig(), &recorded(8, false)).unwrap_err();
    assert!(
        matches!(error, RegistrationError::Degenerate { .. }),
        "{error}"
    );
    let mut other = rig();
    other.right.cy += 12.0;
    let error = go(&other, &recorded(8, true)).unwrap_err();
    assert!(
        matches!(error, RegistrationError::OtherCalibration { .. }),
        "{error}"
    );
    let mut short = recorded(8, true);
    short[2].left.pop();
    let error = go(&rig(), &short).unwrap_err();
    assert!(
        matches!(error, RegistrationError::PixelCount { .. }),
        "{error}"
    );
}
