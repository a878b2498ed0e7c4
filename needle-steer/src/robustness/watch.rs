//! What a run in a wide world did, step by step, beside what was true.

use hal::telemetry::{Phase, Telemetry, TruthEvent, TruthReport};
use nalgebra::Vector3;

use crate::config::Config;
use crate::controls::Controls;
use crate::monitor::Advance;
use crate::run::Observer;
use crate::springs::shaft_off;

/// One step. Lengths \[m\].
#[derive(Clone, Debug)]
pub(super) struct Moment {
    pub(super) t: f64,
    pub(super) phase: Phase,
    /// Motion of the base along the needle, integrated.
    pub(super) advance: f64,
    /// The estimated tip, World by the controller's registration.
    pub(super) said: Vector3<f64>,
    /// The model's largest stretch, and its force at the entry \[N\].
    pub(super) model: (f64, f64),
    /// Distance of the measured shaft from the model's.
    pub(super) shaft_off: f64,
    /// The way of the true tip along its axis in the tissue, and of the tissue there along the base's,
    /// integrated.
    pub(super) tip_way: f64,
    pub(super) tissue_way: f64,
    pub(super) base: Vector3<f64>,
    pub(super) axis: Vector3<f64>,
    /// Instant of the truth \[s\].
    pub(super) exposed: f64,
    pub(super) path: f64,
    pub(super) tip: Vector3<f64>,
    pub(super) tissue: Vector3<f64>,
    pub(super) stretch: f64,
    pub(super) entry_force: f64,
    pub(super) true_ahead: f64,
    pub(super) true_aside: f64,
}

/// Exposures at which the phantom was out of balance, after which there is no truth to hold anything
/// against, and the phantom takes very long: ten seconds, twice the supervisor's longest hold.
const NO_TRUTH: usize = 300;

/// How far a base went on without its tip \[m\].
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Blind {
    /// As the base went.
    pub(super) in_world: f64,
    /// The same where it is an advance against the tissue too.
    pub(super) in_tissue: f64,
}

/// Keeps every step of a run.
#[derive(Clone, Debug)]
pub struct Watch<'a> {
    controls: &'a Controls,
    /// Steps in which the phantom was out of balance.
    unbalanced: usize,
    advance: Advance,
    path: f64,
    tip_way: f64,
    tissue_way: f64,
    truth: Option<TruthReport>,
    pub(super) moments: Vec<Moment>,
    /// Events of the phantom, and when they were seen \[s\].
    pub(super) events: Vec<(TruthEvent, f64)>,
    /// The newest step.
    pub(super) last: Option<Telemetry>,
}

impl Observer for Watch<'_> {
    fn step(&mut self, telemetry: &Telemetry) {
        let base = telemetry.world_from_base.isometry();
        self.advance.push(telemetry.stamp, base);
        let Some(truth) = &telemetry.truth else {
            return;
        };
        let t = telemetry.stamp.as_secs();
        self.events
            .extend(truth.events.iter().map(|event| (*event, t)));
        self.unbalanced += usize::from(truth.events.contains(&TruthEvent::Unconverged));
        if self.has_no_truth() {
            self.controls.stop();
        }
        self.follow(truth, &(base.rotation * Vector3::z()));
        self.moments.push(Moment {
            t,
            phase: telemetry.phase,
            advance: self.advance.total(),
            said: telemetry.world_from_tip.origin().coords(),
            model: (telemetry.model.max_stretch, telemetry.model.entry_force),
            shaft_off: telemetry.model.shaft_off,
            tip_way: self.tip_way,
            tissue_way: self.tissue_way,
            base: base.translation.vector,
            axis: base.rotation * Vector3::z(),
            exposed: truth.stamp.as_secs(),
            path: self.path,
            tip: truth.tip,
            tissue: truth.tissue_shift,
            stretch: truth.max_stretch,
            entry_force: truth.entry_force,
            true_ahead: truth.axial_distance,
            true_aside: truth.lateral_error,
        });
        self.last = Some(telemetry.clone());
    }
}

impl<'a> Watch<'a> {
    /// Of a run under `controls`, which end it when its world has no truth any more.
    pub fn new(controls: &'a Controls) -> Self {
        Self {
            controls,
            unbalanced: 0,
            advance: Advance::default(),
            path: 0.0,
            tip_way: 0.0,
            tissue_way: 0.0,
            truth: None,
            moments: Vec::new(),
            events: Vec::new(),
            last: None,
        }
    }

    /// Whether the run was given up because its world has no truth any more.
    pub(super) fn has_no_truth(&self) -> bool {
        self.unbalanced >= NO_TRUTH
    }

    /// Adds up what the tip cut and went, and the tissue along the base's `axis`. A needle that leaves
    /// its hole and enters another one has two paths; what tearing takes from a path is taken.
    fn follow(&mut self, truth: &TruthReport, axis: &Vector3<f64>) {
        if let Some(before) = &self.truth {
            if before.path_length > 0.0 && truth.path_length > 0.0 {
                self.path += truth.path_length - before.path_length;
            } else {
                self.path += truth.path_length;
            }
            let shift = truth.tissue_shift - before.tissue_shift;
            self.tissue_way += axis.dot(&shift);
            self.tip_way += truth.direction.dot(&(truth.tip - before.tip - shift));
        }
        if self.truth.is_none() {
            self.path = truth.path_length;
        }
        self.truth = Some(TruthReport {
            shape: Vec::new(),
            ..truth.clone()
        });
    }

