//! Recordings from tables: poses of the needle's support and what was seen of the needle, in World.

use std::path::Path;

use hal::Stamp;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};

use super::recording::{Recording, RecordingError, Seen, Support};
use super::table::{Row, Table, TableError};
use crate::config::{Config, NeedleSupport};

/// Standard deviation of a point where the file gives none \[m\].
const SIGMA: f64 = 0.25e-3;
/// Standard deviation of a tip axis where the file gives none \[rad\].
const AXIS_SIGMA: f64 = 0.3 * std::f64::consts::PI / 180.0;
/// Least distance of base and tip, in lengths of the needle: a needle bent to a radius of 78 mm
/// over 126 mm has 0.9.
const BENT: f64 = 0.8;
/// Largest distance of base and tip, in lengths of the needle: poses are calibrated to 1 to 2 mm.
const STRETCHED: f64 = 1.03;
/// Cosine of the largest angle between a support's z axis and the direction to the tip, 45 deg.
const AHEAD: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Deviation of a quaternion's or a direction's length from 1 that rounding explains.
const ROUNDED_QUATERNION: f64 = 2e-3;
const ROUNDED_DIRECTION: f64 = 0.05;
/// Longest recording \[s\]: no insertion takes half a day; milliseconds read as seconds do.
const LONGEST: f64 = 12.0 * 3600.0;

const BASE: [&str; 7] = [
    "base_x", "base_y", "base_z", "base_qx", "base_qy", "base_qz", "base_qw",
];
const GUIDE: [&str; 7] = [
    "guide_x", "guide_y", "guide_z", "guide_qx", "guide_qy", "guide_qz", "guide_qw",
];
const TIP: [&str; 3] = ["tip_x", "tip_y", "tip_z"];
const AXIS: [&str; 3] = ["axis_x", "axis_y", "axis_z"];

impl Recording {
    /// Reads a table of any usual form; needle and entry come from `config`.
    ///
    /// # Errors
    /// See [`RecordingError`].
    pub fn from_csv(file: &Path, config: &Config) -> Result<Self, RecordingError> {
        let table = Table::read(file)?;
        let guided = config.needle.support == NeedleSupport::Guide;
        let support = if guided || GUIDE.iter().any(|name| table.has(name)) {
            Support::Guide
        } else {
            Support::Base
        };
        let (pose, other) = match support {
            Support::Base => (BASE, GUIDE),
            Support::Guide => (GUIDE, BASE),
        };
        table.require(&["t"])?;
        table.require(&pose)?;
        table.require(&TIP)?;
        if AXIS.iter().any(|name| table.has(name)) {
            table.require(&AXIS)?;
        }
        let length = config.needle.length_mm * 1e-3;
        let mut seen: Vec<Seen> = Vec::new();
        let mut start = 0.0;
        for row in table.rows() {
            if let Some(name) = other.iter().find(|name| row.optional(name).is_some()) {
                let problem = "a recording has columns of the base or of a guide, not of both";
                return Err(row.problem(name, problem).into());
            }
            let time = row.number("t")?;
            if seen.is_empty() {
                start = time;
            }
            let one = sighting(&row, &pose, support, time - start)?;
            if let Some(last) = seen.last()
                && one.stamp <= last.stamp
            {
                let problem = "expected a later time than in the row before; sort the rows by time";
                return Err(row.problem("t", problem).into());
            }
            plausible(&row, &one, support, length)?;
            seen.push(one);
        }
        if seen.is_empty() {
            return Err(RecordingError::Empty {
                file: table.file().to_owned(),
            });
        }
        Ok(Self {
            name: file.display().to_string(),
            config: config.clone(),
            support,
            seen,
        })
    }
}

