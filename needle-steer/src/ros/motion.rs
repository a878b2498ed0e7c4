//! Motion by hand: twists as joint rates.

use hal::{Joints, Twist};
use nalgebra::Isometry3;
use robots::kinematics::RateSettings;
use rosbridge::motion::{ToRates, TwistAxes};

use crate::cycle::Bearings;

/// Joint rates for a twist of the needle's base.
pub(crate) fn to_rates(bearings: &Bearings, settings: RateSettings) -> Box<ToRates> {
    let bearings = bearings.clone();
    Box::new(move |joints: &Joints, twist: &Twist, axes: TwistAxes| {
        let arm_base_from: Isometry3<f64> = match axes {
            TwistAxes::World => *bearings.world_from_arm_base.inverse().isometry(),
            TwistAxes::NeedleBase => bearings.chain.forward(joints),
        };
        let in_arm_base = Twist {
            linear: arm_base_from.rotation * twist.linear,
            angular: arm_base_from.rotation * twist.angular,
        };
        bearings.chain.rates(joints, &in_arm_base, &settings).rates
    })
}
