//! Whether an arm can carry out an insertion, found before anything moves.

mod misfit;

use core::f64::consts::TAU;

use hal::telemetry::Limit;
use hal::{Joints, Twist};
use nalgebra::{Isometry3, Unit, UnitQuaternion, Vector3};
use robots::kinematics::{Chain, JointKind, RateSettings};

use super::device::is_device;
use crate::bearings::freedom_at;
use crate::config::{Config, TargetKind};
use crate::roll::spin_limit;
pub use misfit::Misfit;
pub(super) use misfit::PLACE;

/// Angle \[rad\] and distance \[m\] of the needle from the axis of the joint that turns it, beyond
/// which the other joints would have to swing the holder round with every turn.
const OFF_AXIS: (f64, f64) = (0.0175, 2e-3);
/// Least travel of that joint \[rad\]: with 300 degrees the bevel can alternate between the ends.
const LEAST_TURN: f64 = 300.0 / 360.0 * TAU - 1e-6;
/// Least speed of that joint \[rad/s\]: at 0.3 rad/s some insertions of the paper's 80 mm take longer
/// than the ten minutes that a run may.
const LEAST_SPIN: f64 = 0.4;
/// Ends of a turning joint that are taken for degrees \[rad\]: 8 turns and more, where no cable goes;
/// far beyond, they stand for none.
const TAKEN_FOR_DEGREES: core::ops::Range<f64> = 50.0..2000.0;
/// Distance of the tip from the base that is taken for millimetres \[m\].
const TAKEN_FOR_MM: f64 = 50.0;
/// Distance that the joints keep from their ends on the way \[rad\]: what the guard keeps, and
/// room for the base to steer.
const ROOM: f64 = 0.035;
/// Step along the insertion \[m\], one a second: the speed at which joints to spare are centred.
const STEP: f64 = 1e-3;
/// Way between the places where the base is tilted to all sides \[m\].
const TILTED_EVERY: f64 = 0.01;
/// Directions in which it is tilted.
const SIDES: u32 = 8;
/// Least tilt that an insertion may need \[rad\]: 4 degrees, of 3.4 seen with aligned targets.
const LEAST_TILT: f64 = 0.07;
/// Tilt of the base over the direction of a target aside: 9 degrees for the paper's 10 mm in 80 mm.
const TILT_FOR_ASIDE: f64 = 1.25;
/// Least shift that an insertion may need of a device that cannot tilt \[m\], and shift for a
/// target aside.
const LEAST_SHIFT: f64 = 3e-3;
/// See [`LEAST_SHIFT`].
const SHIFT_FOR_ASIDE: f64 = 1.0;
/// Straight insertion before the target is set, at most \[m\].
const STRAIGHT: f64 = 0.013;
/// Distance from a wanted pose that shows that the arm cannot follow \[m\], \[rad\].
const ASTRAY: (f64, f64) = (1e-3, 0.01);

/// What does not depend on where the arm stands: speeds, and the joint that turns the needle.
///
/// # Errors
/// See [`Misfit`].
pub fn check_chain(chain: &Chain) -> Result<(), Misfit> {
    let missing: Vec<&str> = chain.without_speed().collect();
    if !missing.is_empty() {
        return Err(Misfit::NoSpeed {
            joints: missing.join(", "),
        });
    }
    check_units(chain)?;
    let spin = chain.spin();
    if spin.is_none() && is_device(chain) {
        return Ok(());
    }
    let spinner = spin.map_or(chain.len() - 1, |spin| spin.joint);
    let joint = chain.names()[spinner].clone();
    if spin.is_none_or(|spin| spin.tilt > OFF_AXIS.0 || spin.aside > OFF_AXIS.1) {
        return Err(Misfit::OffAxis {
            tip: chain.tip().to_owned(),
            joint,
            tilt_deg: spin.map_or(90.0, |spin| spin.tilt.to_degrees()),
            aside_mm: spin.map_or(0.0, |spin| spin.aside * 1e3),
            remedy: onto_axis(chain),
        });
    }
    match spin_limit(chain) {
        Some(limit) if limit.upper - limit.lower < LEAST_TURN => Err(Misfit::ShortTurn {
            joint,
            lower_deg: limit.lower.to_degrees(),
            upper_deg: limit.upper.to_degrees(),
            travel_deg: (limit.upper - limit.lower).to_degrees(),
        }),
        Some(limit) if limit.velocity < LEAST_SPIN => {
            let least = LEAST_SPIN.to_degrees();
            Err(Misfit::slow(
                chain,
                spinner,
                format!(", of the {least:.0} deg/s with which it must turn the needle"),
            ))
        }
        _ => Ok(()),
    }
}

