//! A needle pushed straight down, and small helpers around it.

use hal::frame::{NeedleBase, World};
use hal::{Stamp, Transform};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use phantom::{Plant, RodPlant, Settings, Truth};

/// Bending stiffness of the nominal needle \[N m2\].
pub(crate) const EI: f64 = 1.836e-3;
/// Torsional stiffness of the nominal needle \[N m2\].
pub(crate) const GJ: f64 = 1.414e-3;

/// Settings of preset `ideal` with changes.
pub(crate) fn ideal(changes: &str) -> Settings {
    Settings::default()
        .overridden(changes.parse().unwrap())
        .unwrap()
}

/// A plant whose base is given in the phantom frame.
pub(crate) struct Rig {
    pub(crate) plant: RodPlant,
    pub(crate) world_from_phantom: Isometry3<f64>,
    pub(crate) pose: Isometry3<f64>,
    pub(crate) seconds: f64,
}

pub(crate) fn standing() -> Isometry3<f64> {
    Isometry3::from_parts(
        Vector3::new(0.4, 0.0, 0.25).into(),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), core::f64::consts::PI),
    )
}

/// Whether everything of a state is finite.
pub(crate) fn finite(truth: &Truth) -> bool {
    let wrench = &truth.base_wrench;
    let vectors = [
        wrench.force,
        wrench.moment,
        truth.tip_force,
        truth.entry_force,
        truth.tip(),
        truth.direction(),
    ];
    let numbers = [
        truth.max_stretch,
        truth.mean_stretch,
        truth.entry_stretch,
        truth.torsion,
        truth.depth,
        truth.needle.entry_arc,
    ];
    truth
        .needle
        .centreline
        .iter()
        .chain(&truth.cut_path)
        .chain(&vectors)
        .all(|p| p.iter().all(|x| x.is_finite()))
        && numbers.iter().all(|x| x.is_finite())
}

/// Small deterministic generator (`SplitMix64`), uniform in [-1, 1).
pub(crate) struct Dice(pub(crate) u64);

impl Dice {
    pub(crate) fn throw(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        (z >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

impl Rig {
    /// The needle straight above the entry, O on the surface.
    pub(crate) fn new(settings: &Settings, seed: u64) -> Self {
        Self::at(settings, seed, standing())
    }

    pub(crate) fn at(settings: &Settings, seed: u64, world_from_phantom: Isometry3<f64>) -> Self {
        let length = settings.needle.length_mm * 1e-3;
        Self::from(
            settings,
            seed,
            world_from_phantom,
            Isometry3::translation(0.0, 0.0, -length),
        )
    }

    pub(crate) fn from(
        settings: &Settings,
        seed: u64,
        world_from_phantom: Isometry3<f64>,
        pose: Isometry3<f64>,
    ) -> Self {
        let base = Transform::assume(world_from_phantom * pose);
        Self {
            plant: RodPlant::new(settings, &world_from_phantom, &base, seed).unwrap(),
            world_from_phantom,
            pose,
            seconds: 0.0,
        }
    }

    pub(crate) fn truth(&self) -> &Truth {
        self.plant.truth()
    }

    /// Moves the base to `pose` (phantom frame) in `steps` calls that take `seconds` together.
    pub(crate) fn go(&mut self, pose: Isometry3<f64>, seconds: f64, steps: u32) {
        self.go_with(pose, seconds, steps, |_, _| {});
    }

    /// The same, with a look at the plant and the base's increment after every call.
    pub(crate) fn go_with(
        &mut self,
        pose: Isometry3<f64>,
        seconds: f64,
        steps: u32,
        mut look: impl FnMut(&RodPlant, &Transform<World, NeedleBase>),
    ) {
        let from = self.pose;
        let screw = (from.rotation.inverse() * pose.rotation).scaled_axis();
        let begin = self.seconds;
        for i in 1..=steps {
            let share = f64::from(i) / f64::from(steps);
            let here = Isometry3::from_parts(
                from.translation
                    .vector
                    .lerp(&pose.translation.vector, share)
                    .into(),
                from.rotation * UnitQuaternion::from_scaled_axis(screw * share),
            );
            let base = Transform::assume(self.world_from_phantom * here);
            let stamp = Stamp::from_secs(begin + seconds * share);
            self.plant.advance(&base, stamp);
            look(&self.plant, &base);
        }
        self.pose = pose;
        self.seconds = begin + seconds;
    }

    /// Inserts along the base's own z by `metres` at 1 mm/s, 0.1 mm a call.
    pub(crate) fn insert(&mut self, metres: f64) {
        let pose = self.pose * Isometry3::translation(0.0, 0.0, metres);
        let millimetres = metres.abs() * 1e3;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "small"
        )]
        let steps = (millimetres * 10.0).ceil().max(1.0) as u32;
        self.go(pose, millimetres, steps);
    }

    /// Shifts the base by `by` (phantom axes) at once.
    pub(crate) fn shift(&mut self, by: Vector3<f64>, seconds: f64) {
        let mut pose = self.pose;
        pose.translation.vector += by;
        self.go(pose, seconds, 10);
    }

    /// O in the phantom frame.
    pub(crate) fn tip(&self) -> Vector3<f64> {
        (self.world_from_phantom.inverse() * Point3::from(self.truth().tip())).coords
    }

    /// Tip axis in the phantom frame.
    pub(crate) fn direction(&self) -> Vector3<f64> {
        self.world_from_phantom.rotation.inverse() * self.truth().direction()
    }
}
