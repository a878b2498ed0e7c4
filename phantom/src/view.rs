//! The true needle as a camera or a sensor looks at it.

use hal::frame::{NeedleTip, World};
use hal::{Stamp, Transform};
use nalgebra::Vector3;

/// The true needle at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct NeedleView {
    /// Instant of this state.
    pub stamp: Stamp,
    /// Centreline in World \[m\], from the base (first point) to the shaft centre O just before
    /// the bevel (last point), at equal arc length (0.5 mm by default).
    pub centreline: Vec<Vector3<f64>>,
    /// Material tip frame: origin O, z along the tip axis, bevel direction -y. The sharp point
    /// lies on the -y side of the shaft, `bevel_length` ahead of O; the bevel's face looks to +y.
    pub world_from_tip: Transform<World, NeedleTip>,
    /// Outer diameter of the shaft \[m\].
    pub outer_diameter: f64,
    /// Angle between the tip axis and the bevel's face \[rad\].
    pub bevel_angle: f64,
    /// Arc length from the base at which the shaft enters the gel \[m\]; what lies beyond is in
    /// the gel. Larger than the needle's length while the whole shaft is outside.
    pub entry_arc: f64,
}

impl NeedleView {
    /// Length of the bevel along the tip axis \[m\].
    pub fn bevel_length(&self) -> f64 {
        self.outer_diameter / self.bevel_angle.tan()
    }

    /// The sharp point in World \[m\].
    pub fn sharp_point(&self) -> Vector3<f64> {
        let tip = self.world_from_tip;
        tip.origin().coords()
            + tip.rotate(&Vector3::new(
                0.0,
                -0.5 * self.outer_diameter,
                self.bevel_length(),
            ))
    }

    /// Arc length between neighbouring points of the centreline \[m\].
    pub fn spacing(&self) -> f64 {
        match self.centreline.as_slice() {
            [a, b, ..] => (b - a).norm(),
            _ => 0.0,
        }
    }

    /// Length of shaft in the gel \[m\], up to O.
    pub fn inserted_length(&self) -> f64 {
        let length = self.spacing() * self.centreline.len().saturating_sub(1) as f64;
        (length - self.entry_arc).max(0.0)
    }

    /// Point of the centreline at arc length `arc` from the base \[m\], in World; clamped to
    /// the needle. `None` without two points.
    pub fn point_at(&self, arc: f64) -> Option<Vector3<f64>> {
        let spacing = self.spacing();
        let last = self.centreline.len().checked_sub(2)?;
        let position = (arc / spacing).clamp(0.0, (last + 1) as f64);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to the table"
        )]
        let index = (position as usize).min(last);
        let fraction = position - index as f64;
        Some(self.centreline[index].lerp(&self.centreline[index + 1], fraction))
    }
}
