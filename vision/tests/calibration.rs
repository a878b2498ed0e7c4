//! Calibration on real photographs, beside OpenCV.
#![expect(clippy::unwrap_used, reason = "a test")]

mod reference;

use nalgebra::Matrix3;
use vision::calibrate::{Board, BoardPair, StereoCalibration, StereoOptions, calibrate_stereo};
use vision::detect::{BoardSize, RefineOptions, detect_board};

const BOARD: Board = Board {
    size: BoardSize { cols: 9, rows: 6 },
    square: 0.025,
};

fn pairs(corners: impl Fn(&str) -> Vec<nalgebra::Point2<f64>>) -> Vec<BoardPair> {
    reference::names()
        .chunks(2)
        .map(|names| BoardPair {
            left: corners(&names[0]),
            right: corners(&names[1]),
            left_name: names[0].clone(),
            right_name: names[1].clone(),
        })
        .collect()
}

fn calibrate(pairs: &[BoardPair]) -> StereoCalibration {
    calibrate_stereo(
        &BOARD,
        pairs,
        (640, 480),
        Vec::new(),
        &StereoOptions::default(),
    )
    .unwrap()
}

#[test]
fn photographs_reach_opencvs_figures() {
    if reference::folder().is_none() {
        return;
    }
    let detect = |name: &str| {
        let image = reference::photograph(name).unwrap();
        detect_board(&image, BOARD.size, &RefineOptions::default())
            .unwrap()
            .corners
    };
    let c = calibrate(&pairs(detect));
    println!(
        "left {:.5} right {:.5} joint {:.6} dy {:.6} max {:.3} worst image {:.3} iterations {:?}",
        c.left_rms_px,
        c.right_rms_px,
        c.joint_rms_px,
        c.rectified_dy.rms_px,
        c.rectified_dy.max_px,
        c.worst_image_rms_px(),
        c.iterations,
    );
    assert!(c.rejected.is_empty(), "{:?}", c.rejected);
    assert_eq!(c.views.len(), 9);
    assert!(c.joint_rms_px <= 0.2184);
    assert!(c.rectified_dy.rms_px <= 0.175);
    for v in &c.views {
        println!("{} {:?} {:?}", v.left_name, v.rms_px, v.influence);
    }
}

#[test]
fn opencvs_corners_give_opencvs_parameters() {
    let Some(opencv) = reference::opencv() else {
        return;
    };
    let c = calibrate(&pairs(|name| reference::opencv_corners(&opencv, name)));
    let number = |v: &serde_json::Value| v.as_f64().unwrap();
    let close = |what: &str, ours: f64, theirs: &serde_json::Value, relative: f64| {
        let theirs = number(theirs);
        assert!(
            (ours - theirs).abs() <= relative * theirs.abs(),
            "{what}: {ours} against {theirs}"
        );
    };
    close("left rms", c.left_rms_px, &opencv["left_rms_px"], 1e-4);
    close("right rms", c.right_rms_px, &opencv["right_rms_px"], 1e-4);
    close("joint rms", c.joint_rms_px, &opencv["joint_rms_px"], 1e-4);
    close(
        "dy",
        c.rectified_dy.rms_px,
        &opencv["rectified_dy_rms_px"],
        1e-4,
    );
    for (camera, k, d) in [(c.rig.left, "K1", "D1"), (c.rig.right, "K2", "D2")] {
        let m: Matrix3<f64> = camera.matrix();
        for (i, j) in [(0, 0), (1, 1), (0, 2), (1, 2)] {
            close(k, m[(i, j)], &opencv[k][i][j], 1e-4);
        }
        for (i, value) in camera.distortion.to_array().into_iter().enumerate() {
            // OpenCV stops 1e-4 sigma of k3 short of the optimum: with the tightest criteria that
            // it accepts it ends at a cost 5e-12 above ours, 1.1e-4 of k3 away.
            close(d, value, &opencv[d][i], if i == 4 { 2e-4 } else { 1e-4 });
        }
    }
    let pose = c.rig.right_from_left.isometry();
    let r = pose.rotation.to_rotation_matrix();
    for i in 0..3 {
        let t = pose.translation.vector[i] * 1e3;
        close("T", t, &opencv["T_right_from_left_mm"][i], 1e-4);
        for j in 0..3 {
            close("R", r[(i, j)], &opencv["R_right_from_left"][i][j], 1e-4);
        }
    }
}

#[test]
fn the_report_is_one_page_with_everything() {
    let Some(opencv) = reference::opencv() else {
        return;
    };
    let mut corners = pairs(|name| reference::opencv_corners(&opencv, name));
    corners[3].left[10].x += 5.0;
    let page = vision::report::calibration_report(&calibrate(&corners)).unwrap();
    assert!(page.starts_with("<!DOCTYPE html>") && page.ends_with("</html>\n"));
    assert_eq!(page.matches("<svg").count(), 5);
    assert!(
        !page.contains("http://")
            || page.matches("http://").count() == page.matches("xmlns=\"http://").count()
    );
    assert!(!page.contains("<script src") && !page.contains("<link"));
    for part in [
        "left04.jpg: corner 10",
        "Joint RMS",
        "left fx",
        "R z",
        "Coverage",
        "Epipolar",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("NaN"));
}
