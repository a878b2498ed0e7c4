//! Flaws between the pose that joints and calibration say and the pose the needle has.

use core::f64::consts::{SQRT_2, TAU};

use hal::Transform;
use hal::frame::{NeedleBase, World};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use crate::draw::{Draw, Purpose, normal, stream, uniform};
use crate::settings::Settings;
use crate::truth::Wrench;

/// One component of the hidden kinematic error: a wave over the workspace.
#[derive(Clone, Copy, Debug)]
struct Wave {
    number: Vector3<f64>,
    phase: f64,
}

/// Robot and mounting of one run: turns nominal base poses into true ones.
#[derive(Clone, Debug)]
pub(crate) struct Robot {
    /// Tilt about the nominal tip at the start, in World.
    tilt: Isometry3<f64>,
    waves: [Wave; 6],
    kinematic: (f64, f64),
    /// Holder to needle: offset, tilt, azimuth.
    mounting: Isometry3<f64>,
    lag: f64,
    compliance: (f64, f64),
    nominal: Isometry3<f64>,
    lagged: Isometry3<f64>,
    yielded: Isometry3<f64>,
}

impl Robot {
    /// The robot of run `seed`, with the needle's nominal base at `world_from_base` at the start.
    pub(crate) fn new(
        settings: &Settings,
        draw: &Draw,
        world_from_base: &Transform<World, NeedleBase>,
        seed: u64,
    ) -> Self {
        let robot = &settings.robot;
        let start = world_from_base.isometry();
        let length = settings.needle.length_mm * 1e-3;
        let tip = start * Point3::new(0.0, 0.0, length);
        let rotation = start.rotation
            * UnitQuaternion::from_scaled_axis(Vector3::new(draw.tilt[0], draw.tilt[1], 0.0))
            * start.rotation.inverse();
        let about_tip = Translation3::from(tip.coords) * rotation * Translation3::from(-tip.coords);
        let mut rng = stream(seed, Purpose::Kinematics);
        let wave_number = TAU / (robot.kinematic_length_mm * 1e-3);
        let waves = core::array::from_fn(|_| {
            let direction = Vector3::from_fn(|_, _| normal(&mut rng)).normalize();
            Wave {
                number: direction * wave_number,
                phase: TAU * uniform(&mut rng),
            }
        });
        let mut rng = stream(seed, Purpose::Holder);
        let offset = robot.holder_offset_mm * 1e-3;
        let tilt = robot.holder_tilt_deg.to_radians();
        let mut across = |size: f64| {
            let (x, y) = (normal(&mut rng), normal(&mut rng));
            Vector3::new(x, y, 0.0) * size
        };
        let mounting = Isometry3::new(across(offset), across(tilt))
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), draw.azimuth);
        Self {
            tilt: about_tip,
            waves,
            kinematic: (robot.kinematic_mm * 1e-3, robot.kinematic_deg.to_radians()),
            mounting,
            lag: robot.servo_lag_ms * 1e-3,
            compliance: (
                robot.compliance_mm_n * 1e-3,
                robot.compliance_deg_nm.to_radians(),
            ),
            nominal: *start,
            lagged: *start,
            yielded: Isometry3::identity(),
        }
    }

    /// Lets the servos follow the nominal pose, which moves steadily to `nominal` in `seconds`.
    pub(crate) fn follow(&mut self, nominal: &Transform<World, NeedleBase>, seconds: f64) {
        let target = *nominal.isometry();
        let before = core::mem::replace(&mut self.nominal, target);
        if self.lag <= 0.0 || seconds <= 0.0 {
            if self.lag <= 0.0 {
                self.lagged = target;
            }
            return;
        }
        // First order, exact for a steady motion of the nominal pose between the calls.
        let decay = (-seconds / self.lag).exp();
        let share = self.lag / seconds * (1.0 - decay);
        let behind = (before.translation.vector - self.lagged.translation.vector) * decay
            + (target.translation.vector - before.translation.vector) * share;
        let turn = (self.lagged.rotation.inverse() * before.rotation).scaled_axis() * decay
            + (before.rotation.inverse() * target.rotation).scaled_axis() * share;
        self.lagged = Isometry3::from_parts(
            (target.translation.vector - behind).into(),
            target.rotation * UnitQuaternion::from_scaled_axis(-turn),
        );
    }

    /// Lets the holder yield to what it exerts on the needle (World, about the base).
    pub(crate) fn yield_to(&mut self, wrench: &Wrench) {
        let (linear, angular) = self.compliance;
        if linear <= 0.0 && angular <= 0.0 {
            return;
        }
        let into_base = self.lagged.rotation.inverse();
        let across = |v: Vector3<f64>| Vector3::new(v.x, v.y, 0.0);
        self.yielded = Isometry3::new(
            across(into_base * wrench.force) * -linear,
            across(into_base * wrench.moment) * -angular,
        );
    }

    /// The true pose of the needle's base.
    pub(crate) fn true_pose(&self) -> Transform<World, NeedleBase> {
        let tilted = self.tilt * self.lagged;
        let position = tilted.translation.vector;
        let (linear, angular) = self.kinematic;
        let wave = |i: usize| {
            let w = &self.waves[i];
            SQRT_2 * (w.number.dot(&position) + w.phase).sin()
        };
        let shift = Vector3::new(wave(0), wave(1), wave(2)) * linear;
        let turn = Vector3::new(wave(3), wave(4), wave(5)) * angular;
        let actual = Isometry3::from_parts(
            (position + shift).into(),
            UnitQuaternion::from_scaled_axis(turn) * tilted.rotation,
        );
        Transform::assume(actual * self.yielded * self.mounting)
    }
}
