//! The joint that turns the needle: what it has left, and what gives way at its end.

use hal::telemetry::Limit;
use hal::{ArmState, JointLimit, Joints, Twist};
use hybrid_control::Limits;
use hybrid_control::view::RollTravel;
use nalgebra::Vector3;
use robots::kinematics::{Chain, JointKind, RateSettings, TurnBudget, TwistRates};

use crate::bearings::{Bearings, base_pose};

/// Travel that nothing may use \[rad\].
const MARGIN: f64 = 0.02;
/// Time constant with which the joint approaches its end \[s\].
const APPROACH: f64 = 0.05;

/// Turns of a continuous joint to either side that a needle with a cable may make \[rad\].
const CABLE: f64 = core::f64::consts::TAU;

/// Share of its speed that the joint may spend on spin: tilting turns it too.
const FOR_SPIN: f64 = 0.9;

/// Sense in which that joint counts turns about the needle's z: 1 or -1.
pub(crate) fn sense(chain: &Chain) -> f64 {
    chain.spin().map_or(1.0, |spin| spin.sense)
}

/// The laws' limits as the joint keeps them: a law that counts on more spin than there is believes
/// turns made that were not.
pub(crate) fn within_speed(limits: &Limits, chain: &Chain) -> Limits {
    let mut limits = limits.clone();
    if let Some(limit) = spin_limit(chain) {
        let most = FOR_SPIN * limit.velocity.to_degrees();
        limits.spin_speed_deg_s = limits.spin_speed_deg_s.min(most);
    }
    limits
}

/// Middle of the joint's travel \[rad\].
pub(crate) fn middle(chain: &Chain) -> f64 {
    spin_limit(chain).map_or(0.0, |limit| 0.5 * (limit.lower + limit.upper))
}

/// Limits of the joint as spin uses it: one without ends has its cable's. Nothing where no joint
/// spins the needle.
pub(crate) fn spin_limit(chain: &Chain) -> Option<JointLimit> {
    let joint = chain.spin()?.joint;
    chain.limits().get(joint).map(|limit| {
        let continuous = chain.kinds()[joint] == JointKind::Continuous;
        let (lower, upper) = if continuous {
            (-CABLE, CABLE)
        } else {
            (limit.lower, limit.upper)
        };
        JointLimit {
            lower,
            upper,
            ..*limit
        }
    })
}

/// Position of the joint; nothing where none spins the needle.
fn position(chain: &Chain, positions: &Joints) -> Option<f64> {
    positions.get(chain.spin()?.joint).copied()
}

/// Travel of the joint, in the senses of the needle's z.
pub(crate) fn roll_travel(bearings: &Bearings, arm: &ArmState) -> RollTravel {
    let limit = spin_limit(&bearings.chain);
    let q = position(&bearings.chain, &arm.positions);
    let (Some(q), Some(limit)) = (q, limit) else {
        return RollTravel {
            positive: 0.0,
            negative: 0.0,
        };
    };
    let left = TurnBudget::new(&limit, MARGIN).remaining(q);
    let (positive, negative) = if sense(&bearings.chain) < 0.0 {
        (left.negative, left.positive)
    } else {
        (left.positive, left.negative)
    };
    RollTravel { positive, negative }
}

/// Travel of the joint in the sense of a spin; negative beyond its margin.
fn room_in(bearings: &Bearings, arm: &ArmState, spin: f64) -> f64 {
    let limit = spin_limit(&bearings.chain);
    let q = position(&bearings.chain, &arm.positions);
    let (Some(q), Some(limit)) = (q, limit) else {
        return 0.0;
    };
    let room = if spin * sense(&bearings.chain) > 0.0 {
        limit.upper - q
    } else {
        q - limit.lower
    };
    room - MARGIN
}

