//! A guide before the tissue, in which the shaft slides.
//!
//! It moves with the needle's base across the insertion and stays where it is along it: between base
//! and exit the shaft lies on the base's axis. Its play, its friction and its yielding are not
//! modelled.

use nalgebra::{Isometry3, Matrix3, Vector3};

use crate::rod::band::Band;

/// Stiffness that holds a node on the guide's axis \[N/m\]: a hundred times that of the tissue's hold
/// on the tip, so that a newton moves it by a micrometre.
const HOLD: f64 = 1e6;

/// The guide, as the base's pose places it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Guide {
    /// Base and direction of the guide's axis.
    base: Vector3<f64>,
    axis: Vector3<f64>,
    /// Distance from the base to the exit along the axis \[m\]; negative where the base is beyond it.
    exit: f64,
}

impl Guide {
    /// The guide whose exit is `gap` \[m\] above the surface (z = 0, z inwards), with the base at
    /// `pose`.
    pub(crate) fn at(pose: &Isometry3<f64>, gap: f64) -> Self {
        let axis = pose.rotation * Vector3::z();
        let base = pose.translation.vector;
        Self {
            base,
            axis,
            exit: (-gap - base.z) / axis.z.max(0.1),
        }
    }

    /// Nodes before the exit, for nodes `edge` \[m\] apart.
    pub(crate) fn nodes(&self, edge: f64) -> f64 {
        (self.exit / edge).max(0.0)
    }

    /// Adds the guide's forces on the nodes, which are `edge` \[m\] apart.
    pub(crate) fn add(
        &self,
        edge: f64,
        nodes: &[Vector3<f64>],
        force: &mut [Vector3<f64>],
        stiffness: &mut Band,
    ) {
        let across = Matrix3::identity() - self.axis * self.axis.transpose();
        for i in 1..nodes.len() {
            // The node at the exit is held in part, so that the exit moves along the shaft smoothly.
            let share = (self.exit / edge - i as f64 + 0.5).min(1.0);
            if share <= 0.0 {
                break;
            }
            let hold = HOLD * share;
            force[i] -= across * (nodes[i] - self.base) * hold;
            stiffness.add_diagonal(i - 1, &(across * hold));
        }
    }
}
