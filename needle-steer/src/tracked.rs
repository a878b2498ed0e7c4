//! What is told of a tracked frame.

use hal::telemetry::Tracking;
use nalgebra::{Matrix3, Point3};
use serde::Serialize;
use vision::track::{FrameError, Tracked};

use crate::sight;

/// One frame's results.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    /// Number of the frame.
    pub frame: usize,
    /// `tracked`, `predicted` or `lost`.
    pub status: &'static str,
    /// The tip O in the left camera's frame; nothing while the needle is lost.
    pub tip_m: Option<[f64; 3]>,
    /// Points of the shaft, from where it comes into sight.
    pub shape_m: Option<Vec<[f64; 3]>>,
    /// Covariance of the tip.
    pub tip_covariance_m2: Option<[[f64; 3]; 3]>,
    /// The tip in the left image.
    pub left_tip_px: Option<[f64; 2]>,
    /// The tip in the right image.
    pub right_tip_px: Option<[f64; 2]>,
    /// The sharp point of a bevel.
    pub tip_point_m: Option<[f64; 3]>,
    /// Which step failed, in which image, and what it saw; `null` where the needle was measured.
    pub reason: Option<String>,
    /// The reason under its older name; only where the needle was not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
}

impl Line {
    /// Of `frame`; `bevel` is the bevel's length \[m\].
    pub fn new(frame: usize, tracked: &Tracked, refused: Option<&FrameError>, bevel: f64) -> Self {
        let status = match tracked.status {
            Tracking::Tracked => "tracked",
            Tracking::Predicted => "predicted",
            Tracking::None | Tracking::Lost => "lost",
        };
        let known = status != "lost";
        let shape = &tracked.shape;
        let tip = known.then(|| shape.tip.position.point());
        let pixel = |k: usize| {
            let curve = tracked.curves[k].filter(|_| known)?;
            Some([curve.tip().x, curve.tip().y])
        };
        let reason = refused
            .map(ToString::to_string)
            .or_else(|| tracked.loss.as_ref().map(sight::problem));
        Self {
            frame,
            status,
            tip_m: tip.map(coordinates),
            shape_m: known.then(|| {
                let points = shape.points.iter();
                points.map(|p| coordinates(p.position.point())).collect()
            }),
            tip_covariance_m2: known.then(|| rows(&shape.tip.covariance)),
            left_tip_px: pixel(0),
            right_tip_px: pixel(1),
            // Images do not show to which side of the axis the bevel's point lies.
            tip_point_m: tip
                .filter(|_| bevel > 0.0)
                .map(|tip| coordinates(&(tip + shape.tip.direction.into_inner() * bevel))),
            reason: reason.clone(),
            problem: reason,
        }
    }
}

fn coordinates(point: &Point3<f64>) -> [f64; 3] {
    point.coords.into()
}

fn rows(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    core::array::from_fn(|i| core::array::from_fn(|j| matrix[(i, j)]))
}
