//! Can a measurement be of this needle? Wrong units, a wrong frame and leaps are found by what no
//! needle on this base can do, whatever the tissue.

use hal::Stamp;
use nalgebra::{Isometry3, Point3};

/// Slack of every length for registration, sensor and arm \[m\].
pub(crate) const SLACK: f64 = 10e-3;
/// Chord from base to tip over the needle's length \[1\]: less bends it beyond its yield stress.
const SHORTEST: f64 = 0.8;
/// Offset of the tip from the base's axis over the needle's length \[1\]: a mean turn of 30 degrees.
/// Targets 20 mm aside take 0.35.
const ASIDE: f64 = 0.5;
/// Speed of the tip beyond the base's \[m/s\]: deep breathing of 15 mm at 0.3 Hz makes 25 mm/s.
const FASTEST: f64 = 0.06;
/// Leap that noise may make \[m\].
const LEAP: f64 = 4e-3;

/// Share of the tip's leap below which the shaft's first point counts as staying \[1\].
const STAYS: f64 = 0.5;

/// What no needle can do, or does only when it is lost.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, thiserror::Error)]
pub enum Implausible {
    /// Farther from the base than the needle is long, or nearer than it bends.
    #[error(
        "the measured tip is {chord_mm:.0} mm from the base of a needle of {length_mm:.0} mm: needle.length_mm, units or registration?"
    )]
    Length {
        /// Distance from base to tip \[mm\].
        chord_mm: f64,
        /// The needle's length \[mm\].
        length_mm: f64,
    },
    /// Not in front of the base.
    #[error("the measured tip is {aside_mm:.0} mm beside the axis of the base: registration?")]
    Aside {
        /// Distance from the axis \[mm\].
        aside_mm: f64,
    },
    /// A leap of the tip, while the shaft stays where it enters: the shaft gave way.
    #[error("the shaft gave way: the measured tip leapt by {by_mm:.1} mm")]
    Snap {
        /// How far \[mm\].
        by_mm: f64,
    },
    /// A leap of all that is measured.
    #[error(
        "the measured needle leapt by {by_mm:.1} mm in {within_s:.2} s: sensor or registration?"
    )]
    Leap {
        /// How far \[mm\].
        by_mm: f64,
        /// Time since the measurement before \[s\].
        within_s: f64,
    },
    /// A point of the shaft is far away.
    #[error("a measured point of the shaft is {away_mm:.0} mm from the tip: units?")]
    Shaft {
        /// Distance from the tip \[mm\].
        away_mm: f64,
    },
}

/// A plausible measurement, in World.
#[derive(Clone, Copy, Debug)]
struct Seen {
    base: Isometry3<f64>,
    tip: Point3<f64>,
    /// First point of the shaft, near the surface.
    entry: Option<Point3<f64>>,
}

/// Holds every measured shape against the needle that it should be of.
#[derive(Clone, Debug)]
pub struct Plausibility {
    length: f64,
    /// The last plausible measurement.
    last: Option<Seen>,
    /// The last measurement, plausible or not: a leap does not become plausible by waiting.
    seen: Option<Stamp>,
    problem: Option<Implausible>,
}

impl Plausibility {
    /// For a needle of `length` \[m\] from its base to O.
    pub const fn new(length: f64) -> Self {
        Self {
            length,
            last: None,
            seen: None,
            problem: None,
        }
    }

    /// Whether the tip at `tip` with points of the shaft at `shaft` (World) can be of the needle
    /// whose base was at `world_from_base` at the same instant. Values that are not numbers are
    /// not of this needle.
    pub fn admit(
        &mut self,
        stamp: Stamp,
        world_from_base: &Isometry3<f64>,
        tip: &Point3<f64>,
        shaft: impl Iterator<Item = Point3<f64>> + Clone,
    ) -> bool {
        let entry = shaft.clone().next();
        self.problem = self.check(stamp, world_from_base, tip, shaft).err();
        if self.problem.is_none() {
            self.last = Some(Seen {
                base: *world_from_base,
                tip: *tip,
                entry,
            });
        }
        self.seen = Some(stamp);
        self.problem.is_none()
    }

    /// What is wrong with the newest measurement.
    pub const fn problem(&self) -> Option<&Implausible> {
        self.problem.as_ref()
    }

