//! Start of a device with fewer joints than an arm has: a stage, a guide, an insertion-and-spin
//! device. It is mounted in front of the entry, and reaches the start as nearly as its joints allow.

use hal::frame::{ArmBase, World};
use hal::{Joints, Transform, Twist};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use robots::kinematics::{Chain, RateSettings};

use super::RigBuildError;
use super::fit::{self, Demand, Misfit};
use super::start::Start;
use super::suggest::{POSTURES, Place, posture};
use crate::bearings::freedom_at;
use crate::config::Config;

/// How far across \[m\] and askew \[rad\] of the configured axis a device may be mounted.
const MOUNTED: (f64, f64) = (5e-3, 0.035);
/// How far from the surface the tip may start \[m\].
const OFF_SURFACE: f64 = 2e-4;
/// Steps in which the start is approached, each of a second at the joints' speeds at most.
const STEPS: u32 = 400;
/// Joint rates at which it is reached \[rad/s\], sliding joints by their unit.
const REACHED: f64 = 1e-9;
/// To what a place is rounded \[mm\], \[deg\].
const ROUNDED: f64 = 0.1;

/// Fewer joints than directions of motion.
pub(super) fn is_device(chain: &Chain) -> bool {
    chain.len() < 6
}

/// The start with the device where it stands.
///
/// # Errors
/// It cannot insert, is mounted elsewhere, or comes to an end of its travel.
pub(super) fn start(
    config: &Config,
    chain: &Chain,
    world_from_arm_base: &Transform<World, ArmBase>,
) -> Result<Start, RigBuildError> {
    let arm_base = world_from_arm_base.isometry();
    let nominal = config.world_from_start_base();
    let joints = nearest(chain, &(arm_base.inverse() * nominal));
    inserts(chain, &joints)?;
    let world_from_base = arm_base * chain.forward(&joints);
    let off = nominal.inverse() * world_from_base;
    let across = off.translation.vector.xy().norm();
    let askew = (off.rotation * Vector3::z()).angle(&Vector3::z());
    if across > MOUNTED.0 || askew > MOUNTED.1 || off.translation.z.abs() > OFF_SURFACE {
        return Err(Misfit::Mounted {
            across_mm: across * 1e3,
            along_mm: off.translation.z * 1e3,
            askew_deg: askew.to_degrees(),
        }
        .into());
    }
    let course = fit::follow(chain, &joints, &Demand::of(config))?;
    Ok(Start {
        world_from_base,
        joints,
        course,
    })
}

/// A place from which the device can insert: of all postures, the one with most room.
pub(super) fn suggest(config: &Config, chain: &Chain) -> Option<Place> {
    let demand = Demand::of(config);
    let nominal = config.world_from_start_base();
    let mut best: Option<(f64, Place)> = None;
    for index in 1..=POSTURES {
        let q = posture(chain, index);
        let Ok(course) = fit::follow(chain, &q, &demand) else {
            continue;
        };
        if best.as_ref().is_some_and(|(room, _)| course.room <= *room) {
            continue;
        }
        let base = nominal * chain.forward(&q).inverse();
        let rounded = |x: f64| (x / ROUNDED).round() * ROUNDED;
        let mm = base.translation.vector.map(|x| tidy(rounded(x * 1e3)));
        let (roll, pitch, yaw) = base.rotation.euler_angles();
        let deg = [roll, pitch, yaw].map(|x| tidy(rounded(x.to_degrees())));
        let mut there = config.clone();
        (there.arm.base_mm, there.arm.base_rpy_deg) = ([mm.x, mm.y, mm.z], deg);
        let Ok(start) = start(&there, chain, &super::arm_place(&there)) else {
            continue;
        };
        let place = Place {
            base_mm: there.arm.base_mm,
            base_rpy_deg: deg,
            course: start.course,
        };
        best = Some((course.room, place));
    }
    best.map(|(_, place)| place)
}

/// As a person would write it: tenths, no minus before zero.
fn tidy(x: f64) -> f64 {
    let tenths = (x * 10.0).round() / 10.0;
    if tenths == 0.0 { 0.0 } else { tenths }
}

/// Joints that bring the needle's base nearest to `wanted`, whose roll is free, with the joint that
/// spins the needle in the middle of its travel.
fn nearest(chain: &Chain, wanted: &Isometry3<f64>) -> Joints {
    let mut q = posture(chain, 0);
    for _ in 0..STEPS {
        let here = chain.forward(&q);
        let (z, onto) = (here.rotation * Vector3::z(), wanted.rotation * Vector3::z());
        let turn = UnitQuaternion::rotation_between(&z, &onto);
        let twist = Twist {
            linear: wanted.translation.vector - here.translation.vector,
            angular: turn.map_or_else(Vector3::zeros, |turn| turn.scaled_axis()),
        };
        let rates = chain.rates(&q, &twist, &RateSettings::default()).rates;
        let before = q;
        for (joint, (x, rate)) in q.iter_mut().zip(rates.iter()).enumerate() {
            let limit = &chain.limits()[joint];
            *x = (*x + rate).clamp(limit.lower, limit.upper);
        }
        let moved = q.iter().zip(before.iter()).zip(chain.kinds());
        if moved.fold(0.0_f64, |most, ((a, b), kind)| {
            most.max((a - b).abs() / kind.unit())
        }) < REACHED
        {
            break;
        }
    }
    q
}

/// Some joint has to push the needle.
fn inserts(chain: &Chain, q: &Joints) -> Result<(), Misfit> {
    let along = chain.forward(q).rotation * Vector3::z();
    let push = Twist {
        linear: along,
        angular: Vector3::zeros(),
    };
    if freedom_at(chain, q, &Isometry3::identity()).gives(&push) {
        return Ok(());
    }
    Err(Misfit::NoInsertion {
        tip: chain.tip().to_owned(),
    })
}

/// What a device can do, in words.
pub fn abilities(chain: &Chain, q: &Joints, length: f64) -> String {
    let freedom = freedom_at(chain, q, &Isometry3::identity());
    if freedom.is_full() {
        return "all motions of the needle's base".to_owned();
    }
    let pose = chain.forward(q);
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| pose.rotation * axis);
    let slide = |axis: Vector3<f64>| Twist {
        linear: axis,
        angular: Vector3::zeros(),
    };
    // About the entry, a needle's length ahead of the base.
    let pivot = |axis: Vector3<f64>| Twist {
        linear: axis.cross(&(-z * length)),
        angular: axis,
    };
    let spin = Twist {
        linear: Vector3::zeros(),
        angular: z,
    };
    let both = |twists: [Twist; 2]| freedom.within(&twists).trace();
    let words = [
        (
            "insertion",
            f64::from(u8::from(freedom.gives(&slide(z)))),
            1.0,
        ),
        ("spin", f64::from(u8::from(freedom.gives(&spin))), 1.0),
        ("shift", both([x, y].map(slide)), 2.0),
        ("pivot", both([x, y].map(pivot)), 2.0),
    ];
    let has = |(word, there, whole): &(&str, f64, f64)| {
        if *there > whole - 0.5 {
            Some((*word).to_owned())
        } else {
            (*there > 0.5).then(|| format!("{word} to one side"))
        }
    };
    words.iter().filter_map(has).collect::<Vec<_>>().join(", ")
}
