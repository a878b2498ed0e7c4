//! The tip as the estimator answers it.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};

use super::{Estimator, LOOSE, in_hole, planar};
use crate::view::Tip;

impl Estimator {
    pub(super) fn tip(&self, age: f64) -> Tip {
        let m = &self.present;
        let p = &m.filter.ruling().p;
        let slope = self.slope();
        let position = self.tip_beside(&m.filter.place_bias());
        let axis = self.world_from_insertion.rotation * Vector3::new(slope.x, slope.y, 1.0);
        let from = self.present_base.rotation * Vector3::z();
        // Without torsion the tip frame is the base frame turned the shortest way.
        let bend = UnitQuaternion::rotation_between(&from, &axis).unwrap_or_default();
        Tip {
            world_from_tip: Isometry3::from_parts(
                Translation3::from(position.coords),
                bend * self.present_base.rotation,
            ),
            position_sigma: (0.5 * (p[(0, 0)] + p[(1, 1)])).sqrt(),
            direction_sigma: 0.2_f64.to_radians(),
            age,
        }
    }

    /// Slope of the tip as it is measured.
    fn slope(&self) -> Vector2<f64> {
        planar(&self.present.rod.tip_slope()) + self.slope_offset
    }

    /// O in World, with a lasting error of the sensor \[m\].
    fn tip_beside(&self, bias: &Vector2<f64>) -> Point3<f64> {
        let m = &self.present;
        let c = if m.retracted > LOOSE {
            in_hole(m) + self.beside_hole
        } else {
            m.filter.position()
        };
        let c = c + bias;
        let slope = self.slope();
        let back = Vector3::new(slope.x, slope.y, 1.0);
        let back = back * (self.reach / back.norm());
        let edge = Point3::new(c.x, c.y, m.path.tip_depth() - m.retracted);
        self.world_from_insertion * (edge - back)
    }

    /// The tip as it lies beside the base, in World \[m\]: less the lasting error of a sensor of the
    /// tip alone, where [`Estimator::predict`] answers it as that sensor shows it.
    pub fn tip_beside_base(&self) -> Point3<f64> {
        self.tip_beside(&Vector2::zeros())
    }
}
