//! Friction against a shaft that snaps.
//!
//! Friction enters an equilibrium as a force, from the slide that the base's motion predicts. A
//! shaft that loses its equilibrium slides otherwise than predicted, and there friction
//! resists: from its predicted value to the limit on either side.

use nalgebra::Vector3;

/// Slide over which that resistance builds up \[m\].
const TRAVEL: f64 = 20e-6;

/// Resistance of the tissue to slides that differ from the predicted one, node by node.
#[derive(Clone, Debug)]
pub(crate) struct Resistance {
    /// Predicted position \[m\] and direction of the shaft.
    pub(crate) at: Vec<Vector3<f64>>,
    pub(crate) along: Vec<Vector3<f64>>,
    /// What friction can add against a slide forward and backward \[N\].
    pub(crate) forward: Vec<f64>,
    pub(crate) backward: Vec<f64>,
}

impl Resistance {
    pub(crate) fn new(nodes: usize) -> Self {
        Self {
            at: vec![Vector3::zeros(); nodes],
            along: vec![Vector3::z(); nodes],
            forward: vec![0.0; nodes],
            backward: vec![0.0; nodes],
        }
    }

    /// Force on node `i` at `position` \[N\] along the shaft, and its decline per slide \[N/m\].
    pub(crate) fn against(&self, i: usize, position: &Vector3<f64>) -> (f64, f64) {
        let slide = self.along[i].dot(&(position - self.at[i]));
        let room = if slide > 0.0 {
            self.forward[i]
        } else {
            self.backward[i]
        };
        let root = slide.hypot(TRAVEL);
        (-room * slide / root, room * TRAVEL * TRAVEL / root.powi(3))
    }
}
