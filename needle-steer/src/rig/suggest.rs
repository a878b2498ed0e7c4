//! A place for the arm to stand from which it can carry out the insertion.

use core::f64::consts::TAU;

use hal::Joints;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use robots::kinematics::{Chain, JointKind};

use super::RigBuildError;
use super::device;
use super::fit::{self, Course, Demand};
use super::start::{arm_place, chain, start};
use crate::config::Config;
use crate::roll;

/// Postures tried.
pub(super) const POSTURES: u32 = 600;
/// Good ones that are tried as a run would.
const TRIED: usize = 24;
/// Headings of the arm's base tried for each.
const HEADINGS: u32 = 12;
/// Share of a joint's range, about its middle, from which postures are taken.
const SHARE: f64 = 0.85;
/// Range of a joint without ends \[rad\].
const RANGE: f64 = TAU;
/// What a metre of height of the base above or below the configured one costs, in radians of
/// room: a place on the same table is better.
const HEIGHT_COST: f64 = 0.5;
/// Room beyond which more is no better \[rad\].
const ENOUGH: f64 = 0.6;
/// Bases of the Halton sequence, one a joint.
const BASES: [u32; hal::MAX_JOINTS] = [2, 3, 5, 7, 11, 13, 17];

/// A place for the arm's base.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// `arm.base_mm`.
    pub base_mm: [f64; 3],
    /// `arm.base_rpy_deg`.
    pub base_rpy_deg: [f64; 3],
    /// What the insertion leaves the arm there.
    pub course: Course,
}

/// Looks for a place for the arm's base, upright as configured but turned and moved freely, from
/// which a run with `config` would be accepted. Nothing if none of those tried is one.
pub fn suggest(config: &Config, chain: &Chain) -> Option<Place> {
    fit::check_chain(chain).ok()?;
    if device::is_device(chain) {
        return device::suggest(config, chain);
    }
    let demand = Demand::of(config);
    let mut found: Vec<(f64, [f64; 3], [f64; 3])> = Vec::new();
    for index in 1..=POSTURES {
        let q = posture(chain, index);
        let Some((base, q, yaw)) = stand(config, chain, &q) else {
            continue;
        };
        let Ok(course) = fit::follow(chain, &q, &demand) else {
            continue;
        };
        let height = base.translation.z - config.arm.base_mm[2] * 1e-3;
        let merit = course.room.min(ENOUGH) + course.dexterity - HEIGHT_COST * height.abs();
        let mm = base.translation.vector.map(|x| (x * 1e3).round());
        let [roll, pitch, _] = config.arm.base_rpy_deg;
        found.push((merit, [mm.x, mm.y, mm.z], [roll, pitch, yaw.to_degrees()]));
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.iter().take(TRIED).find_map(|(_, mm, deg)| {
        let mut there = config.clone();
        (there.arm.base_mm, there.arm.base_rpy_deg) = (*mm, *deg);
        let start = start(&there, chain, &arm_place(&there)).ok()?;
        Some(Place {
            base_mm: *mm,
            base_rpy_deg: *deg,
            course: start.course,
        })
    })
}

/// `config` with its arm at a place from which a run is accepted: its own, or one that [`suggest`]
/// finds.
///
/// # Errors
/// The arm makes no chain, or why it cannot insert from its own place where no other was found.
pub fn placed(config: &Config) -> Result<Config, RigBuildError> {
    let chain = chain(config)?;
    let mut config = config.clone();
    if let Err(refused) = start(&config, &chain, &arm_place(&config)) {
        let Some(place) = suggest(&config, &chain) else {
            return Err(refused);
        };
        (config.arm.base_mm, config.arm.base_rpy_deg) = (place.base_mm, place.base_rpy_deg);
    }
    Ok(config)
}

/// Point `index` of the Halton sequence in the inner part of the joints' ranges; 0: their middles.
pub(super) fn posture(chain: &Chain, index: u32) -> Joints {
    let mut q = chain.limits().iter().map(|_| 0.0).collect::<Vec<f64>>();
    let joints = chain.limits().iter().zip(chain.kinds());
    for (i, (limit, kind)) in joints.enumerate() {
        let (mut share, mut digit, mut rest) = (0.0, 1.0, index);
        while rest > 0 {
            digit /= f64::from(BASES[i]);
            share += digit * f64::from(rest % BASES[i]);
            rest /= BASES[i];
        }
        let (middle, range) = (0.5 * (limit.lower + limit.upper), limit.upper - limit.lower);
        let (middle, range) = match kind {
            JointKind::Prismatic => (middle, range),
            JointKind::Revolute => (middle, range.min(RANGE)),
            JointKind::Continuous => (0.0, RANGE),
        };
        q[i] = middle;
        if index > 0 {
            q[i] += SHARE * range * (share - 0.5);
        }
    }
    if let Some(spin) = chain.spin() {
        q[spin.joint] = roll::middle(chain);
    }
    Joints::from_slice(&q).unwrap_or_else(|_| Joints::from([0.0; 6]))
}

/// Place of the base for a posture near `q` that holds the needle at the start of the insertion,
/// with that posture and the base's heading.
fn stand(config: &Config, chain: &Chain, q: &Joints) -> Option<(Isometry3<f64>, Joints, f64)> {
    let held = chain.forward(q);
    let z = held.rotation * Vector3::z();
    let [roll, pitch, _] = config.arm.base_rpy_deg.map(f64::to_radians);
    let inward = config.inward();
    // The heading in which the needle has least to be turned.
    let headings = (0..HEADINGS).map(|k| {
        let yaw = TAU * f64::from(k) / f64::from(HEADINGS) - 0.5 * TAU;
        let upright = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        (yaw, upright, upright.inverse() * inward.into_inner())
    });
    let (yaw, upright, down) = headings.min_by(|a, b| a.2.angle(&z).total_cmp(&b.2.angle(&z)))?;
    let turn = UnitQuaternion::rotation_between(&z, &down)?;
    let wanted = Isometry3::from_parts(held.translation, turn * held.rotation);
    let q = chain.refine(&wanted, q)?;
    let start = config.world_from_start_base().translation.vector;
    let base = start - upright * wanted.translation.vector;
    chain.within_limits(&q).then(|| {
        let base = Isometry3::from_parts(Translation3::from(base), upright);
        (base, q, yaw)
    })
}
