//! How far does the shaft lie from where the tip went? The tip cuts the path that the shaft has to
//! follow: what the shaft leaves it by stretches the tissue, whatever a model says.
//!
//! Tissue that drifts carries the path away, the more the longer ago it was cut. The drift is told
//! by the deep half of the shaft, which lies free in the tissue, and taken off.

use std::collections::VecDeque;

use hal::Stamp;
use nalgebra::{Point3, Unit, Vector3};

/// Distance of kept places of the tip along its axis \[m\]: a path that bends by 1 per 0.1 m leaves
/// a chord of it by 5 um.
const APART: f64 = 2e-3;
/// Measurements of the tip that are averaged.
const AVERAGED: usize = 5;
/// Neighbouring points of the shaft that are averaged: tissue is stretched over more than 5 mm.
const NEIGHBOURS: usize = 3;
/// Standard deviation of the drift's speed that is taken for known before anything is measured \[m/s\]:
/// 1.2 mm/min; and of what else leads the deep shaft beside its path \[m\].
const DRIFT: (f64, f64) = (2e-5, 0.3e-3);

/// A place where the tip was.
#[derive(Clone, Copy, Debug)]
struct Place {
    at: Vector3<f64>,
    stamp: Stamp,
}

/// A point of the shaft against the path.
#[derive(Clone, Copy, Debug)]
struct Beside {
    offset: Vector3<f64>,
    /// Since when the path is cut there \[s\].
    age: f64,
    sigma: f64,
}

/// The way of the measured tip through tissue at rest, and the shaft beside it.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    recent: VecDeque<Vector3<f64>>,
    path: Vec<Place>,
    stretch: Option<f64>,
}

impl Trace {
    /// Takes in a tip measured at `stamp` with its axis, and points of the `shaft` from the entry to
    /// the tip, each with its standard deviation; all where the tissue at rest has them.
    pub fn observe(
        &mut self,
        stamp: Stamp,
        tip: &Point3<f64>,
        axis: &Unit<Vector3<f64>>,
        shaft: &[(Point3<f64>, f64)],
    ) {
        if self.recent.len() == AVERAGED {
            self.recent.pop_front();
        }
        self.recent.push_back(tip.coords);
        if self.recent.len() < AVERAGED {
            return;
        }
        let at = self.recent.iter().sum::<Vector3<f64>>() / AVERAGED as f64;
        let goes_on = |last: &Place| axis.dot(&(at - last.at)) >= APART;
        if self.path.last().is_none_or(goes_on) {
            self.path.push(Place { at, stamp });
        }
        let beside: Vec<Beside> = shaft
            .iter()
            .filter_map(|(point, sigma)| self.beside(stamp, &point.coords, *sigma))
            .collect();
        let drift = drift(&beside[beside.len() / 2..]);
        let size = |near: &[Beside]| {
            let sum: Vector3<f64> = near.iter().map(|b| b.offset).sum();
            let carried: Vector3<f64> = near.iter().map(|b| drift * b.age).sum();
            // A drift that enlarges it is none: a bent shaft that friction holds looks like one.
            let least = sum.norm_squared().min((sum - carried).norm_squared());
            // Two components of noise make an offset larger.
            let noise = 2.0 * near.iter().map(|b| b.sigma * b.sigma).sum::<f64>();
            (least - noise).max(0.0).sqrt() / near.len() as f64
        };
        self.stretch = beside.windows(NEIGHBOURS).map(size).reduce(f64::max);
    }

    /// `point` against the nearest place on the path, if that is not its beginning.
    fn beside(&self, now: Stamp, point: &Vector3<f64>, sigma: f64) -> Option<Beside> {
        let nearest = self.path.windows(2).enumerate().map(|(k, ends)| {
            let along = ends[1].at - ends[0].at;
            let share = (point - ends[0].at).dot(&along) / along.norm_squared();
            let within = share.clamp(0.0, 1.0);
            let cut = ends[1].stamp.secs_since(ends[0].stamp) * within;
            let beside = Beside {
                offset: point - ends[0].at - along * within,
                age: now.secs_since(ends[0].stamp) - cut,
                sigma,
            };
            (beside, k == 0 && share < 0.0)
        });
        let (beside, before) = nearest
            .min_by(|(a, _), (b, _)| a.offset.norm_squared().total_cmp(&b.offset.norm_squared()))?;
        (!before).then_some(beside)
    }

    /// Stretch of the tissue by the newest measurement \[m\]; nothing while too little is known.
    pub const fn stretch(&self) -> Option<f64> {
        self.stretch
    }
}

/// Speed at which the tissue carries the path away \[m/s\], by least squares.
fn drift(deep: &[Beside]) -> Vector3<f64> {
    let least = (DRIFT.1 / DRIFT.0).powi(2);
    let sum: Vector3<f64> = deep.iter().map(|b| b.offset * b.age).sum();
    sum / (deep.iter().map(|b| b.age * b.age).sum::<f64>() + least)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    /// Stretch told at the end of an insertion by 60 mm at 1 mm/s, through tissue that drifts by `drift`
    /// mm/s, with a shaft bowed by `bow` mm aside of the path near the entry and `noise` mm.
    fn told(bow: f64, drift: f64, noise: f64) -> f64 {
        let mut trace = Trace::default();
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let normal = Normal::new(0.0, noise).unwrap();
        let mut draw = || normal.sample(&mut rng);
        for k in 0..=1800_u32 {
            let t = f64::from(k) / 30.0;
            let mut place = |z: f64, bow: f64| {
                let bowed = bow * (core::f64::consts::PI * (z / 30.0).min(1.0)).sin();
                let carried = drift * (t - z);
                Point3::new(bowed + carried + draw(), draw(), z + draw()) * 1e-3
            };
            let tip = place(t, 0.0);
            let shaft: Vec<_> = (0..k / 75)
                .map(|i| (place(2.5 * f64::from(i), bow * t / 60.0), noise * 1e-3))
                .collect();
            trace.observe(Stamp::from_secs(t), &tip, &Vector3::z_axis(), &shaft);
        }
        trace.stretch().unwrap() * 1e3
    }

    #[test]
    fn a_shaft_that_leaves_its_path_stretches_the_tissue_and_drift_does_not() {
        assert!(told(0.0, 0.0, 0.0) < 1e-6);
        assert!((told(3.0, 0.0, 0.0) - 3.0).abs() < 0.3);
        // 12 mm/min: the path at the entry is 12 mm away, all but a twentieth of it told as drift.
        assert!(told(0.0, 0.2, 0.0) < 0.6, "{}", told(0.0, 0.2, 0.0));
        for noise in [0.05, 0.25] {
            assert!(told(0.0, 0.0, noise) < 0.8, "{}", told(0.0, 0.0, noise));
            assert!((told(3.0, 0.0, noise) - 3.0).abs() < 0.8);
        }
    }

    #[test]
    fn nothing_is_told_of_a_shaft_beside_no_known_path() {
        let mut trace = Trace::default();
        for k in 0..10_u32 {
            let stamp = Stamp::from_secs(f64::from(k) / 30.0);
            let shaft = [(Point3::origin(), 1e-4)];
            trace.observe(stamp, &Point3::origin(), &Vector3::z_axis(), &shaft);
            assert_eq!(trace.stretch(), None);
        }
    }
}
