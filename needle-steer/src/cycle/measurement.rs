//! From a pair of images or a sensed shape to the estimator.

use hal::frame::LeftCamera;
use hal::telemetry::Tracking;
use hal::{Position, SensedShape, SensedTip, StereoFrame};
use hybrid_control::{Health, Observation};
use nalgebra::{Isometry3, Point3};

use super::{Cycle, SHORT_PATH};
use crate::monitor::Trace;

impl Cycle {
    /// Images to curves to shape, with the base pose of their own instant.
    pub(super) fn track(&mut self, pair: &StereoFrame) -> Option<SensedTip> {
        let world_from_base = self.odometry.at(pair.left.stamp)?;
        let mut sight = self.sight.take()?;
        let tracked = sight.look(pair, &world_from_base, &self.telemetry.model.shape);
        let tip = match tracked {
            Ok(tracked) if tracked.status == Tracking::Tracked => self.measure(&tracked.shape),
            _ => {
                self.telemetry.tracking = tracked.map_or(Tracking::Lost, |tracked| tracked.status);
                None
            }
        };
        self.sight = Some(sight);
        tip
    }

    /// Takes a measurement in, with the base pose of its own instant; one that cannot be of this
    /// needle is left out.
    pub(super) fn measure(&mut self, shape: &SensedShape) -> Option<SensedTip> {
        let base = self.odometry.at(shape.stamp)?;
        let world_from_camera = self.bearings.world_from_left_camera;
        let in_world = |p: &Position<LeftCamera>| *(world_from_camera * *p).point();
        let tip = in_world(&shape.tip.position);
        let shaft = shape.points.iter().map(|p| in_world(&p.position));
        if !self.plausibility.admit(shape.stamp, &base, &tip, shaft) {
            self.telemetry.tracking = Tracking::Predicted;
            return None;
        }
        let sigma = (shape.tip.covariance.trace() / 3.0).sqrt();
        let axis = world_from_camera.rotate_direction(&shape.tip.direction);
        self.tissue.see_tip(shape.stamp, &tip, &axis, sigma);
        let then = self.tissue.field(shape.stamp);
        let at_rest = |p: Point3<f64>| then.map_or(p, |field| field.point_to_rest(&p));
        let moved = self.tissue.sigma(shape.stamp);
        self.shaft.clear();
        self.shaft.extend(
            shape
                .points
                .iter()
                .map(|p| (at_rest(in_world(&p.position)), p.sigma.hypot(moved))),
        );
        let tip_at_rest = at_rest(tip);
        let axis_at_rest = then.map_or(axis, |field| field.direction_to_rest(&axis));
        self.trace
            .observe(shape.stamp, &tip_at_rest, &axis_at_rest, &self.shaft);
        self.telemetry.model.path_off = self.trace.stretch().unwrap_or(f64::NAN);
        let health = self.estimator.observe(&Observation {
            stamp: shape.stamp,
            world_from_base: then.map_or(base, |field| field.pose_to_rest(&base)),
            position: tip_at_rest,
            position_sigma: sigma.hypot(moved),
            direction: axis_at_rest,
            direction_sigma: shape.tip.direction_sigma,
            shaft: &self.shaft,
            carried: self.tissue_moves() && !self.tissue.is_marked(),
        });
        self.tell_sway(shape, &base, sigma);
        self.telemetry.tracking = match health {
            Health::Used => Tracking::Tracked,
            Health::Stale | Health::Rejected => Tracking::Predicted,
        };
        self.telemetry.image_stamp = Some(shape.stamp);
        self.measured = Some((shape.stamp, shape.tip));
        Some(shape.tip)
    }

    /// What the estimator cannot explain of the tip's way may be the tissue's. A path laid while
    /// breathing was taken for cutting is laid anew.
    fn tell_sway(&mut self, shape: &SensedShape, base: &Isometry3<f64>, sigma: f64) {
        let tip = self.bearings.world_from_left_camera * shape.tip.position;
        let unexplained = tip.coords() - self.estimator.explained_way();
        let known = self
            .tissue
            .see_unexplained(shape.stamp, &unexplained, sigma);
        if known && self.estimator.depth() < SHORT_PATH {
            self.estimator.begin_anew(base);
            self.trace = Trace::default();
            let field = self.tissue.field(shape.stamp);
            let at_rest = field.map_or(*base, |field| field.pose_to_rest(base));
            let place = field.map_or(*tip.point(), |field| field.point_to_rest(tip.point()));
            // A model that cannot begin anew goes on from what it has.
            let _ = self.springs.begin_anew(&at_rest, &place.coords);
        }
    }
}
