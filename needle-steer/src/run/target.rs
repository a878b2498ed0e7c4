//! Where an insertion goes: checked whenever a target comes, placed when steering begins.

use hal::Position;
use hal::frame::LeftCamera;
use hybrid_control::{Means, Unreachable, reachable_at_start};
use nalgebra::{Point3, Vector3};

use super::Insertion;
use crate::aim::nominal_target;
use crate::config::{Config, TargetKind};
use crate::world::in_stereo_frame;

impl Insertion<'_> {
    /// Refuses a target that cannot be reached, as far as it is known before the start.
    pub(super) fn check_target(&self, config: &Config) -> Result<(), Unreachable> {
        let target = self.given_target.map_or_else(
            || self.expected_target(config),
            |target| (self.rig.bearings.world_from_left_camera * target).coords(),
        );
        reachable_at_start(
            self.cycle.estimator(),
            &target.into(),
            self.cycle.limits(),
            Means::of_law(&config.run.law),
        )
    }

    /// The target as it lies before anything moves \[m\].
    pub(super) fn expected_target(&self, config: &Config) -> Vector3<f64> {
        let ahead = config.needle.length_mm * 1e-3 + self.straight;
        let tip = self.start * Point3::new(0.0, 0.0, ahead);
        nominal_target(config, &tip.coords, &self.start)
    }

    /// Marks the tissue where the target is to be, so that its motion is known when it counts.
    pub(super) fn attach_marker(&self, config: &Config) {
        if let (TargetKind::Marker, Some(world)) = (config.target.kind, &self.rig.world) {
            world.attach_marker(&self.expected_target(config));
        }
    }

    /// The target in the stereo frame. In simulation the protocol places it by the true tip.
    pub(super) fn place_target(&self, config: &Config) -> Position<LeftCamera> {
        let registered = self.rig.left_from_world();
        let Some(world) = &self.rig.world else {
            let marker = self.rig.marker.newest().map(|seen| seen.position);
            return marker.or(self.given_target).unwrap_or_else(|| {
                let tip = self.cycle.telemetry().world_from_tip.origin().coords();
                in_stereo_frame(&nominal_target(config, &tip, &self.start), &registered)
            });
        };
        if let Some(target) = self.given_target {
            self.watch(target);
            return target;
        }
        let target = match config.target.kind {
            TargetKind::Marker => world
                .marker()
                .unwrap_or_else(|| self.expected_target(config)),
            _ => nominal_target(config, &world.true_tip(), &self.start),
        };
        world.watch(target);
        in_stereo_frame(&target, &world.stereo_from_world())
    }

    /// Another target, in the stereo frame.
    pub(super) fn aim(&mut self, target: Position<LeftCamera>) {
        self.given_target = Some(target);
        if self.aimed {
            self.cycle.set_target(target);
            self.watch(target);
        }
    }

    /// Keeps the score against a target in the stereo frame.
    pub(super) fn watch(&self, target: Position<LeftCamera>) {
        if let Some(world) = &self.rig.world {
            world.watch((world.stereo_from_world().inverse() * target).coords());
        }
    }
}
