//! How much of the needle the base has fed through the entry.

use nalgebra::{Isometry3, Point3, Unit, Vector3};

use crate::config::Config;
use crate::guide::Guide;

/// Length of needle that lies outside the tissue, by the pose of the base and the nominal entry.
///
/// A base that goes aside or tilts has to come closer only for the tip to stay where it is: its
/// advance along its own axis feeds less than it seems.
#[derive(Clone, Copy, Debug)]
pub struct Feed {
    entry: Point3<f64>,
    inward: Unit<Vector3<f64>>,
    guide: Option<Guide>,
}

impl Feed {
    /// By the insertion and the support of the needle that a configuration names.
    pub fn of(config: &Config) -> Self {
        Self {
            entry: config.entry(),
            inward: config.inward(),
            guide: Guide::of(config),
        }
    }

    /// Length of needle between base and entry \[m\]: a cubic that leaves the base along its axis and
    /// enters along the nominal one. With the slopes `a` and `b` of its ends against its chord `L`, half
    /// the integral of its squared slope makes it L (1 + a²/15 + b²/15 - a b/30).
    pub fn outside(&self, world_from_base: &Isometry3<f64>) -> f64 {
        let (held_until, before) = match self.guide {
            Some(guide) => {
                let guided = guide.at(world_from_base);
                (guided.world_from_exit, guided.before)
            }
            None => (*world_from_base, 0.0),
        };
        let way = self.entry.coords - held_until.translation.vector;
        let chord = way.norm();
        if chord < f64::EPSILON {
            return before;
        }
        let along = way / chord;
        let aside = |axis: Vector3<f64>| axis - along * axis.dot(&along);
        let (a, b) = (
            aside(held_until.rotation * Vector3::z()),
            aside(*self.inward),
        );
        before + chord * (1.0 + (a.norm_squared() + b.norm_squared()) / 15.0 - a.dot(&b) / 30.0)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;

    /// Length of the cubic by small chords.
    fn measured(start: &Isometry3<f64>, feed: &Feed) -> f64 {
        let (p0, p1) = (start.translation.vector, feed.entry.coords);
        let along = (p1 - p0).normalize();
        // Slopes against the chord, as the formula has them.
        let unit = |axis: Vector3<f64>| axis / axis.dot(&along);
        let chord = (p1 - p0).norm();
        let (m0, m1) = (
            unit(start.rotation * Vector3::z()) * chord,
            unit(*feed.inward) * chord,
        );
        let place = |t: f64| {
            let (t2, t3) = (t * t, t * t * t);
            p0 * (2.0 * t3 - 3.0 * t2 + 1.0)
                + m0 * (t3 - 2.0 * t2 + t)
                + p1 * (3.0 * t2 - 2.0 * t3)
                + m1 * (t3 - t2)
        };
        (0..1000)
            .map(|k| (place((f64::from(k) + 1.0) * 1e-3) - place(f64::from(k) * 1e-3)).norm())
            .sum()
    }

    #[test]
    fn a_base_that_goes_aside_feeds_less_than_it_advances() {
        let config = Config::default();
        let feed = Feed::of(&config);
        let start = config.world_from_start_base();
        let ahead = start * Translation3::new(0.0, 0.0, 20e-3);
        assert!((feed.outside(&start) - feed.outside(&ahead) - 20e-3).abs() < 1e-9);
        for (aside_mm, tilt_deg) in [(12.0, 0.0), (12.0, 6.0), (0.0, -8.0), (-20.0, 10.0)] {
            let tilt =
                UnitQuaternion::from_axis_angle(&Vector3::y_axis(), f64::to_radians(tilt_deg));
            let moved = ahead * Translation3::new(aside_mm * 1e-3, 0.0, 0.0) * tilt;
            let (said, true_length) = (feed.outside(&moved), measured(&moved, &feed));
            // The next term of the series, at slopes up to 0.35 over 100 mm.
            assert!(
                (said - true_length).abs() < 0.15e-3,
                "{aside_mm} {tilt_deg}: {said} {true_length}"
            );
            assert!(said > feed.outside(&ahead), "{aside_mm} {tilt_deg}");
        }
    }
}
