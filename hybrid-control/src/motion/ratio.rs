//! How much of the marker's motion there is at the surface, as the needle's tip shows it.
//!
//! Uncut tissue holds the tip, so the tip moves with the tissue at its depth. What is left of the
//! tip's way after its own progress tells the motion there, most of all where it is shallow.

use hal::Stamp;
use nalgebra::{Point3, Unit, Vector3};

use crate::view::Entry;

/// Time between samples \[s\]: long against noise, short against the bending of the path.
const INTERVAL: f64 = 0.3;
/// Depth from which the tissue holds the tip \[m\].
const HELD: f64 = 1e-3;
/// What the path's bending adds to a sample \[m\].
const PATH_SIGMA: f64 = 0.03e-3;

#[derive(Clone, Copy, Debug)]
struct Sample {
    stamp: Stamp,
    tip: Point3<f64>,
    /// The marker's displacement \[m\].
    moved: Vector3<f64>,
    /// Depth of the tip over the marker's.
    part: f64,
}

/// Least squares on the ratio with a prior.
#[derive(Clone, Debug)]
pub(super) struct SurfaceRatio {
    value: f64,
    information: f64,
    moment: f64,
    last: Option<Sample>,
}

impl SurfaceRatio {
    /// A ratio known to `sigma` only.
    pub(super) fn new(prior: f64, sigma: f64) -> Self {
        let information = sigma.max(1e-6).powi(-2);
        Self {
            value: prior,
            information,
            moment: prior * information,
            last: None,
        }
    }

    pub(super) fn value(&self) -> f64 {
        self.value
    }

    /// Takes in a measured tip and its axis, with the marker's displacement of the same instant
    /// and its depth at rest \[m\].
    pub(super) fn observe(
        &mut self,
        entry: &Entry,
        (stamp, tip, axis): (Stamp, &Point3<f64>, &Unit<Vector3<f64>>),
        sigma: f64,
        (moved, marker_depth): (&Vector3<f64>, f64),
    ) {
        let n = entry.inward.into_inner();
        let depth = (tip - entry.point).dot(&n);
        let sane = sigma.is_finite() && tip.iter().chain(axis.iter()).all(|x| x.is_finite());
        if !sane || depth < HELD || depth > marker_depth || axis.dot(&n) < 0.3 {
            return;
        }
        let now = Sample {
            stamp,
            tip: *tip,
            moved: *moved,
            part: depth / marker_depth,
        };
        let Some(last) = self.last else {
            self.last = Some(now);
            return;
        };
        if stamp.secs_since(last.stamp) < INTERVAL {
            return;
        }
        self.last = Some(now);
        let across = |v: Vector3<f64>| v - n * n.dot(&v);
        // The path's slope at rest: the axis less the shear.
        let shear = across(*moved) * ((1.0 - self.value) / marker_depth);
        let slope = across(axis.into_inner()) / axis.dot(&n) - shear;
        let way = tip - last.tip;
        let deep = moved * now.part - last.moved * last.part;
        let left = across(way - deep) - slope * n.dot(&way);
        let by_ratio = across(moved * (1.0 - now.part) - last.moved * (1.0 - last.part));
        let weight = 1.0 / (2.0 * sigma * sigma + PATH_SIGMA * PATH_SIGMA);
        self.information += by_ratio.norm_squared() * weight;
        self.moment += by_ratio.dot(&left) * weight;
        self.value = (self.moment / self.information).clamp(-1.0, 2.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    /// A tip that goes straight on in breathing tissue tells the ratio within its first breath.
    #[test]
    fn the_tip_tells_the_ratio() {
        let entry = Entry {
            point: Point3::origin(),
            inward: Vector3::z_axis(),
        };
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let noise = Normal::new(0.0, 0.05e-3).unwrap();
        for truth in [0.0, 0.2, 0.6, 1.0] {
            let mut ratio = SurfaceRatio::new(0.2, 0.3);
            for i in 0..150_u32 {
                let t = f64::from(i) / 30.0;
                let depth = 2e-3 + 1e-3 * t;
                let breath = 1.0 - (core::f64::consts::PI * 0.2 * t).cos().powi(4);
                let moved = Vector3::x() * (5e-3 * breath);
                let shear = moved * ((1.0 - truth) / 0.085);
                let slope = Vector3::new(0.01, -0.02, 1.0) + shear;
                let path = Vector3::new(0.01, -0.02, 1.0) * depth;
                let seen = path
                    + moved * truth
                    + shear * depth
                    + Vector3::from_fn(|_, _| noise.sample(&mut rng));
                ratio.observe(
                    &entry,
                    (
                        Stamp::from_secs(t),
                        &seen.into(),
                        &Unit::new_normalize(slope),
                    ),
                    0.05e-3,
                    (&moved, 0.085),
                );
            }
            assert!(
                (ratio.value() - truth).abs() < 0.05,
                "{truth}: {}",
                ratio.value()
            );
        }
    }
}
