//! Breathing without a marker, estimated from the needle's tip.
//!
//! Uncut tissue holds the tip, so a tip that oscillates without having been steered so has
//! been carried by its tissue. What it should have done comes from the estimator.

use hal::Stamp;
use nalgebra::{Point3, Vector3};

use super::field::TissueField;
use super::marker::MarkerTrack;
use crate::settings::MotionSettings;
use crate::view::Entry;

/// Error of the predicted way, standard deviation in one second \[mm\]: what the base does to the
/// tip near the surface is not known better.
const WAY_WALK_MM: f64 = 0.1;
/// No tip is taken for better known than this when breathing is judged: images that disagree stay
/// wrong for a while \[m\].
const LEAST_SIGMA: f64 = 0.1e-3;
/// Probability of stillness below which tissue counts as breathing, from then on.
const TOLD: f64 = 1e-3;
/// Breaths for which tissue must have been seen to breathe before it is followed, and the longest
/// time that this may take \[s\].
const LEARN: f64 = 1.25;
const LEARN_MOST: f64 = 12.0;
/// Relative uncertainty of the rate below which breathing is known.
const RATE_KNOWN: f64 = 0.06;
/// Phases at which a breath is looked at, and those on either side that count as one dwelling.
const PHASES: usize = 24;
const DWELL: usize = 3;
/// Distance to a target, in breaths, from which its passing is timed.
const TIMED: f64 = 1.5;
/// Least and largest part of the nominal speed that timing may ask for.
const SPEEDS: (f64, f64) = (0.3, 1.6);

/// Motion of the tissue as a whole, across the needle, estimated from the tip alone.
///
/// At rest is the tissue as it was when its breathing was known.
#[derive(Clone, Debug)]
pub struct TissueSway {
    entry: Entry,
    lead: f64,
    track: MarkerTrack,
    /// When breathing was distinguished from rest.
    told: Option<Stamp>,
    /// The periodic part at rest \[m\]; nothing while the tissue counts as still.
    rest: Option<Vector3<f64>>,
    dwelling: Dwelling,
}

/// Where the tissue stays longest in a breath.
#[derive(Clone, Copy, Debug, Default)]
struct Dwelling {
    /// Displacement from rest \[m\].
    place: Vector3<f64>,
    /// Its middle, after the newest measurement \[s\], and the breath's length \[s\].
    next: f64,
    period: f64,
}

impl TissueSway {
    /// Tissue that has not been seen to move yet.
    pub fn new(settings: &MotionSettings, entry: &Entry) -> Self {
        let settings = &MotionSettings {
            mean_walk_mm: WAY_WALK_MM,
            ..settings.clone()
        };
        Self {
            entry: *entry,
            lead: settings.lead_ms * 1e-3,
            track: MarkerTrack::or_still(settings),
            told: None,
            rest: None,
            dwelling: Dwelling::default(),
        }
    }

    /// Takes in what is left of the measured tip after its predicted way \[m, World\], with the
    /// measurement's standard deviation per axis. `true`: from now on the tissue's
    /// breathing is known.
    pub fn observe(&mut self, stamp: Stamp, unexplained: &Vector3<f64>, sigma: f64) -> bool {
        let n = self.entry.inward.into_inner();
        let across = unexplained - n * n.dot(unexplained);
        if !self
            .track
            .observe(stamp, &Point3::from(across), sigma.max(LEAST_SIGMA))
        {
            return false;
        }
        if self.told.is_none() && self.track.stillness() < TOLD {
            self.told = Some(stamp);
        }
        let known = self.rest.is_none() && self.told.is_some_and(|at| self.is_known(at, stamp));
        if known {
            self.rest = Some(self.track.swing(stamp, 0.0).0);
        }
        self.find_dwelling();
        known
    }

    /// Tissue breathes, but how is not known yet: what the needle does now cannot be judged.
    pub const fn is_learning(&self) -> bool {
        self.told.is_some() && self.rest.is_none()
    }

    fn is_known(&self, told: Stamp, now: Stamp) -> bool {
        let (seconds, (rate, sigma)) = (now.secs_since(told), self.track.rate());
        seconds * rate > LEARN && sigma < RATE_KNOWN * rate || seconds > LEARN_MOST
    }

    /// The field at `stamp`; nothing where the tissue is still.
    pub fn field(&self, stamp: Stamp) -> Option<TissueField> {
        let rest = self.rest?;
        let (place, rate) = self.track.swing(stamp, 0.0);
        Some(self.carried(place - rest, rate))
    }

    /// The field at `stamp` with the rates of the moment at which a command takes effect.
    pub fn field_to_follow(&self, stamp: Stamp) -> Option<TissueField> {
        let rest = self.rest?;
        let place = self.track.swing(stamp, 0.0).0;
        let rate = self.track.swing(stamp, self.lead).1;
        Some(self.carried(place - rest, rate))
    }

    fn carried(&self, place: Vector3<f64>, rate: Vector3<f64>) -> TissueField {
        TissueField::new(
            &self.entry,
            [place, Vector3::zeros()],
            [rate, Vector3::zeros()],
        )
    }

    /// A target that stands still in World, where the tissue at rest has it while it dwells.
    pub fn target_at_rest(&self, target: &Point3<f64>) -> Point3<f64> {
        target - self.dwelling.place
    }

