//! Where an insertion goes: checked whenever a target comes, placed when steering begins.

use core::fmt::Write;

use hal::Position;
use hal::frame::LeftCamera;
use hybrid_control::{
    Means, Reach, ReachMonitor, Unreachable, lateral_error, reachable_at_start, target_ahead,
};
use nalgebra::{Point3, Vector3};

use super::{Insertion, REACH_TOLERANCE, RunError};
use crate::aim::{Aimed, Answer, TargetRefused, given_target, nominal_target};
use crate::bearings::freedom;
use crate::config::{Config, TargetKind};
use crate::controls::{Aim, Controls};
use crate::passing::Passing;
use crate::rig::{Demand, Misfit, Rig, follow};
use crate::world::in_stereo_frame;

/// Whether an insertion from where the arm stands may go to `given`, in the stereo frame, or to the
/// configuration's target where none is given. Nothing moves.
///
/// # Errors
/// [`RunError::Target`] where it may not; else as [`Insertion::begin`].
pub fn check_target(
    config: &Config,
    rig: &mut Rig,
    given: Option<Position<LeftCamera>>,
) -> Result<Aimed, RunError> {
    let mut insertion = Insertion::begin(config, rig)?;
    insertion.given_target = given.or(insertion.given_target);
    Ok(insertion.check_target(config)?)
}

impl Insertion<'_> {
    /// Where the target is expected before anything moves, in words: in both frames, and what
    /// steering has to give.
    ///
    /// # Errors
    /// It may not be gone to.
    pub fn preview(&self, config: &Config) -> Result<String, TargetRefused> {
        let aimed = self.check_target(config)?;
        let world_from_camera = self.rig.bearings.world_from_left_camera;
        let in_camera = self.given_target.unwrap_or_else(|| {
            world_from_camera.inverse() * Position::new(self.expected_target(config).into())
        });
        let [world, camera] = [*(world_from_camera * in_camera).point(), *in_camera.point()]
            .map(|p| format!("({:.1}, {:.1}, {:.1})", p.x * 1e3, p.y * 1e3, p.z * 1e3));
        let Aimed { ahead, aside, .. } = aimed;
        let mut words = format!(
            "target: {:.1} mm ahead of the tip, {:.1} mm beside its axis; World {world} mm, left \
             camera {camera} mm",
            ahead * 1e3,
            aside * 1e3
        );
        if let Some(Reach {
            miss,
            most: Some(most),
        }) = aimed.reach
        {
            let (miss, most) = (miss * 1e3, most * 1e3);
            let margin = most - miss;
            let _ = write!(
                words,
                "\nreach: {miss:.1} mm to be steered, {most:.1} mm can be: {margin:.1} mm are left"
            );
        }
        Ok(words)
    }

    /// Refuses a target that cannot be reached, as far as it is known before the start.
    pub(super) fn check_target(&self, config: &Config) -> Answer {
        let world_from_camera = self.rig.bearings.world_from_left_camera;
        let target = self.given_target.map_or_else(
            || self.expected_target(config).into(),
            |target| *(world_from_camera * target).point(),
        );
        self.judge(config, &target)
    }

    /// Whether the needle may go to `target` (World) from where it is now.
    fn judge(&self, config: &Config, target: &Point3<f64>) -> Answer {
        let estimator = self.cycle.estimator();
        let at_rest = self.cycle.at_rest_point(target);
        let base = self.cycle.telemetry().world_from_base;
        let wanted = Means::of_law(&config.run.law);
        let means = wanted.within(
            &freedom(&self.rig.bearings, &self.first),
            base.isometry(),
            &config.entry(),
        );
        if means == Means::NONE && wanted != means {
            let law = config.run.law.clone();
            return Err(Unreachable::NoMeans { law }.into());
        }
        let reachable = reachable_at_start(estimator, &at_rest, self.cycle.limits(), means);
        let reach = match reachable {
            Ok(reach) => Some(reach),
            Err(why @ (Unreachable::NonFinite | Unreachable::Behind { .. })) => {
                return Err(why.into());
            }
            Err(why) if config.run.check_reach => return Err(why.into()),
            Err(_) => None,
        };
        // The tip's plane is what passes a target, however the needle is bent.
        let tip = self.cycle.telemetry().world_from_tip;
        let aimed = Aimed {
            ahead: target_ahead(tip.isometry(), target),
            aside: lateral_error(tip.isometry(), target),
            reach,
        };
        if aimed.ahead <= 0.0 {
            let behind_mm = -aimed.ahead * 1e3;
            return Err(Unreachable::Behind { behind_mm }.into());
        }
        if config.run.check_reach {
            let depth = estimator
                .world_from_insertion()
                .inverse_transform_point(&at_rest)
                .z;
            self.judge_base(config, depth)?;
        }
        Ok(aimed)
    }

    /// Whether base and arm may go straight on until the tip is at `depth` \[m\].
    fn judge_base(&self, config: &Config, depth: f64) -> Result<(), TargetRefused> {
        let way = (depth - self.cycle.estimator().depth()).max(0.0);
        let base = self.cycle.telemetry().world_from_base;
        let there = base.isometry() * Point3::new(0.0, 0.0, way);
        if let Some(workspace) = config.workspace() {
            let by = workspace.excess(&there);
            if by > 0.0 {
                return Err(TargetRefused::Workspace { by_mm: by * 1e3 });
            }
        }
        // As deep as the configuration's target the arm was followed before.
        if depth <= Demand::of(config).depth {
            return Ok(());
        }
        let demand = Demand {
            depth: way,
            tilt: 0.0,
            shift: 0.0,
            length: config.needle.length_mm * 1e-3,
        };
        let joints = &self.cycle.telemetry().joints;
        match follow(&self.rig.bearings.chain, joints, &demand) {
            Err(why @ (Misfit::MeetsEnd { .. } | Misfit::Singular { .. })) => {
                Err(TargetRefused::Arm(why))
            }
            // The room that a start wants is no condition on the way.
            _ => Ok(()),
        }
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
            // The truth of a point in World is that point, wherever the cameras see it.
            let in_world = given_target(config, &registered) == Some(target)
                && config.target.kind == TargetKind::World;
            if in_world {
                world.watch(config.target.point().coords);
            } else {
                self.watch(target);
            }
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

    /// Looks at the targets that were given meanwhile, and answers. One that is refused leaves the
    /// one that there is.
    pub(super) fn hear_targets(&mut self, config: &Config, controls: &Controls) {
        while let Some(aim) = controls.next_aim() {
            self.aim(config, aim);
        }
    }

    fn aim(&mut self, config: &Config, aim: Aim) {
        let target = aim.target;
        let answer = if config.target.kind == TargetKind::Marker {
            Err(TargetRefused::Marker)
        } else {
            let in_world = self.rig.bearings.world_from_left_camera * target;
            self.judge(config, in_world.point())
        };
        if answer.is_ok() {
            self.given_target = Some(target);
            if self.aimed {
                self.cycle.set_target(target);
                self.watch(target);
                // What was found out on the way to another one says nothing of this one.
                self.progress.reset();
                self.passing = Passing::default();
                self.reach = ReachMonitor::new(REACH_TOLERANCE);
            }
        }
        aim.answer(answer);
    }

    /// Keeps the score against a target in the stereo frame.
    pub(super) fn watch(&self, target: Position<LeftCamera>) {
        if let Some(world) = &self.rig.world {
            world.watch((world.stereo_from_world().inverse() * target).coords());
        }
    }
}
