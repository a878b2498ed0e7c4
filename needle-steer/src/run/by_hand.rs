//! What is asked of the hand that pushes the needle.

use hal::Stamp;
use hal::telemetry::Phase;
use nalgebra::{Isometry3, Vector3};

use super::{Insertion, Observer};

impl Insertion<'_> {
    /// Asks the hand that pushes the needle, where one does: for a step, or to hold.
    pub(super) fn ask_hand(
        &mut self,
        now: Stamp,
        base: &Isometry3<f64>,
        goes: bool,
        observer: &mut dyn Observer,
    ) {
        let Some(prompter) = &mut self.prompter else {
            return;
        };
        let telemetry = self.cycle.telemetry();
        let along = base.rotation * Vector3::z();
        let twist = telemetry.base_twist.linear;
        let across = (twist - along * along.dot(&twist)).norm();
        let (ahead, goes) = match self.phase {
            Phase::PreInsertion => (self.straight - travelled(&self.start, base), goes),
            Phase::Steering => (telemetry.axial_distance, goes && !self.passing.is_waiting()),
            _ => (0.0, false),
        };
        if let Some(prompt) = prompter.update(now, across, ahead, goes) {
            observer.prompt(prompt);
        }
    }
}

/// Way of the base along the needle at its start \[m\].
pub(super) fn travelled(start: &Isometry3<f64>, base: &Isometry3<f64>) -> f64 {
    (base.translation.vector - start.translation.vector).dot(&(start.rotation * Vector3::z()))
}
