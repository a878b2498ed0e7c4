//! The contract of a simulated needle in tissue.

use hal::frame::{NeedleBase, World};
use hal::{Stamp, Transform};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::truth::Truth;

/// A needle in tissue, driven by the true pose of its base.
///
/// # Contract
/// * `advance` moves the base to `world_from_base`, reached at `stamp`, along the straight
///   screw from its last pose; it neither panics nor hangs. What it cannot simulate it
///   reports in [`Truth::events`].
/// * `truth` is the state at the last `advance` (or `reset`).
/// * The same construction and the same calls give the same bits.
pub trait Plant: Send {
    /// Moves the base.
    fn advance(&mut self, world_from_base: &Transform<World, NeedleBase>, stamp: Stamp);

    /// The present state.
    fn truth(&self) -> &Truth;

    /// Begins anew with fresh tissue, the needle straight, time zero.
    fn reset(&mut self, world_from_base: &Transform<World, NeedleBase>);

    /// Where the tissue is in World \[m\] at the instant of `truth` that is at `rest` while all is
    /// at rest. Tissue that does not move stays there.
    fn tissue_at(&self, rest: &Vector3<f64>) -> Vector3<f64> {
        *rest
    }

    /// Where the tissue that is at `place` in World \[m\] at the instant of `truth` is while all is
    /// at rest: the inverse of [`Plant::tissue_at`].
    fn rest_of(&self, place: &Vector3<f64>) -> Vector3<f64> {
        *place
    }
}

/// The pose after `share` of the straight screw between two.
pub(crate) fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    let screw = (from.rotation.inverse() * to.rotation).scaled_axis();
    let place = from.translation.vector.lerp(&to.translation.vector, share);
    let turned = from.rotation * UnitQuaternion::from_scaled_axis(screw * share);
    Isometry3::from_parts(place.into(), turned)
}