/// Whether ends and lengths can be rad and m.
fn check_units(chain: &Chain) -> Result<(), Misfit> {
    let spinner = chain.spin().map(|spin| spin.joint);
    let joints = chain.limits().iter().zip(chain.kinds()).enumerate();
    for (i, (limit, kind)) in joints {
        let end = limit.lower.abs().max(limit.upper.abs());
        // A spindle may have many turns.
        if Some(i) != spinner && *kind == JointKind::Revolute && TAKEN_FOR_DEGREES.contains(&end) {
            return Err(Misfit::Degrees {
                joint: chain.names()[i].clone(),
                lower: limit.lower,
                upper: limit.upper,
            });
        }
    }
    let zero = chain.limits().iter().map(|_| 0.0).collect::<Vec<f64>>();
    let distance = Joints::from_slice(&zero)
        .map_or(0.0, |zero| chain.forward(&zero).translation.vector.norm());
    if distance > TAKEN_FOR_MM {
        return Err(Misfit::Millimetres {
            base: chain.base().to_owned(),
            tip: chain.tip().to_owned(),
            distance,
        });
    }
    Ok(())
}

/// The keys that turn and move the needle onto the axis of the last joint, its z the way that is
/// nearer; at a right angle, the way that leads away from the joint before.
fn onto_axis(chain: &Chain) -> String {
    let Some(tip_from_tool) = chain.tool_on_last_axis() else {
        return "no turn of the needle can help".to_owned();
    };
    let mm = tip_from_tool.translation.vector * 1e3;
    let (roll, pitch, yaw) = tip_from_tool.rotation.euler_angles();
    let deg = [roll, pitch, yaw].map(|x| tidy(x.to_degrees()));
    let mut remedy = format!("arm.tip_rpy_deg = {deg:?}");
    if mm.norm() > OFF_AXIS.1 * 1e3 {
        let mm = [mm.x, mm.y, mm.z].map(tidy);
        remedy = format!("{remedy} and arm.tip_mm = {mm:?}");
    }
    format!("{remedy} would put the needle onto it")
}

/// Rounded to what a person would write.
fn tidy(x: f64) -> f64 {
    let rounded = (x * 1e3).round() * 1e-3;
    // No minus before zero.
    if rounded == 0.0 {
        0.0
    } else {
        (rounded * 1e3).round() / 1e3
    }
}

/// What an insertion asks of an arm's place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demand {
    /// Depth of the tip at the end \[m\].
    pub depth: f64,
    /// Tilt of the base about the entry, to any side \[rad\].
    pub tilt: f64,
    /// Shift of the base to any side \[m\], where a device cannot tilt.
    pub shift: f64,
    /// From the needle's base to its tip \[m\].
    pub length: f64,
}

impl Demand {
    /// What `config` asks.
    pub fn of(config: &Config) -> Self {
        let length = config.needle.length_mm * 1e-3;
        let target = &config.target;
        let (ahead, aside) = match target.kind {
            TargetKind::Aligned => (target.depth_mm, 0.0),
            TargetKind::Shifted | TargetKind::Marker => (target.depth_mm, target.offset_mm),
            // Where it lies to the tip is known when the needle is seen.
            TargetKind::Stereo | TargetKind::World => (0.5 * config.needle.length_mm, 0.0),
        };
        let tilt = (TILT_FOR_ASIDE * aside / ahead.max(1.0)).max(LEAST_TILT);
        let limits_offset = config.limits.base_offset_mm * 1e-3;
        // Half of what the limits admit is what a target may ask for.
        let most = (0.5 * config.limits.tilt_deg.to_radians())
            .min(config.limits.base_offset_mm / config.needle.length_mm);
        Self {
            depth: (ahead * 1e-3 + STRAIGHT).min(length),
            tilt: tilt.min(most),
            shift: (SHIFT_FOR_ASIDE * aside * 1e-3)
                .max(LEAST_SHIFT)
                .min(limits_offset),
            length,
        }
    }
}

