//! Rectification: both images as if taken by two parallel cameras, side by side or one above the
//! other.
//!
//! Bouguet's algorithm as OpenCV's `stereoRectify` defines it, so that figures of both can be
//! compared: rotate each camera half-way, turn both so that the baseline lies along the rows
//! (along the columns where it is nearer to those), and choose the new camera matrix from the images' borders.

use nalgebra::{Point2, Rotation3, Vector2, Vector3};

use super::BoardPair;
use super::stereo::seen;
use crate::camera::{Camera, DistortedPx, StereoRig};

/// A pair of rectifying rotations and the cameras of the rectified images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectification {
    /// From the left camera's axes to the rectified ones.
    pub left: Rotation3<f64>,
    /// From the right camera's axes to the rectified ones.
    pub right: Rotation3<f64>,
    /// Focal length of both rectified images \[px\].
    pub focal: f64,
    /// Principal points, left and right \[px\].
    pub centres: [Point2<f64>; 2],
    /// Position of the right camera along the baseline's axis times -1: the last column of
    /// OpenCV's P2 over the focal length \[m\].
    pub shift: f64,
    /// Whether the baseline lies along the columns: cameras one above the other.
    pub vertical: bool,
}

/// Differences of corresponding corners after rectification, across the baseline \[px\]: vertical
/// ones for cameras side by side, horizontal ones for cameras one above the other.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct RectifiedDy {
    /// Root mean square.
    pub rms_px: f64,
    /// Greatest absolute value.
    pub max_px: f64,
}

/// OpenCV's rectification with alpha = 0 (only valid pixels) and equal principal points.
/// `None` without a baseline. Where a border cannot be undistorted or is turned out of view, the
/// mean focal length and the images' centres serve.
pub fn rectify(rig: &StereoRig) -> Option<Rectification> {
    let right_from_left = rig.right_from_left.isometry();
    let half = Rotation3::from_scaled_axis(right_from_left.rotation.scaled_axis() * -0.5);
    let t = half * right_from_left.translation.vector;
    let vertical = t.y.abs() > t.x.abs();
    let along_axis = usize::from(vertical);
    if t[along_axis] == 0.0 || !t.norm().is_finite() {
        return None;
    }
    let mut along = Vector3::zeros();
    along[along_axis] = t[along_axis].signum();
    let axis = t.cross(&along);
    let turn = if axis.norm() > 0.0 {
        let angle = (t[along_axis].abs() / t.norm()).min(1.0).acos();
        Rotation3::from_scaled_axis(axis.normalize() * angle)
    } else {
        Rotation3::identity()
    };
    let (left, right) = (turn * half.inverse(), turn * half);
    let shift = (right * right_from_left.translation.vector)[along_axis];

    let mut focal = if vertical {
        f64::midpoint(rig.left.fx, rig.right.fx)
    } else {
        f64::midpoint(rig.left.fy, rig.right.fy)
    };
    let middle =
        |camera: &Camera| Vector2::new(camera.width as f64 - 1.0, camera.height as f64 - 1.0) / 2.0;
    let mut centre = (middle(&rig.left) + middle(&rig.right)) / 2.0;
    if let Some((best, scale)) = inside(rig, [&left, &right], focal) {
        centre = best;
        focal *= scale;
    }
    Some(Rectification {
        left,
        right,
        focal,
        centres: [Point2::from(centre); 2],
        shift,
        vertical,
    })
}

/// Principal point and scale of the focal length with which the rectified images hold valid
/// pixels only.
fn inside(
    rig: &StereoRig,
    [left, right]: [&Rotation3<f64>; 2],
    focal: f64,
) -> Option<(Vector2<f64>, f64)> {
    let sides = [(&rig.left, left), (&rig.right, right)];
    let mut centre = Vector2::zeros();
    for (camera, rotation) in sides {
        // The image's borders stay centred on average.
        let (w, h) = (camera.width as f64, camera.height as f64);
        let mut mean = Vector2::zeros();
        for (x, y) in [
            (0.0, 0.0),
            (w - 1.0, 0.0),
            (0.0, h - 1.0),
            (w - 1.0, h - 1.0),
        ] {
            mean += border(camera, rotation, x, y)? * focal / 4.0;
        }
        centre += (Vector2::new((w - 1.0) / 2.0, (h - 1.0) / 2.0) - mean) / 2.0;
    }
    let mut scale = 0.0_f64;
    for (camera, rotation) in sides {
        let (low, high) = inner_rectangle(camera, rotation)?;
        let (w, h) = (camera.width as f64 - 1.0, camera.height as f64 - 1.0);
        for s in [
            centre.x / -(low.x * focal),
            centre.y / -(low.y * focal),
            (w - centre.x) / (high.x * focal),
            (h - centre.y) / (high.y * focal),
        ] {
            scale = scale.max(s);
        }
    }
    (scale > 0.0 && scale.is_finite()).then_some((centre, scale))
}

