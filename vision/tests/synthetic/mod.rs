//! A rig, boards and images made up for tests.
#![allow(
    dead_code,
    clippy::unwrap_used,
    clippy::allow_attributes,
    reason = "for tests, of which each uses a part"
)]

use hal::{GrayImage, Transform};
use nalgebra::{Isometry3, Point2, Point3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use vision::calibrate::{Board, BoardPair, Layout};
use vision::camera::{Camera, Distortion, StereoRig};
use vision::detect::BoardSize;

pub(crate) const BOARD: Board = Board {
    size: BoardSize { cols: 9, rows: 6 },
    square: 0.025,
    layout: Layout::Square,
};

/// Like the photographs' rig.
pub(crate) fn rig() -> StereoRig {
    let camera = |f: f64, cx: f64, d: [f64; 5]| Camera {
        width: 640,
        height: 480,
        fx: f,
        fy: f + 0.2,
        cx,
        cy: 240.0,
        distortion: Distortion::from_array(d),
    };
    StereoRig {
        left: camera(533.5, 342.0, [-0.28, 0.09, 0.0012, -0.0002, -0.01]),
        right: camera(537.0, 327.0, [-0.29, 0.10, -0.0006, 0.0003, -0.01]),
        right_from_left: Transform::assume(Isometry3::new(
            Vector3::new(-0.0832, 0.0009, -0.0001),
            Vector3::new(0.007, 0.004, -0.0035),
        )),
        container: None,
    }
}

pub(crate) fn rng(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

pub(crate) fn gauss(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Board poses that fill the image, tilted by up to `tilt` about both axes \[rad\].
pub(crate) fn poses(count: usize, tilt: f64, rng: &mut ChaCha8Rng) -> Vec<Isometry3<f64>> {
    let rig = rig();
    let mut poses = Vec::new();
    while poses.len() < count {
        let mut within = |a: f64| rng.random_range(-a..=a);
        let turn = Vector3::new(within(tilt), within(tilt), within(0.5));
        let rotation = UnitQuaternion::from_scaled_axis(turn);
        let centre = Vector3::new(within(0.08) + 0.04, within(0.06), 0.42 + within(0.08));
        let middle = rotation * Vector3::new(0.1, 0.0625, 0.0);
        let pose = Isometry3::from_parts((centre - middle).into(), rotation);
        let inside =
            |px: &Point2<f64>| (8.0..631.0).contains(&px.x) && (8.0..471.0).contains(&px.y);
        let pair = pair(&rig, &pose, 0.0, &mut self::rng(0));
        if pair.left.iter().chain(&pair.right).all(inside) {
            poses.push(pose);
        }
    }
    poses
}

/// Corners of a board in both images with Gaussian noise of `sigma_px` per axis.
pub(crate) fn pair(
    rig: &StereoRig,
    left_from_board: &Isometry3<f64>,
    sigma_px: f64,
    rng: &mut ChaCha8Rng,
) -> BoardPair {
    let mut side = |k: usize| -> Vec<Point2<f64>> {
        let view = rig.views()[k];
        BOARD
            .points()
            .iter()
            .map(|p| {
                let at = left_from_board * Point3::new(p.x, p.y, 0.0);
                let mut px = view.project(&at.coords).unwrap().0;
                px.x += sigma_px * gauss(rng);
                px.y += sigma_px * gauss(rng);
                px
            })
            .collect()
    };
    BoardPair {
        left: side(0),
        right: side(1),
        left_name: "left.png".to_owned(),
        right_name: "right.png".to_owned(),
    }
}

/// Pairs with numbered names.
pub(crate) fn pairs(
    poses: &[Isometry3<f64>],
    sigma_px: f64,
    rng: &mut ChaCha8Rng,
) -> Vec<BoardPair> {
    let rig = rig();
    let mut pairs: Vec<_> = poses.iter().map(|p| pair(&rig, p, sigma_px, rng)).collect();
    for (k, pair) in pairs.iter_mut().enumerate() {
        pair.left_name = format!("left{k:02}.png");
        pair.right_name = format!("right{k:02}.png");
    }
    pairs
}

/// What a camera sees of a board with white margin on grey ground, four by four samples a pixel,
/// with noise of `sigma` grey levels.
pub(crate) fn render(
    camera: &Camera,
    camera_from_board: &Isometry3<f64>,
    board: &Board,
    sigma: f64,
    rng: &mut ChaCha8Rng,
) -> GrayImage {
    render_of(camera, camera_from_board, sigma, rng, |x, y| {
        let (u, v) = (x / board.square + 1.0, y / board.square + 1.0);
        let (w, h) = (board.size.cols as f64 + 1.0, board.size.rows as f64 + 1.0);
        let within = |margin: f64| u > -margin && v > -margin && u < w + margin && v < h + margin;
        if within(0.0) && (u.floor() + v.floor()).rem_euclid(2.0) < 0.5 {
            30.0
        } else if within(1.0) {
            215.0
        } else {
            110.0
        }
    })
}

/// What a camera sees of a plane whose grey at x, y \[m\] is `plane`.
pub(crate) fn render_of(
    camera: &Camera,
    camera_from_board: &Isometry3<f64>,
    sigma: f64,
    rng: &mut ChaCha8Rng,
    plane: impl Fn(f64, f64) -> f64,
) -> GrayImage {
    let mut image = GrayImage::filled(camera.width, camera.height, 0);
    let to_board = camera_from_board.inverse();
    let origin = to_board * Point3::origin();
    let grey = |x: f64, y: f64| -> f64 {
        let d = to_board.rotation
            * camera
                .direction(vision::DistortedPx::new(x, y))
                .unwrap_or_else(Vector3::z);
        let p = origin - d * (origin.z / d.z);
        plane(p.x, p.y)
    };
    for y in 0..camera.height {
        for x in 0..camera.width {
            let mut sum = 0.0;
            for k in 0..16 {
                let (dx, dy) = (f64::from(k % 4), f64::from(k / 4));
                sum += grey(x as f64 + (dx - 1.5) / 4.0, y as f64 + (dy - 1.5) / 4.0);
            }
            let value = sum / 16.0 + sigma * gauss(rng);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "clamped to a byte"
            )]
            {
                image.pixels_mut()[y * camera.width + x] = value.clamp(0.0, 255.0).round() as u8;
            }
        }
    }
    image
}
