//! The score of a run in truth, whoever knows the truth.

use hal::frame::{LeftCamera, World};
use hal::telemetry::TruthReport;
use hal::{Stamp, Transform};
use nalgebra::Vector3;

/// A laboratory that knows the truth: the simulated world, or an emulated one elsewhere. It can
/// only be read, and only protocol, score and telemetry read it: a controller's inputs are the
/// measurements of [`Snapshot`](crate::cycle::Snapshot).
pub trait GroundTruth: Send {
    /// Straight pre-insertion that this run's protocol asks for \[m\].
    fn pre_insertion(&self) -> f64;

    /// Needle and tissue at the last exposure, without target and errors.
    fn newest(&self) -> TruthReport;

    /// Tip O in truth, World \[m\].
    fn true_tip(&self) -> Vector3<f64>;

    /// Where the marker is in truth, World \[m\]; nothing where none is attached.
    fn marker(&self) -> Option<Vector3<f64>> {
        None
    }

    /// Where the frame of the sensors' measurements truly lies; a registration may think
    /// otherwise.
    fn stereo_from_world(&self) -> Transform<LeftCamera, World>;
}

/// What is done in such a laboratory beside the controller: the tissue is marked, the score kept.
pub trait Scoring: GroundTruth {
    /// Marks the tissue that is at `place` now (World \[m\]), where the laboratory can.
    fn attach_marker(&self, place: &Vector3<f64>) {
        let _ = place;
    }

    /// Starts to keep the score against a true target in World \[m\].
    fn watch(&self, target: Vector3<f64>);

    /// The truth for telemetry, with target and errors.
    fn report(&self) -> TruthReport;

    /// The figures of the run so far; nothing before a target was set.
    fn figures(&self) -> Option<TrueFigures>;
}

/// Final figures of a run in truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueFigures {
    /// Distance of the target from the tip axis when O's plane passed it, or at the end \[m\].
    pub lateral: f64,
    /// The same less what the field of an electromagnetic sensor added to the tip's place there, where
    /// the needle was seen by one \[m\].
    pub lateral_less_bias: Option<f64>,
    /// Target ahead of O at the end \[m\].
    pub axial: f64,
    /// Largest tissue displacement \[m\].
    pub max_stretch: f64,
    /// Tissue displacement, averaged over needle and time \[m\].
    pub mean_stretch: f64,
}

/// Hidden figures of a run, from the moment its target was set.
#[derive(Clone, Copy, Debug)]
pub struct Score {
    target: Vector3<f64>,
    /// Axial and lateral distance at the last exposure.
    before: Option<(f64, f64)>,
    passed: Option<f64>,
    max_stretch: f64,
    sum_stretch: f64,
    states: f64,
    last: Option<Stamp>,
}

impl Score {
    /// Nothing seen yet of a run to `target` (World \[m\]).
    pub const fn new(target: Vector3<f64>) -> Self {
        Self {
            target,
            before: None,
            passed: None,
            max_stretch: 0.0,
            sum_stretch: 0.0,
            states: 0.0,
            last: None,
        }
    }

    /// The target has moved to `target` (World \[m\]).
    pub const fn follow(&mut self, target: Vector3<f64>) {
        self.target = target;
    }

    /// Takes note of an exposure: tip and its axis in World, largest and mean stretch \[m\].
    /// When O's plane passes the target, the distance is taken linearly between exposures.
    pub fn observe(
        &mut self,
        stamp: Stamp,
        tip_and_axis: [&Vector3<f64>; 2],
        [max_stretch, mean_stretch]: [f64; 2],
    ) {
        if self.last == Some(stamp) {
            return;
        }
        self.last = Some(stamp);
        let (axial, lateral) = self.miss(tip_and_axis);
        if axial <= 0.0 && self.passed.is_none() {
            let (axial_before, before) = self.before.unwrap_or((axial, lateral));
            let share = if axial_before > axial {
                axial_before / (axial_before - axial)
            } else {
                0.0
            };
            self.passed = Some(before + share * (lateral - before));
        }
        self.before = Some((axial, lateral));
        self.max_stretch = self.max_stretch.max(max_stretch);
        self.sum_stretch += mean_stretch;
        self.states += 1.0;
    }

    /// How far the target lies ahead of O along the axis, and beside the axis \[m\].
    fn miss(&self, [tip, axis]: [&Vector3<f64>; 2]) -> (f64, f64) {
        let offset = self.target - tip;
        let axial = axis.dot(&offset);
        (axial, (offset - axis * axial).norm())
    }

    /// The figures, with the needle now where `tip` and `axis` say.
    pub fn figures(&self, tip: &Vector3<f64>, axis: &Vector3<f64>) -> TrueFigures {
        let (axial, lateral) = self.miss([tip, axis]);
        TrueFigures {
            lateral: self.passed.unwrap_or(lateral),
            lateral_less_bias: None,
            axial,
            max_stretch: self.max_stretch,
            mean_stretch: self.sum_stretch / self.states.max(1.0),
        }
    }

    /// The truth with target and errors; not numbers where no target is set.
    pub fn complete(score: Option<&Self>, mut truth: TruthReport) -> TruthReport {
        let unset = Self::new(Vector3::from_element(f64::NAN));
        let score = score.unwrap_or(&unset);
        truth.target = score.target;
        (truth.axial_distance, truth.lateral_error) = score.miss([&truth.tip, &truth.direction]);
        truth
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_miss_is_taken_where_the_plane_passes_the_target() {
        let mut score = Score::new(Vector3::new(0.0, 0.0, 0.010));
        let axis = Vector3::z();
        let mut observe = |ms: u64, x: f64, z: f64| {
            let stamp = Stamp::from_nanos(ms * 1_000_000);
            score.observe(stamp, [&Vector3::new(x, 0.0, z), &axis], [1e-3 * z, 2e-3]);
        };
        observe(0, 0.002, 0.008);
        observe(33, 0.001, 0.009);
        observe(33, 9.0, 9.0);
        // Half-way between 1 mm and 3 mm beside the axis.
        observe(66, 0.003, 0.011);
        observe(100, 0.004, 0.012);
        let figures = score.figures(&Vector3::new(0.004, 0.0, 0.012), &axis);
        assert!((figures.lateral - 0.002).abs() < 1e-12, "{figures:?}");
        assert!((figures.axial + 0.002).abs() < 1e-12);
        assert!((figures.mean_stretch - 2e-3).abs() < 1e-12);
        assert!((figures.max_stretch - 1.2e-5).abs() < 1e-12);
        let report = Score::complete(None, TruthReport::default());
        assert!(report.lateral_error.is_nan() && report.target.x.is_nan());
    }
}
