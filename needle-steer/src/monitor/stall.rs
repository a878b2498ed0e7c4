//! Does the tip follow the base? A shaft that buckles and a tip that sticks look alike: the base
//! goes on, the tip does not.

use std::collections::VecDeque;

use hal::Stamp;
use nalgebra::{Point3, Unit, Vector3};

/// Advance of the base over which the tip's is compared \[m\]: below the 3 mm that count as blind
/// pushing, less one for the latency and some for the filter.
const WINDOW: f64 = 1.8e-3;
/// Share of the base's advance that the tip makes at least \[1\]. Sticking and slipping, bending and a
/// base that goes far aside, which has to come closer only for the tip to stay, stay above; what
/// stalls makes none.
const SHARE: f64 = 0.12;
/// Share that a tip which was found to stay behind has to make until it follows again \[1\]: beyond
/// the noise, or a base would creep on between findings.
const FOLLOWS: f64 = 0.35;
/// Measurements that are averaged: 0.15 mm of advance at 30 Hz and 1 mm/s.
const AVERAGED: usize = 5;
/// Advance between samples that are kept \[m\], and how many are: four windows of it, however slowly
/// the base goes.
const APART: f64 = 0.01e-3;
/// See [`APART`].
const KEPT: usize = 600;

/// Averaged base advance and tip advance at one measurement \[m\].
#[derive(Clone, Copy, Debug)]
struct Sample {
    base: f64,
    tip: f64,
}

/// The tip stays behind the base.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Stalled {
    /// Advance of the base \[m\].
    pub base_m: f64,
    /// Advance of the measured tip along its axis meanwhile \[m\].
    pub tip_m: f64,
    /// When it was noticed first.
    pub since: Stamp,
}

/// Compares the advance of the tip with that of the base.
#[derive(Clone, Debug, Default)]
pub struct Stall {
    recent: VecDeque<Sample>,
    samples: VecDeque<Sample>,
    last: Option<Point3<f64>>,
    tip: f64,
    finding: Option<Stalled>,
    /// Where a stall began that is not overcome yet, and where the base was when it was found last \[m\].
    lasting: Option<(Sample, f64)>,
}

impl Stall {
    /// Takes in the measured tip (World) and its axis, and the base's advance at the same instant.
    pub fn observe(
        &mut self,
        exposed: Stamp,
        base: f64,
        tip: &Point3<f64>,
        axis: &Unit<Vector3<f64>>,
    ) {
        // Differences along the axis add up to the way: their noise cancels but at both ends.
        if let Some(last) = &self.last {
            self.tip += axis.dot(&(tip - last));
        }
        self.last = Some(*tip);
        if self.recent.len() == AVERAGED {
            self.recent.pop_front();
        }
        self.recent.push_back(Sample {
            base,
            tip: self.tip,
        });
        if self.recent.len() < AVERAGED {
            return;
        }
        let count = self.recent.len() as f64;
        let now = Sample {
            base: self.recent.iter().map(|s| s.base).sum::<f64>() / count,
            tip: self.recent.iter().map(|s| s.tip).sum::<f64>() / count,
        };
        self.finding = self.compare(exposed, now);
        // Of the time in which the base stands the end counts.
        let stands = |last: &&mut Sample| (now.base - last.base).abs() < APART;
        if let Some(last) = self.samples.back_mut().filter(|last| stands(last)) {
            last.tip = now.tip;
            return;
        }
        if self.samples.len() == KEPT {
            self.samples.pop_front();
        }
        self.samples.push_back(now);
    }

    /// A stall lasts until the tip has followed from where it began, and goes on to while the base
    /// makes another window: a tip that goes to and fro with its tissue would let a base creep on,
    /// a little with every breath.
    fn compare(&mut self, exposed: Stamp, now: Sample) -> Option<Stalled> {
        let over = |(begun, found): (Sample, f64)| {
            now.base < begun.base + 0.5 * WINDOW || now.base > found + WINDOW
        };
        self.lasting = self.lasting.filter(|stall| !over(*stall));
        let share = if self.finding.is_some() {
            FOLLOWS
        } else {
            SHARE
        };
        let stays = |then: &Sample| now.tip - then.tip < share * (now.base - then.base);
        let window = |then: &&Sample| then.base <= now.base - WINDOW;
        let recent = self.samples.iter().rev().find(window).copied();
        let lasting = self.lasting.map(|(begun, _)| begun);
        let before = lasting.into_iter().chain(recent).find(stays)?;
        self.lasting = Some((lasting.unwrap_or(before), now.base));
        Some(Stalled {
            base_m: now.base - before.base,
            tip_m: now.tip - before.tip,
            since: self.finding.map_or(exposed, |found| found.since),
        })
    }