/// An insertion that the arm can carry out.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// Least distance of a joint from its end, on the straight way \[rad\]; of sliding joints by
    /// their unit.
    pub room: f64,
    /// The joint.
    pub joint: usize,
    /// Least dexterity; see [`Chain::dexterity`].
    pub dexterity: f64,
}

/// Follows the straight insertion from the joints `start`, and tilts the base to all sides on
/// the way.
///
/// # Errors
/// The joint, or the singularity, that the arm comes to.
pub fn follow(chain: &Chain, start: &Joints, demand: &Demand) -> Result<Course, Misfit> {
    let first = chain.forward(start);
    let mut course = Course {
        room: f64::INFINITY,
        joint: 0,
        dexterity: f64::INFINITY,
    };
    let mut q = *start;
    let steps = (demand.depth / STEP).ceil();
    let mut tilted_at = 0.0;
    let mut k = 0.0;
    while k <= steps {
        let depth = (k * STEP).min(demand.depth);
        let pose = first * nalgebra::Translation3::new(0.0, 0.0, depth);
        let stopped = Stopped {
            depth,
            needed: demand.depth,
            tilted: String::new(),
        };
        q = if k == 0.0 {
            stopped.inside(chain, &q)?;
            q
        } else {
            stopped.reach(chain, &q, &pose)?
        };
        let (room, joint) = least_room(chain, &q);
        if room < course.room {
            (course.room, course.joint) = (room, joint);
        }
        course.dexterity = course.dexterity.min(chain.dexterity(&q, LENGTH));
        if depth >= tilted_at {
            tilted_at += TILTED_EVERY;
            go_to_all_sides(chain, &q, &pose, depth, demand)?;
        }
        k += 1.0;
    }
    Ok(course)
}

/// Length by which linear velocities are divided \[m\].
const LENGTH: f64 = 0.1;

/// Tilts the base about the entry, or shifts it where that is what a device can do.
fn go_to_all_sides(
    chain: &Chain,
    q: &Joints,
    pose: &Isometry3<f64>,
    depth: f64,
    demand: &Demand,
) -> Result<(), Misfit> {
    let entry = pose * nalgebra::Point3::new(0.0, 0.0, demand.length - depth);
    let freedom = freedom_at(chain, q, &Isometry3::identity());
    for side in 0..SIDES {
        let azimuth = TAU * f64::from(side) / f64::from(SIDES);
        let across = pose.rotation * Vector3::new(azimuth.cos(), azimuth.sin(), 0.0);
        let tilt = Twist {
            linear: across.cross(&(pose.translation.vector - entry.coords)),
            angular: across,
        };
        let shift = Twist {
            linear: across,
            angular: Vector3::zeros(),
        };
        let (moved, tilted) = if freedom.gives(&tilt) {
            let turn = UnitQuaternion::from_axis_angle(&Unit::new_normalize(across), demand.tilt);
            let about = Isometry3::from_parts(entry.coords.into(), turn)
                * nalgebra::Translation3::from(-entry.coords);
            let degrees = demand.tilt.to_degrees();
            (
                about * pose,
                format!(", its base tilted by {degrees:.0} deg"),
            )
        } else if freedom.gives(&shift) {
            let aside = nalgebra::Translation3::from(across * demand.shift);
            let mm = demand.shift * 1e3;
            (aside * pose, format!(", its base {mm:.0} mm aside"))
        } else {
            continue;
        };
        let stopped = Stopped {
            depth,
            needed: demand.depth,
            tilted,
        };
        stopped.reach(chain, q, &moved)?;
    }
    Ok(())
}