    /// Speed of insertion with which a target `ahead` \[m\] is passed while the tissue dwells;
    /// the nominal speed where the tissue is still or the target far.
    pub fn timed_speed(&self, now: Stamp, ahead: f64, nominal: f64) -> f64 {
        let (Some(_), Some(last)) = (self.rest, self.track.stamp()) else {
            return nominal;
        };
        let Dwelling { next, period, .. } = self.dwelling;
        if period <= 0.0 || !(0.0..TIMED * period * nominal).contains(&ahead) {
            return nominal;
        }
        let first = (next - now.secs_since(last)).rem_euclid(period);
        let bounds = (SPEEDS.0 * nominal, SPEEDS.1 * nominal);
        (0..4)
            .map(|breath| ahead / (first + f64::from(breath) * period).max(1e-3))
            .min_by(|a, b| {
                let far = |speed: f64| (speed / nominal).ln().abs();
                far(*a).total_cmp(&far(*b))
            })
            .unwrap_or(nominal)
            .clamp(bounds.0, bounds.1)
    }

    /// The phase around which the tissue moves least. Of two that are alike the known one stays.
    fn find_dwelling(&mut self) {
        let (Some(rest), Some((rate, swing))) = (self.rest, self.track.likeliest()) else {
            return;
        };
        let period = 1.0 / rate;
        let places: [Vector3<f64>; PHASES] =
            core::array::from_fn(|i| swing(period * i as f64 / PHASES as f64));
        let before = self.dwelling.place + rest;
        let cost = |i: usize| {
            let spread = (1..=DWELL)
                .flat_map(|k| [(i + k) % PHASES, (i + PHASES - k) % PHASES])
                .map(|k| (places[k] - places[i]).norm())
                .fold(0.0, f64::max);
            spread + 0.25 * (places[i] - before).norm()
        };
        let best = (0..PHASES)
            .min_by(|a, b| cost(*a).total_cmp(&cost(*b)))
            .unwrap_or_default();
        self.dwelling = Dwelling {
            place: places[best] - rest,
            next: period * best as f64 / PHASES as f64,
            period,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, Normal};

    /// Sways on what `truth` makes of the seconds, seen at 30 Hz with noise \[m\]; every so often a
    /// measurement is off by 1 mm.
    fn seen(truth: impl Fn(f64) -> f64, noise: f64, outliers: f64, seconds: f64) -> TissueSway {
        let entry = Entry {
            point: Point3::origin(),
            inward: Vector3::z_axis(),
        };
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let normal = Normal::new(0.0, noise).unwrap();
        let mut sway = TissueSway::new(&MotionSettings::default(), &entry);
        let mut t = 0.0;
        while t < seconds {
            let off = if rng.random_bool(outliers) { 1e-3 } else { 0.0 };
            let place = Vector3::new(
                truth(t) + off + normal.sample(&mut rng),
                normal.sample(&mut rng),
                0.1,
            );
            sway.observe(Stamp::from_secs(t), &place, noise);
            t += 1.0 / 30.0;
        }
        sway
    }

    fn breath(t: f64) -> f64 {
        4e-3 * (1.0 - (core::f64::consts::PI * 0.25 * t).cos().powi(4))
    }

    /// The motion is known to a third of a millimetre, though a base pushed the tip aside too.
    #[test]
    fn breathing_is_told_from_the_tip() {
        let pushed = |t: f64| breath(t) + 0.3e-3 / (1.0 + (20.0 - t).exp());
        let sway = seen(pushed, 0.25e-3, 0.0, 40.0);
        let at = |t: f64| {
            sway.field(Stamp::from_secs(t))
                .unwrap()
                .point_from_rest(&Point3::new(0.0, 0.0, 0.05))
                .x
        };
        let there = at(40.0);
        for k in 0..20 {
            let t = 40.0 + 0.1 * f64::from(k);
            let (found, truth) = (at(t) - there, breath(t) - breath(40.0));
            assert!((found - truth).abs() < 0.35e-3, "{t}: {found} {truth}");
        }
    }

    /// A target is passed in the half of the breath in which the tissue hardly moves, wherever
    /// its timing begins.
    #[test]
    fn a_target_is_passed_where_the_tissue_dwells() {
        for start in 0..8 {
            let begun = 40.0 + 0.5 * f64::from(start);
            let sway = seen(breath, 0.1e-3, 0.0, begun);
            let (mut t, mut ahead) = (begun, 5e-3);
            while ahead > 0.0 && t < begun + 30.0 {
                let speed = sway.timed_speed(Stamp::from_secs(t), ahead, 1e-3);
                assert!((0.3e-3 - 1e-9..=1.6e-3 + 1e-9).contains(&speed));
                ahead -= speed * 0.05;
                t += 0.05;
            }
            assert!(breath(t) > 3.4e-3, "{begun}: {} mm", breath(t) * 1e3);
        }
    }

    /// Noise, outliers, a slow wander and one push are no breathing.
    #[test]
    fn still_tissue_stays_still() {
        let wander = |t: f64| 0.2e-3 * (t / 15.0).sin() + 0.3e-3 / (1.0 + (3.0 * (20.0 - t)).exp());
        for (noise, outliers) in [
            (0.02e-3, 0.0),
            (0.25e-3, 0.0),
            (0.02e-3, 0.01),
            (0.02e-3, 0.05),
        ] {
            let sway = seen(wander, noise, outliers, 90.0);
            let now = Stamp::from_secs(90.0);
            assert!(sway.field(now).is_none(), "{noise} {outliers}");
            assert!(!sway.is_learning(), "{noise} {outliers}");
            assert!((sway.timed_speed(now, 1e-3, 1e-3) - 1e-3).abs() < 1e-15);
        }
    }
}
