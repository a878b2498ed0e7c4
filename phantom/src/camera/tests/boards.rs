//! Boards against backward rays, and boards that cannot be seen.

use hal::Transform;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use super::scene::rig;
use crate::camera::coverage::SparsePlane;
use crate::camera::{BoardError, BoardView, CameraSettings, Side, Through, calibration_boards};

/// Whether a ray through a pixel meets a black square.
fn black(view: &crate::camera::View, board: &BoardView, pixel: [f64; 2]) -> bool {
    let ray = view.ray(pixel, Through::OpenAir).unwrap();
    let board_from_world = board.world_from_board.isometry().inverse();
    let o = board_from_world * ray.origin;
    let d = board_from_world.rotation * ray.direction;
    let p = o - d * (o.z / d.z);
    let (i, j) = (
        (p.x / board.square).floor() + 1.0,
        (p.y / board.square).floor() + 1.0,
    );
    (0.0..=board.columns as f64).contains(&i)
        && (0.0..=board.rows as f64).contains(&j)
        && (i + j) % 2.0 == 0.0
}

#[test]
fn squares_cover_what_backward_rays_meet() {
    let settings = CameraSettings::paper();
    let rig = rig(&settings, 1);
    for board in calibration_boards(rig.truth(), 3, 5) {
        for side in Side::BOTH {
            let view = rig.truth().view(side);
            let mut paper = SparsePlane::new(settings.width_px, settings.height_px);
            let mut ink = paper.clone();
            board.paint(&view, &mut paper, &mut ink);
            ink.resolve();
            let (mut sum, mut squares, mut n) = (0.0, 0.0, 0.0);
            for y in (100..380).step_by(7) {
                for x in (150..490).step_by(3) {
                    let rays = (0..256).filter(|k| {
                        let sub = |k: i32| (f64::from(k) + 0.5) / 16.0 - 0.5;
                        let at = [x as f64 + sub(k % 16), y as f64 + sub(k / 16)];
                        black(&view, &board, at)
                    });
                    let truth = rays.count() as f64 / 256.0;
                    let drawn = f64::from(ink.row(y)[x]).abs();
                    sum += drawn - truth;
                    squares += (drawn - truth).powi(2);
                    n += 1.0;
                }
            }
            // 16 x 16 rays know an edge pixel's coverage to about 0.01.
            assert!((squares / n).sqrt() < 0.006, "{}", (squares / n).sqrt());
            assert!((sum / n).abs() < 5e-4, "{}", sum / n);
        }
    }
}

#[test]
fn every_calibration_view_can_be_photographed() {
    for settings in [CameraSettings::ideal(), CameraSettings::paper().at_1280()] {
        for separation in [30.0, 90.0] {
            let settings = CameraSettings {
                separation_deg: separation,
                ..settings.clone()
            };
            let mut rig = rig(&settings, 1);
            let mut visible = 0;
            for board in calibration_boards(rig.truth(), 20, 1) {
                rig.board_pair(&board, 0).unwrap();
                for side in Side::BOTH {
                    let view = rig.truth().view(side);
                    let inside = |p: [f64; 2]| {
                        (5.0..settings.width_px as f64 - 5.0).contains(&p[0])
                            && (5.0..settings.height_px as f64 - 5.0).contains(&p[1])
                    };
                    visible += usize::from(board.corners().all(|c| {
                        let world = board.world_from_board.isometry() * c;
                        view.project(&world, Through::OpenAir).is_some_and(inside)
                    }));
                }
            }
            assert_eq!(visible, 40, "boards wholly in view at {separation} deg");
        }
    }
}

#[test]
fn boards_that_cannot_be_seen_are_refused() {
    let mut rig = rig(&CameraSettings::ideal(), 1);
    let good = calibration_boards(rig.truth(), 1, 1)[0];
    let back = BoardView {
        world_from_board: Transform::assume(
            good.world_from_board.isometry()
                * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), core::f64::consts::PI),
        ),
        ..good
    };
    let refused = |rig: &mut crate::camera::StereoRig, board| rig.board_pair(&board, 0).err();
    assert!(matches!(
        refused(&mut rig, back),
        Some(BoardError::Turned { camera: "left", .. })
    ));
    let behind = BoardView {
        world_from_board: Transform::assume(
            rig.world_from_left_camera().isometry()
                * Isometry3::from_parts(
                    Translation3::new(0.0, 0.0, -0.3),
                    UnitQuaternion::identity(),
                ),
        ),
        ..good
    };
    assert!(matches!(
        refused(&mut rig, behind),
        Some(BoardError::Turned { .. })
    ));
    for (columns, square) in [(1, 0.01), (9, 0.0), (9, f64::NAN), (9, 2.0)] {
        let none = BoardView {
            columns,
            square,
            ..good
        };
        assert!(matches!(
            refused(&mut rig, none),
            Some(BoardError::Size { .. })
        ));
    }
    let corners: Vec<Point3<f64>> = good.corners().collect();
    assert_eq!(corners.len(), 54);
    assert_eq!(corners[9], Point3::new(0.0, good.square, 0.0));
}
