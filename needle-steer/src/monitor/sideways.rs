//! Does the tip move sideways more than base and steering explain? Then the tissue moves.

use std::collections::VecDeque;

use hal::Stamp;
use nalgebra::{Isometry3, Point3, Unit, Vector3};

/// Time over which the way of the tip is compared \[s\]: a third of a slow breath.
const WINDOW: f64 = 1.5;
/// Slope of the tip's path against its axis that steering may make \[1\]: 20 degrees.
const SLOPE: f64 = 0.36;
/// Way aside that nothing has to explain \[m\]: noise, bending of the arm, snapping of the tip.
const FREE: f64 = 1e-3;
/// Measurements that are averaged, as many as at both ends of the window.
const AVERAGED: usize = 5;
/// How long a finding lasts \[s\]: the longest breath, with rests.
const LASTS: f64 = 10.0;

#[derive(Clone, Copy, Debug)]
struct Sample {
    stamp: Stamp,
    base: Isometry3<f64>,
    tip: Vector3<f64>,
}

/// Compares the sideways motion of the tip with that of the base.
#[derive(Clone, Debug, Default)]
pub struct Sideways {
    recent: VecDeque<Sample>,
    samples: VecDeque<Sample>,
    /// Largest unexplained way \[m\], and when it was last seen.
    finding: Option<(f64, Stamp)>,
    largest: f64,
}

impl Sideways {
    /// Takes in the measured tip and its axis, with the base at the same instant, in World.
    pub fn observe(
        &mut self,
        stamp: Stamp,
        base: &Isometry3<f64>,
        tip: &Point3<f64>,
        axis: &Unit<Vector3<f64>>,
    ) {
        if self.recent.len() == AVERAGED {
            self.recent.pop_front();
        }
        self.recent.push_back(Sample {
            stamp,
            base: *base,
            tip: tip.coords,
        });
        if self.recent.len() < AVERAGED {
            return;
        }
        let middle = self.recent[AVERAGED / 2];
        let sum: Vector3<f64> = self.recent.iter().map(|s| s.tip).sum();
        let now = Sample {
            tip: sum / AVERAGED as f64,
            ..middle
        };
        while (self.samples.front()).is_some_and(|s| now.stamp.secs_since(s.stamp) > WINDOW) {
            self.samples.pop_front();
        }
        let unexplained = |then: &Sample| {
            let way = now.tip - then.tip;
            let along = axis.dot(&way);
            let aside = (way - axis.scale(along)).norm();
            let lever = (now.tip - now.base.translation.vector).norm();
            let turned = now.base.rotation.inverse() * Vector3::z_axis();
            let turned_then = then.base.rotation.inverse() * Vector3::z_axis();
            let by_base = (now.base.translation.vector - then.base.translation.vector).norm()
                + lever * turned.angle(&turned_then);
            let explained = by_base + SLOPE * along.abs();
            if aside > explained + FREE {
                aside - explained
            } else {
                0.0
            }
        };
        let most = self.samples.iter().map(unexplained).fold(0.0, f64::max);
        if most > 0.0 {
            self.largest = self.largest.max(most);
            let before = self.finding(now.stamp).unwrap_or(0.0);
            self.finding = Some((most.max(before), now.stamp));
        }
        self.samples.push_back(now);
    }

    /// The same since the beginning: how far the tissue has been seen to move by itself \[m\].
    pub const fn largest(&self) -> f64 {
        self.largest
    }

    /// The largest way of the tip within the last breath that only moving tissue explains \[m\].
    pub fn finding(&self, now: Stamp) -> Option<f64> {
        let (most, seen) = self.finding?;
        (now.secs_since(seen) < LASTS).then_some(most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(breathing: f64, shift: f64) -> Option<f64> {
        let mut sideways = Sideways::default();
        for k in 0..600_u32 {
            let t = f64::from(k) / 30.0;
            let base = Isometry3::translation(shift * t, 0.0, 1e-3 * t);
            let breath = breathing * (core::f64::consts::PI * 0.25 * t).cos().powi(4);
            let tip = Point3::new(shift * t + breath, 2e-4 * t, 0.126 + 1e-3 * t);
            let stamp = Stamp::from_secs(t);
            sideways.observe(stamp, &base, &tip, &Vector3::z_axis());
        }
        sideways.finding(Stamp::from_secs(20.0))
    }

    #[test]
    fn breathing_is_told_from_steering_and_from_the_base() {
        assert_eq!(found(0.0, 0.0), None);
        assert_eq!(found(0.0, 3e-3), None);
        assert!(found(15e-3, 0.0).is_some_and(|by| by > 10e-3));
        assert!(found(4e-3, 0.0).is_some_and(|by| by > 1e-3));
    }
}