/// Joint rates for a twist of the needle's base (World).
///
/// Tilting a base turns the joint too. What that joint cannot turn any more is taken from
/// the spin, or the arm would refuse the whole motion: the bevel gives way, and its law turns
/// it back the other way round.
pub(crate) fn joint_rates(
    bearings: &Bearings,
    arm: &ArmState,
    twist: &Twist,
    settings: &RateSettings,
) -> TwistRates {
    let arm_base_from_world = bearings.world_from_arm_base.inverse();
    let rates = |twist: &Twist| {
        let in_arm_base = Twist {
            linear: arm_base_from_world.rotate(&twist.linear),
            angular: arm_base_from_world.rotate(&twist.angular),
        };
        bearings.chain.rates(&arm.positions, &in_arm_base, settings)
    };
    let wanted = rates(twist);
    // As spin about the needle's z.
    let rate = position(&bearings.chain, &wanted.rates).unwrap_or_default();
    let rate = sense(&bearings.chain) * rate;
    // Negative beyond the end: the joint is turned back in, or the guard, which lets nothing
    // further out, would stop the whole arm for a rounding.
    let room = room_in(bearings, arm, rate);
    let excess = rate.abs() - room / APPROACH;
    if excess <= 0.0 {
        return wanted;
    }
    let axis = base_pose(bearings, arm).rotation * Vector3::z();
    let mut given_way = rates(&Twist {
        linear: twist.linear,
        angular: twist.angular - axis * (excess * rate.signum()),
    });
    given_way.limits.push(Limit::RemainingTurns);
    given_way
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config;
    use crate::rig::Rig;
    use hal::Arm;

    #[test]
    fn a_joint_beyond_its_end_is_turned_back() {
        let mut rig = Rig::new(&config::load(None, &[]).unwrap()).unwrap();
        let mut arm = rig.arm.state().unwrap();
        let (bearings, settings) = (rig.bearings, RateSettings::default());
        let limit = *bearings.chain.limits().last().unwrap();
        *arm.positions.last_mut().unwrap() = limit.upper - 0.2 * MARGIN;
        let axis = base_pose(&bearings, &arm).rotation * Vector3::z();
        let twist = Twist {
            linear: axis * 1e-3,
            angular: axis * 1e-9,
        };
        let got = joint_rates(&bearings, &arm, &twist, &settings);
        let last = *got.rates.last().unwrap();
        assert!(last < -0.1, "{last} rad/s");
        let realised = bearings.world_from_arm_base.rotate(&got.realised.linear);
        assert!((realised - twist.linear).norm() < 1e-9);
    }

    #[test]
    fn a_joint_at_its_end_gives_up_spin_and_nothing_else() {
        let mut rig = Rig::new(&config::load(None, &[]).unwrap()).unwrap();
        let mut arm = rig.arm.state().unwrap();
        let (bearings, settings) = (rig.bearings, RateSettings::default());
        let limit = *bearings.chain.limits().last().unwrap();
        let mut refused = 0;
        for k in 0..64 {
            let (end, azimuth) = (f64::from(k % 2), f64::from(k) * 0.1);
            let q = limit.lower + MARGIN + end * (limit.upper - limit.lower - 2.0 * MARGIN);
            *arm.positions.last_mut().unwrap() = q;
            let axis = base_pose(&bearings, &arm).rotation * Vector3::z();
            let tilt = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0).cross(&axis) * 0.05;
            let twist = Twist {
                linear: axis * 1e-3,
                angular: tilt,
            };
            let got = joint_rates(&bearings, &arm, &twist, &settings);
            let last = *got.rates.last().unwrap();
            let outwards = if end > 0.0 { last } else { -last };
            assert!(outwards < 1e-9, "joint 6 goes out by {outwards} rad/s");
            refused += usize::from(got.limits.contains(&Limit::RemainingTurns));
            let realised = bearings.world_from_arm_base.rotate(&got.realised.linear);
            assert!((realised - twist.linear).norm() < 1e-9);
            let turn = bearings.world_from_arm_base.rotate(&got.realised.angular);
            assert!((turn - tilt).cross(&axis).norm() < 1e-9);
        }
        assert!((8..56).contains(&refused), "{refused} of 64");
    }
}