/// Where an insertion may come to its end.
struct Stopped {
    depth: f64,
    needed: f64,
    tilted: String,
}

impl Stopped {
    /// Joints for `pose`, reached from `q` as the run would.
    fn reach(&self, chain: &Chain, q: &Joints, pose: &Isometry3<f64>) -> Result<Joints, Misfit> {
        /// Steps in which a pose is approached.
        const APPROACH: usize = 8;
        let mut q = *q;
        let mut slowest = None;
        for _ in 0..APPROACH {
            let here = chain.forward(&q);
            let (linear, angular) = apart(&here, pose);
            if linear.norm() < 0.05 * ASTRAY.0 && angular.norm() < 0.05 * ASTRAY.1 {
                break;
            }
            let rates = chain.rates(&q, &Twist { linear, angular }, &RateSettings::default());
            slowest = rates.limits.iter().find_map(|limit| match limit {
                Limit::JointVelocity(joint) => Some(usize::from(*joint)),
                _ => None,
            });
            q = q.zip(&rates.rates, |q, rate| q + rate);
        }
        self.inside(chain, &q)?;
        let (linear, angular) = apart(&chain.forward(&q), pose);
        let threshold = RateSettings::default().threshold;
        let astray = linear.norm() > ASTRAY.0 || angular.norm() > ASTRAY.1;
        if let Some(joint) = slowest.filter(|_| astray && chain.dexterity(&q, LENGTH) > threshold) {
            let (mm, tilted) = (self.depth * 1e3, &self.tilted);
            return Err(Misfit::slow(
                chain,
                joint,
                format!(", and does not follow the insertion {mm:.0} mm deep{tilted}"),
            ));
        }
        if astray || chain.dexterity(&q, LENGTH) < threshold {
            return Err(Misfit::Singular {
                depth_mm: self.depth * 1e3,
                needed_mm: self.needed * 1e3,
                tilted: self.tilted.clone(),
            });
        }
        Ok(q)
    }

    /// All joints keep their distance from their ends.
    fn inside(&self, chain: &Chain, q: &Joints) -> Result<(), Misfit> {
        let (room, i) = least_room(chain, q);
        if room >= ROOM {
            return Ok(());
        }
        let (joint, limit, kind) = (
            chain.names()[i].clone(),
            chain.limits()[i],
            chain.kinds()[i],
        );
        if self.depth == 0.0 && self.tilted.is_empty() {
            return Err(Misfit::StartsAtEnd {
                joint,
                position: kind.in_words(q[i]),
                lower: kind.in_words(limit.lower),
                upper: kind.in_words(limit.upper),
            });
        }
        let end = if limit.upper - q[i] < q[i] - limit.lower {
            limit.upper
        } else {
            limit.lower
        };
        Err(Misfit::MeetsEnd {
            joint,
            end: kind.in_words(end),
            depth_mm: self.depth * 1e3,
            needed_mm: self.needed * 1e3,
            tilted: self.tilted.clone(),
        })
    }
}

/// Distance of the joint next to its end from it \[rad\], of sliding joints by their unit, and which
/// joint that is. The one that spins the needle does not count.
fn least_room(chain: &Chain, q: &Joints) -> (f64, usize) {
    let joints = q.iter().zip(chain.limits()).zip(chain.kinds()).enumerate();
    let spinner = chain.spin().map(|spin| spin.joint);
    joints
        .filter(|(i, (_, kind))| Some(*i) != spinner && **kind != JointKind::Continuous)
        .map(|(i, ((q, limit), kind))| {
            let room = (q - limit.lower).min(limit.upper - q);
            (room / kind.unit(), i)
        })
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap_or((f64::INFINITY, 0))
}

/// Translation and rotation vector from `a` to `b`.
fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    // Not by a matrix: the angle of one that is rounded beyond the identity is not a number.
    let turn = b.rotation * a.rotation.inverse();
    (
        b.translation.vector - a.translation.vector,
        turn.scaled_axis(),
    )
}

#[cfg(test)]
mod tests;