    /// Largest advance of the base over any time in which nowhere the cut path grew, nor the tip came
    /// farther along the base's axis in the tissue, by `growth`, from when the needle is in the tissue
    /// \[m\]. A tip that goes to and fro stalls from where it was farthest. A path that tearing
    /// shortens is no stall while the tip goes on.
    ///
    /// In World, as `advance_mm` counts it; and that of it which is advance in the tissue too: a base
    /// that goes with the tissue along its axis pushes nothing, and one that stands while tissue comes
    /// does not advance.
    pub(super) fn blind(&self, growth: f64) -> Blind {
        let cutting: Vec<&Moment> = self.moments.iter().filter(|m| m.path > 0.0).collect();
        let mut largest = Blind::default();
        for (k, then) in cutting.iter().enumerate() {
            let at = then.tip - then.tissue;
            let stalls = |now: &&&Moment| {
                let went_on = now.axis.dot(&(now.tip - now.tissue - at));
                (now.path - then.path).max(went_on) < growth
            };
            for now in cutting[k..].iter().take_while(stalls) {
                let advance = now.advance - then.advance;
                let carried = now.tissue_way - then.tissue_way;
                largest.in_world = largest.in_world.max(advance);
                largest.in_tissue = largest.in_tissue.max(advance.min(advance - carried));
            }
        }
        largest
    }

    /// Longest time in which the model reported the same figures to the last bit while the base
    /// moved \[s\].
    pub(super) fn frozen(&self) -> f64 {
        /// Way of the base that changes every figure \[m\].
        const MOVED: f64 = 0.05e-3;
        let mut longest = 0.0_f64;
        let mut since: Option<&Moment> = None;
        for now in self.moments.iter().filter(|m| m.phase == Phase::Steering) {
            match since {
                Some(then) if then.model == now.model => {
                    if (now.base - then.base).norm() > MOVED {
                        longest = longest.max(now.t - then.t);
                    }
                }
                // NaN is unequal to itself: unknown figures stand for nothing.
                _ => since = Some(now),
            }
        }
        longest
    }

    /// What the distance of the measured shaft from the model's kept to for `seconds`, the most of
    /// the run \[m\].
    pub(super) fn off_for(&self, seconds: f64) -> f64 {
        let steps = &self.moments;
        let mut largest = 0.0_f64;
        let mut first = 0;
        for (k, now) in steps.iter().enumerate() {
            if now.t - steps[0].t < seconds {
                continue;
            }
            while steps[first + 1].t <= now.t - seconds {
                first += 1;
            }
            let least = steps[first..=k].iter().map(|m| m.shaft_off);
            largest = largest.max(least.fold(f64::INFINITY, f64::min));
        }
        largest
    }

    /// How far the true shaft in the tissue lies from the model's at the end \[m\].
    pub(super) fn truly_off(&self, config: &Config) -> f64 {
        let (Some(last), Some(truth)) = (
            &self.last,
            self.last.as_ref().and_then(|t| t.truth.as_ref()),
        ) else {
            return f64::NAN;
        };
        let (entry, inward) = (config.entry(), config.inward());
        let inside = |p: &&Vector3<f64>| inward.dot(&(**p - entry.coords)) > 0.0;
        let shaft: Vec<_> = truth
            .shape
            .iter()
            .filter(inside)
            .map(|p| ((*p).into(), 0.0))
            .collect();
        shaft_off(&last.model.shape, &shaft)
    }

    /// The steps of the last `seconds`.
    pub(super) fn lately(&self, seconds: f64) -> &[Moment] {
        let end = self.moments.last().map_or(0.0, |m| m.t);
        let first = self.moments.partition_point(|m| m.t < end - seconds);
        &self.moments[first..]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bearings::first_telemetry;
    use hal::{ArmMode, ArmState, Joints, Stamp, Transform};
    use nalgebra::Isometry3;

    /// Largest blind advance of a base that goes on by 1 mm/s for 10 s, in tissue that goes with it
    /// by `carried`, while the path grows by `cut` of that and the tip follows both.
    fn blind(carried: f64, cut: f64) -> f64 {
        let positions = Joints::from([0.0; 6]);
        let state = ArmState {
            stamp: Stamp::ZERO,
            positions,
            rates: positions,
            mode: ArmMode::Moving,
        };
        let still = Isometry3::identity();
        let controls = Controls::default();
        let mut watch = Watch::new(&controls);
        let mut telemetry = first_telemetry(&state, &still, &still);
        for k in 0..=300 {
            let t = f64::from(k) / 30.0;
            telemetry.stamp = Stamp::from_secs(t);
            let base = Isometry3::translation(0.0, 0.0, 1e-3 * t);
            telemetry.world_from_base = Transform::assume(base);
            telemetry.truth = Some(TruthReport {
                stamp: telemetry.stamp,
                direction: Vector3::z(),
                tip: Vector3::z() * ((cut + carried) * 1e-3 * t),
                tissue_shift: Vector3::z() * (carried * 1e-3 * t),
                path_length: 1e-3 + cut * 1e-3 * t,
                ..TruthReport::default()
            });
            watch.step(&telemetry);
        }
        watch.blind(0.2e-3).in_tissue
    }

    #[test]
    fn a_base_without_its_tip_pushes_blind_and_one_that_goes_with_the_tissue_does_not() {
        assert!((blind(0.0, 0.0) - 10e-3).abs() < 1e-4);
        assert!(blind(0.0, 1.0) < 0.3e-3);
        assert!(blind(1.0, 0.0) < 1e-4);
        assert!((blind(0.4, 0.0) - 6e-3).abs() < 1e-4);
        // Tissue that comes towards a base does not make it advance by more than it does.
        assert!((blind(-1.0, 0.0) - 10e-3).abs() < 1e-4);
    }
}