    /// The tip stays behind, by the newest measurements.
    pub const fn finding(&self) -> Option<Stalled> {
        self.finding
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    /// Measurements of a needle whose base advances by 1 mm/s and whose tip sticks at `sticks` mm.
    fn noticed(sticks: f64, noise: f64, seed: u64) -> Option<f64> {
        let mut stall = Stall::default();
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let normal = Normal::new(0.0, noise).unwrap();
        let mut draw = || normal.sample(&mut rng);
        for k in 0..2400_u32 {
            let base = f64::from(k) / 30.0;
            let axis = Unit::new_normalize(Vector3::new(0.02 * draw(), 0.02 * draw(), 1.0));
            let tip = Point3::new(draw(), draw(), base.min(sticks) + draw()) * 1e-3;
            stall.observe(Stamp::from_secs(base), base * 1e-3, &tip, &axis);
            if let Some(found) = stall.finding() {
                assert_eq!(found.since, Stamp::from_secs(base));
                return Some(base);
            }
        }
        None
    }

    /// The same with a tip that sticks in tissue which breathes along the needle.
    #[test]
    fn a_base_does_not_creep_on_with_every_breath() {
        let mut stall = Stall::default();
        let mut base = 0.0_f64;
        for k in 0..3600_u32 {
            let t = f64::from(k) / 30.0;
            let breath = 0.8 * (core::f64::consts::TAU * 0.25 * t).sin();
            let tip = Point3::new(0.0, 0.0, base.min(20.0) + breath) * 1e-3;
            stall.observe(Stamp::from_secs(t), base * 1e-3, &tip, &Vector3::z_axis());
            if stall.finding().is_none() {
                base += 1.0 / 30.0;
            }
        }
        assert!((20.5..24.0).contains(&base), "{base}");
    }

    /// A base that stands while its tip is found to stay behind, and goes on otherwise, in noise that
    /// would let every other measurement find that it follows.
    #[test]
    fn a_base_does_not_creep_on_between_findings() {
        for seed in 1..=20 {
            let mut stall = Stall::default();
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let normal = Normal::new(0.0, 0.05).unwrap();
            let mut base = 0.0_f64;
            for k in 0..1800_u32 {
                // From 20 mm on the tip makes a tenth of the way.
                let way = base.min(20.0) + 0.1 * (base - 20.0).max(0.0);
                let tip = Point3::new(0.0, 0.0, way + normal.sample(&mut rng)) * 1e-3;
                let now = Stamp::from_secs(f64::from(k) / 30.0);
                stall.observe(now, base * 1e-3, &tip, &Vector3::z_axis());
                if stall.finding().is_none() {
                    base += 1.0 / 30.0;
                }
            }
            assert!((21.0..23.5).contains(&base), "seed {seed}: {base}");
        }
    }

    #[test]
    fn a_base_that_creeps_stalls_too() {
        let mut stall = Stall::default();
        let found = (0..3000_u32).find_map(|k| {
            let t = f64::from(k) / 30.0;
            let base = 0.03 * t;
            let tip = Point3::new(0.0, 0.0, 1e-3 * base.min(0.5));
            stall.observe(Stamp::from_secs(t), base * 1e-3, &tip, &Vector3::z_axis());
            stall.finding().map(|_| base)
        });
        // The tip stands from 0.5 mm on.
        assert!(
            found.is_some_and(|base| base < 0.5 + 1e3 * WINDOW),
            "{found:?}"
        );
    }

    #[test]
    fn a_tip_that_sticks_is_noticed_within_two_millimetres_and_no_other() {
        // The noise of the preset `harsh`, and none.
        for noise in [0.0, 0.05, 0.25] {
            for seed in 1..=20 {
                // Without noise after WINDOW (1 - SHARE) = 1.6 mm; noise of 0.25 mm at both ends,
                // averaged over five, shifts that by 0.5 mm in three deviations.
                let at = noticed(40.0, noise, seed).unwrap();
                assert!((40.8..43.0).contains(&at), "{noise}, seed {seed}: {at}");
                assert_eq!(noticed(1e9, noise, seed), None, "{noise}, seed {seed}");
            }
        }
    }
}
