//! What a policy sees: measurements and encoders, never the truth.

use core::f64::consts::TAU;

use hal::{SensedShape, Stamp};
use nalgebra::{Isometry3, Vector3};

/// Points of the sensed shape.
const POINTS: usize = 8;
/// Numbers of an observation.
pub const OBSERVATION: usize = 21 + 3 * POINTS;
/// Unit of lengths \[m\]: with it all numbers are of the order of one.
const UNIT: f64 = 0.1;
/// Largest number of an observation, with either sign.
pub(super) const BOUND: f64 = 2.0;
/// Age of a measurement that counts as one \[s\].
const AGE: f64 = 1.0;

/// What there is to be seen.
pub(super) struct Seen<'a> {
    /// Frame of all coordinates: origin at the entry, z into the tissue.
    pub(super) entry_from_world: &'a Isometry3<f64>,
    /// The base by its encoders.
    pub(super) base: &'a Isometry3<f64>,
    /// Its turn about the needle since the start \[rad\].
    pub(super) roll: f64,
    /// The newest measurement, in World.
    pub(super) shape: &'a SensedShape,
    /// The target as the sensor's frame has it, in World \[m\].
    pub(super) target: &'a Vector3<f64>,
    /// The present time.
    pub(super) now: Stamp,
    /// Part of the longest duration that is left.
    pub(super) left: f64,
}

impl Seen<'_> {
    /// Writes the observation; `docs/PYTHON.md` has its table.
    pub(super) fn write(&self, out: &mut [f32]) {
        let turn = self.entry_from_world.rotation;
        let place = |p: &Vector3<f64>| self.entry_from_world * nalgebra::Point3::from(*p);
        let tip = self.shape.tip.position.coords();
        let mut numbers = out.iter_mut();
        let mut put = |x: f64| {
            if let Some(slot) = numbers.next() {
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "a policy sees single precision"
                )]
                let single = x.clamp(-BOUND, BOUND) as f32;
                *slot = single;
            }
        };
        let mut vector = |v: Vector3<f64>| v.iter().for_each(|x| put(*x));
        vector(turn * (self.target - tip) / UNIT);
        vector(place(&tip).coords / UNIT);
        vector(turn * self.shape.tip.direction.into_inner());
        vector(turn * (self.base.rotation * -Vector3::y()));
        vector(place(&self.base.translation.vector).coords / UNIT);
        vector(turn * (self.base.rotation * Vector3::z()));
        let points = &self.shape.points;
        let at = |k: usize| {
            // Evenly from the surface to the tip; before anything is inside, the tip itself.
            let count = points.len();
            points
                .get(k * count / POINTS)
                .map_or(tip, |point| point.position.coords())
        };
        for k in 0..POINTS {
            vector(turn * (at(k) - tip) / UNIT);
        }
        put(self.roll / TAU);
        put(self.now.secs_since(self.shape.stamp) / AGE);
        put(self.left);
    }
}
