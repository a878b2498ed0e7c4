//! How long a move takes that goes as fast as it can.

use hal::{JointLimits, Joints};

/// Duration and ramp \[s\] of the fastest common trapezoid over `by` \[rad\] within the limits
/// of speed and acceleration.
pub(super) fn fastest(by: &Joints, limits: &JointLimits) -> (f64, f64) {
    let mut speed = f64::INFINITY;
    let mut acceleration = f64::INFINITY;
    for (by, limit) in by.iter().zip(limits) {
        speed = speed.min(limit.velocity / by.abs());
        acceleration = acceleration.min(limit.acceleration / by.abs());
    }
    if !acceleration.is_finite() {
        return (0.0, 0.0);
    }
    let ramp = (speed / acceleration).min(acceleration.sqrt().recip());
    let cruise = (1.0 / (acceleration * ramp) - ramp).max(0.0);
    (2.0 * ramp + cruise, ramp)
}