fn sighting(
    row: &Row<'_>,
    pose: &[&str; 7],
    support: Support,
    time: f64,
) -> Result<Seen, TableError> {
    if time.abs() > LONGEST {
        let problem = format!(
            "{time:.0} s after the first row; is the unit right? `t_ms` has milliseconds, `t_ns` nanoseconds"
        );
        return Err(row.problem("t", &problem));
    }
    if time < 0.0 {
        let problem = "expected a later time than in the row before; sort the rows by time";
        return Err(row.problem("t", problem));
    }
    let [x, y, z, qx, qy, qz, qw] = *pose;
    let quaternion = Quaternion::new(
        row.number(qw)?,
        row.number(qx)?,
        row.number(qy)?,
        row.number(qz)?,
    );
    if (quaternion.norm() - 1.0).abs() > ROUNDED_QUATERNION {
        let problem = format!(
            "expected a unit quaternion, found one of length {:.4}",
            quaternion.norm()
        );
        return Err(row.problem(qx, &problem));
    }
    let world_from_support = Isometry3::from_parts(
        Translation3::from(row.vector([x, y, z])?),
        UnitQuaternion::from_quaternion(quaternion),
    );
    let positive = |name: &str, otherwise: f64| match row.optional(name) {
        None => Ok(otherwise),
        Some(sigma) if sigma > 0.0 => Ok(sigma),
        Some(_) => Err(row.problem(name, "expected a number above 0")),
    };
    let sigma = positive("sigma", SIGMA)?;
    let axis_sigma = positive("axis_sigma", AXIS_SIGMA)?;
    let (direction, direction_sigma) = if AXIS.iter().any(|name| row.optional(name).is_some()) {
        let axis = row.vector(AXIS)?;
        if (axis.norm() - 1.0).abs() > ROUNDED_DIRECTION {
            let problem = format!(
                "expected a unit vector in axis_x to axis_z, found one of length {:.4}",
                axis.norm()
            );
            return Err(row.problem("axis_x", &problem));
        }
        (Unit::new_normalize(axis), axis_sigma)
    } else {
        let axis = world_from_support.rotation * Vector3::z_axis();
        (axis, f64::INFINITY)
    };
    let inserted = row.optional("inserted");
    if inserted.is_some() && support == Support::Base {
        let problem = "the base's pose already says how far the needle is in; remove the column";
        return Err(row.problem("inserted", problem));
    }
    Ok(Seen {
        stamp: Stamp::from_secs(time),
        world_from_support,
        tip: row.vector(TIP)?.into(),
        tip_sigma: sigma,
        direction,
        direction_sigma,
        shaft: row.points("points").iter().map(|p| (*p, sigma)).collect(),
        inserted,
        roll: row.optional("roll"),
    })
}

/// Holds a row against the needle's length: numbers in another unit, another frame or another
/// order are valid numbers.
fn plausible(row: &Row<'_>, seen: &Seen, support: Support, length: f64) -> Result<(), TableError> {
    let origin = Point3::from(seen.world_from_support.translation.vector);
    let to_tip = seen.tip - origin;
    let distance = to_tip.norm();
    let (what, least) = match support {
        Support::Base => ("base", BENT * length),
        Support::Guide => ("the guide's exit", 0.0),
    };
    let most = STRETCHED * length + 3.0 * seen.tip_sigma.min(1e-3);
    if distance < least || distance > most {
        let expected = match support {
            Support::Base => "the needle is",
            Support::Guide => "the needle is only",
        };
        let problem = format!(
            "{what} and tip are {} apart, {expected} {:.0} mm long; are these lengths in the unit that the header says (millimetres are `_mm`), in one frame, and is `needle.length_mm` right?",
            shown(distance),
            length * 1e3
        );
        return Err(row.problem("tip_x", &problem));
    }
    let axis = seen.world_from_support.rotation * Vector3::z();
    if distance > 0.05 * length && axis.dot(&to_tip) < AHEAD * distance {
        let problem = format!(
            "z of {what} points {:.0} deg away from the tip; z is along the needle, quaternions are x, y, z, w",
            axis.angle(&to_tip).to_degrees()
        );
        let column = match support {
            Support::Base => "base_qx",
            Support::Guide => "guide_qx",
        };
        return Err(row.problem(column, &problem));
    }
    if seen.direction.dot(&axis) < 0.0 {
        let problem = "the tip's axis points back to the base; z of both is along the needle";
        return Err(row.problem("axis_x", problem));
    }
    if seen.tip_sigma > length / 10.0 {
        let problem = format!(
            "{} is no sensor's; is the unit right?",
            shown(seen.tip_sigma)
        );
        return Err(row.problem("sigma", &problem));
    }
    let far = |point: &Point3<f64>| (point - seen.tip).norm() > most;
    if let Some((point, _)) = seen.shaft.iter().find(|(point, _)| far(point)) {
        let problem = format!(
            "a point of the shaft is {} from the tip, the needle is {:.0} mm long",
            shown((point - seen.tip).norm()),
            length * 1e3
        );
        return Err(row.problem("points", &problem));
    }
    Ok(())
}

fn shown(length: f64) -> String {
    if length < 1.0 {
        format!("{:.1} mm", length * 1e3)
    } else {
        format!("{length:.1} m")
    }
}

#[cfg(test)]
mod tests;
