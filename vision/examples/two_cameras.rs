//! Two cameras see a point and a chessboard: the point is projected and triangulated, the board is
//! drawn, found in the image and measured.
//!
//! `cargo run --release -p vision --example two_cameras`
#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use hal::{GrayImage, Transform};
use nalgebra::{Isometry3, Matrix2, Point2, Point3, Vector3};
use vision::camera::{Distortion, StereoRig, View, triangulate};
use vision::detect::{BoardSize, RefineOptions, detect_board};
use vision::{Camera, DistortedPx};

const BOARD: BoardSize = BoardSize { cols: 6, rows: 5 };
/// Side of a square \[m\].
const SQUARE: f64 = 0.02;
/// Standard deviation of a pixel along each axis \[px\].
const PIXEL_SIGMA: f64 = 0.1;
/// Samples of a pixel along each axis.
const SAMPLES: u32 = 4;

fn rig() -> StereoRig {
    let camera = Camera {
        width: 640,
        height: 480,
        fx: 800.0,
        fy: 800.0,
        cx: 320.0,
        cy: 240.0,
        distortion: Distortion {
            k1: -0.1,
            ..Distortion::default()
        },
    };
    StereoRig {
        left: camera,
        right: camera,
        // 80 mm apart, the right one turned inwards.
        right_from_left: Transform::assume(Isometry3::new(
            Vector3::new(-0.08, 0.0, 0.01),
            Vector3::new(0.0, 0.15, 0.0),
        )),
        container: None,
    }
}

/// Grey of the board's plane, x right and y down from the first inner corner \[m\].
fn grey(x: f64, y: f64) -> f64 {
    let (column, row) = ((x / SQUARE).floor(), (y / SQUARE).floor());
    let inside = |k: f64, corners: usize| k >= -1.0 && k < corners as f64;
    if !(inside(column, BOARD.cols) && inside(row, BOARD.rows)) {
        return 200.0;
    }
    if (column + row).rem_euclid(2.0) < 0.5 {
        30.0
    } else {
        220.0
    }
}

/// The board, facing the left camera with its first inner corner at `origin`, as a camera sees it.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "grey values are 30 to 220"
)]
fn picture(view: &View, origin: &Point3<f64>) -> Result<GrayImage, Box<dyn std::error::Error>> {
    let mut pixels = Vec::with_capacity(view.camera.width * view.camera.height);
    let offset = |k: u32| (f64::from(k) + 0.5) / f64::from(SAMPLES) - 0.5;
    for row in 0..view.camera.height {
        for column in 0..view.camera.width {
            let mut sum = 0.0;
            for (i, j) in (0..SAMPLES).flat_map(|i| (0..SAMPLES).map(move |j| (i, j))) {
                let px = DistortedPx::new(column as f64 + offset(i), row as f64 + offset(j));
                let ray = view.ray(px).ok_or("a pixel without a ray")?;
                let way = (origin.z - ray.origin.z) / ray.direction.z;
                let at = ray.origin + ray.direction * way;
                sum += grey(at.x - origin.x, at.y - origin.y);
            }
            pixels.push((sum / f64::from(SAMPLES * SAMPLES)).round() as u8);
        }
    }
    Ok(GrayImage::from_pixels(
        view.camera.width,
        view.camera.height,
        pixels,
    )?)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let views = rig().views();
    let covariances = [Matrix2::identity() * PIXEL_SIGMA * PIXEL_SIGMA; 2];

    let point = Vector3::new(0.02, -0.01, 0.45);
    let [Some(left), Some(right)] = [views[0].project(&point), views[1].project(&point)] else {
        return Err("the point is not in front of both cameras".into());
    };
    let found = triangulate(&views, &[left, right], &covariances)?;
    let sigma = found.covariance.diagonal().map(f64::sqrt) * 1e3;
    println!(
        "pixels: left {:.1} {:.1}, right {:.1} {:.1}",
        left.0.x, left.0.y, right.0.x, right.0.y
    );
    println!(
        "point:  {:.3} mm from where it is",
        (found.position.coords() - point).norm() * 1e3
    );
    println!(
        "        sigma {:.3} {:.3} {:.3} mm for {PIXEL_SIGMA} px",
        sigma.x, sigma.y, sigma.z
    );
    assert!((found.position.coords() - point).norm() < 1e-8);

    let origin = Point3::new(-0.05, -0.04, 0.45);
    let mut corners: Vec<Vec<Point2<f64>>> = Vec::new();
    for view in &views {
        let image = picture(view, &origin)?;
        corners.push(detect_board(&image, BOARD, &RefineOptions::default())?.corners);
    }
    let (mut worst, mut far): (f64, f64) = (0.0, 0.0);
    for (k, (column, row)) in BOARD.indices().enumerate() {
        let pixels = [DistortedPx(corners[0][k]), DistortedPx(corners[1][k])];
        let seen = triangulate(&views, &pixels, &covariances)?;
        let drawn = origin.coords + Vector3::new(column as f64, row as f64, 0.0) * SQUARE;
        let off = seen.position.coords() - drawn;
        let inverse = seen.covariance.try_inverse().ok_or("no covariance")?;
        worst = worst.max(off.norm());
        far = far.max(off.dot(&(inverse * off)).sqrt());
    }
    println!(
        "board:  {} corners, the worst {:.3} mm from where it was drawn",
        BOARD.count(),
        worst * 1e3
    );
    println!("        that is {far:.1} sigma for {PIXEL_SIGMA} px");
    // Half a millimetre of depth is a tenth of a pixel for cameras 80 mm apart.
    assert!(far < 4.0, "{far} sigma");
    Ok(())
}

#[test]
fn the_example_runs() {
    main().unwrap();
}