    fn check(
        &self,
        stamp: Stamp,
        world_from_base: &Isometry3<f64>,
        tip: &Point3<f64>,
        shaft: impl Iterator<Item = Point3<f64>> + Clone,
    ) -> Result<(), Implausible> {
        let entry = shaft.clone().next();
        let length = self.length;
        let in_base = world_from_base.inverse_transform_point(tip);
        let chord = in_base.coords.norm();
        // NaN fails every comparison that admits.
        if !(chord >= SHORTEST * length - SLACK && chord <= length + SLACK) {
            return Err(Implausible::Length {
                chord_mm: chord * 1e3,
                length_mm: length * 1e3,
            });
        }
        let aside = in_base.coords.xy().norm();
        if aside > ASIDE * length + SLACK || in_base.z < 0.0 {
            return Err(Implausible::Aside {
                aside_mm: aside * 1e3,
            });
        }
        for point in shaft {
            let away = (point - tip).norm();
            if away.is_nan() || away > length + SLACK {
                return Err(Implausible::Shaft {
                    away_mm: away * 1e3,
                });
            }
        }
        if let Some(then) = &self.last {
            let carried = world_from_base * then.base.inverse_transform_point(&then.tip);
            let by = (tip - then.tip).norm().min((tip - carried).norm());
            let within = self
                .seen
                .map_or(0.0, |seen| stamp.secs_since(seen).max(0.0));
            let at_entry = entry
                .zip(then.entry)
                .map(|(now, before)| (now - before).norm());
            if by > LEAP + FASTEST * within {
                if at_entry.is_some_and(|moved| moved < STAYS * by) {
                    return Err(Implausible::Snap { by_mm: by * 1e3 });
                }
                return Err(Implausible::Leap {
                    by_mm: by * 1e3,
                    within_s: within,
                });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn needle() -> Plausibility {
        Plausibility::new(0.126)
    }

    fn admit(p: &mut Plausibility, seconds: f64, tip: [f64; 3]) -> bool {
        let tip = Point3::from(tip);
        let shaft = [tip - Vector3::z() * 0.02].into_iter();
        p.admit(
            Stamp::from_secs(seconds),
            &Isometry3::identity(),
            &tip,
            shaft,
        )
    }

    #[test]
    fn units_frames_and_leaps_are_found() {
        assert!(admit(&mut needle(), 0.0, [0.0, 0.0, 0.126]));
        assert!(admit(&mut needle(), 0.0, [0.02, 0.0, 0.12]));
        let problem = |tip| {
            let mut p = needle();
            assert!(!admit(&mut p, 0.0, tip));
            *p.problem().unwrap()
        };
        assert!(matches!(
            problem([0.0, 0.0, 126.0]),
            Implausible::Length { .. }
        ));
        assert!(matches!(
            problem([0.0, 0.0, 0.03]),
            Implausible::Length { .. }
        ));
        assert!(matches!(
            problem([f64::NAN, 0.0, 0.1]),
            Implausible::Length { .. }
        ));
        assert!(matches!(
            problem([0.09, 0.0, 0.09]),
            Implausible::Aside { .. }
        ));
        assert!(matches!(
            problem([0.0, 0.0, -0.126]),
            Implausible::Aside { .. }
        ));
        let mut p = needle();
        assert!(admit(&mut p, 0.0, [0.0, 0.0, 0.126]));
        assert!(!admit(&mut p, 0.03, [0.01, 0.0, 0.125]));
        assert!(matches!(p.problem(), Some(Implausible::Leap { .. })));
        // A tip that leaps while the shaft stays at the entry: the shaft gave way.
        let tip = Point3::new(0.01, 0.0, 0.125);
        let shaft = [Point3::new(0.0, 0.0, 0.106)].into_iter();
        let now = Stamp::from_secs(0.04);
        assert!(!p.admit(now, &Isometry3::identity(), &tip, shaft));
        assert!(matches!(p.problem(), Some(Implausible::Snap { .. })));
        // A leap stays one; the needle is where it was.
        assert!(!admit(&mut p, 0.06, [0.01, 0.0, 0.125]));
        assert!(admit(&mut p, 0.09, [0.001, 0.0, 0.126]));
        // Without measurements for long it may have been carried there.
        assert!(admit(&mut p, 0.4, [0.01, 0.0, 0.125]));
    }
}