/// RMS and maximum of the difference across the baseline of all corners of all pairs; NaN for
/// rigs that [`rectify`] refuses.
pub fn rectified_dy<'a>(
    rig: &StereoRig,
    pairs: impl Iterator<Item = &'a BoardPair>,
) -> RectifiedDy {
    let mut result = RectifiedDy {
        rms_px: f64::NAN,
        max_px: f64::NAN,
    };
    let Some(r) = rectify(rig) else {
        return result;
    };
    let (mut sum, mut max, mut count) = (0.0, 0.0_f64, 0.0);
    let both = pairs.flat_map(|p| p.left.iter().zip(&p.right));
    for (a, b) in both.filter(|(a, b)| seen(a) && seen(b)) {
        let left = rectified(&rig.left, &r.left, a.x, a.y);
        let right = rectified(&rig.right, &r.right, b.x, b.y);
        let (Some(left), Some(right)) = (left, right) else {
            // Turned out of the rectified view.
            continue;
        };
        let across = usize::from(!r.vertical);
        let dy = (left[across] - right[across]) * r.focal;
        sum += dy * dy;
        max = max.max(dy.abs());
        count += 1.0;
    }
    if count > 0.0 {
        result.rms_px = f64::sqrt(sum / count);
        result.max_px = max;
    }
    result
}

impl Rectification {
    /// Where a pixel of the left (0) or right (1) image lies in the rectified image \[px\].
    pub fn map(&self, rig: &StereoRig, side: usize, px: DistortedPx) -> Option<Point2<f64>> {
        let (camera, rotation) = if side == 0 {
            (&rig.left, &self.left)
        } else {
            (&rig.right, &self.right)
        };
        let p = rectified(camera, rotation, px.0.x, px.0.y)? * self.focal;
        Some(self.centres[side.min(1)] + p)
    }
}

/// Normalised rectified coordinates of a pixel.
fn rectified(camera: &Camera, rotation: &Rotation3<f64>, x: f64, y: f64) -> Option<Vector2<f64>> {
    let d = rotation * camera.direction(DistortedPx::new(x, y))?;
    (d.z > 0.0).then(|| d.xy() / d.z)
}

/// Normalised rectified coordinates of a pixel of the border, undistorted by five fixed-point
/// steps as OpenCV does: beyond the boards a fitted model may fold, so that no exact inverse
/// exists, and the choice of the new camera matrix needs none.
fn border(camera: &Camera, rotation: &Rotation3<f64>, x: f64, y: f64) -> Option<Vector2<f64>> {
    let start = Vector2::new((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy);
    let n = camera.distortion.invert_roughly(&start)?;
    let turned = rotation * Vector3::new(n.x, n.y, 1.0);
    (turned.z > 0.0).then(|| turned.xy() / turned.z)
}

/// Greatest rectangle (normalised) inside the image, from a grid of nine by nine points as
/// OpenCV takes it.
fn inner_rectangle(
    camera: &Camera,
    rotation: &Rotation3<f64>,
) -> Option<(Vector2<f64>, Vector2<f64>)> {
    const N: usize = 9;
    let mut low = Vector2::repeat(f64::NEG_INFINITY);
    let mut high = Vector2::repeat(f64::INFINITY);
    for j in 0..N {
        for i in 0..N {
            let at = |k: usize, size: usize| k as f64 * (size as f64 - 1.0) / (N as f64 - 1.0);
            let p = border(camera, rotation, at(i, camera.width), at(j, camera.height))?;
            if i == 0 {
                low.x = low.x.max(p.x);
            }
            if i == N - 1 {
                high.x = high.x.min(p.x);
            }
            if j == 0 {
                low.y = low.y.max(p.y);
            }
            if j == N - 1 {
                high.y = high.y.min(p.y);
            }
        }
    }
    Some((low, high))
}
