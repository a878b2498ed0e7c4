//! The plant's state as others see it.

use hal::frame::{NeedleBase, World};
use hal::{Stamp, Transform};
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::RodPlant;
use crate::truth::Event;
use crate::twist::transport;

/// Rotation of a frame with z along `z` and x nearest to `x`.
fn frame(z: Vector3<f64>, x: Vector3<f64>) -> UnitQuaternion<f64> {
    let x = (x - z * z.dot(&x)).normalize();
    let matrix = Matrix3::from_columns(&[x, z.cross(&x), z]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix))
}

impl RodPlant {
    /// Notes an event; one of a kind per `advance`, the first.
    pub(super) fn report(&mut self, event: Event) {
        self.truth.note(event);
    }

    fn check_yield(&mut self) {
        let stress_per_moment =
            self.radius / self.rod.section.bending * (self.settings.needle.young_gpa * 1e9);
        let moment = (0..self.rod.edges())
            .map(|i| self.rod.bending_moment(i).norm())
            .fold(0.0, f64::max);
        let stress_pa = moment * stress_per_moment;
        if stress_pa > self.settings.needle.yield_mpa * 1e6 {
            self.report(Event::Yielding { stress_pa });
        }
    }

    pub(super) fn publish(&mut self, stamp: Stamp, world_from_base: &Transform<World, NeedleBase>) {
        self.check_yield();
        let rotation = self.world_from_phantom.rotation;
        let edges = self.rod.edges();
        let direction = self.rod.direction(edges - 1);
        let tip = Isometry3::from_parts(
            self.rod.nodes[edges].into(),
            frame(direction, self.tip_director_now(&direction)),
        );
        let truth = &mut self.truth;
        truth.stamp = stamp;
        truth.needle.stamp = stamp;
        let matrix = rotation.to_rotation_matrix();
        let origin = self.world_from_phantom.translation.vector;
        for (point, node) in truth.needle.centreline.iter_mut().zip(&self.rod.nodes) {
            *point = matrix * node + origin;
        }
        truth.needle.world_from_tip = Transform::assume(self.world_from_phantom * tip);
        truth.world_from_base = *world_from_base;
        let out_of_balance = |event: &Event| matches!(event, Event::Unconverged { .. });
        let balanced = !truth.events.iter().any(out_of_balance);
        // Forces of a shape out of balance are none, and would throw a compliant holder away for good:
        // the last ones stay.
        if balanced {
            truth.base_wrench.force = rotation * self.rod.clamp_force();
            truth.base_wrench.moment =
                rotation * (self.rod.bending_moment(0) - self.rod.clamp * self.rod.torque[0]);
        }
        truth.torsion = self.twist.tip_angle();
        truth.tip_force = rotation * self.contact.tip_force;
        truth.depth = self.contact.edge.arc;
        truth.cut_path.clear();
        if let Some(path) = &self.path {
            let points = path.points().iter().map(|p| matrix * p + origin);
            truth.cut_path.extend(points);
        } else {
            truth.depth = 0.0;
        }
        self.publish_stretch(balanced);
    }

    /// Material x axis at the tip of the shape as it is now.
    fn tip_director_now(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        let mut tangent = self.rod.clamp;
        let mut carried = self.pose.rotation * Vector3::x();
        for i in 0..self.rod.edges() {
            let t = self.rod.direction(i);
            carried = transport(&carried, &tangent, &t);
            tangent = t;
        }
        let (sin, cos) = self.twist.tip_angle().sin_cos();
        carried * cos + direction.cross(&carried) * sin
    }

    fn publish_stretch(&mut self, balanced: bool) {
        let contact = &self.contact;
        let (mut sum, mut length, mut largest) = (0.0, 0.0, 0.0f64);
        for (u, w) in contact.displacement.iter().zip(&contact.weight) {
            if *w > 0.0 {
                let size = u.norm();
                sum += w * size;
                length += w;
                largest = largest.max(size);
            }
        }
        let first = contact.first;
        let edges = self.rod.edges();
        let truth = &mut self.truth;
        truth.mean_stretch = if length > 0.0 { sum / length } else { 0.0 };
        truth.max_stretch = largest;
        let spacing = self.rod.edge;
        if first <= edges && contact.weight[first] > 0.0 {
            truth.needle.entry_arc = first as f64 * spacing - contact.feet[first].arc;
            truth.entry_stretch = contact.displacement[first].norm();
            if balanced {
                let tissue = self.rod.clamp_force();
                let axis = self.rod.direction(first.min(edges - 1));
                let across = -(tissue - axis * axis.dot(&tissue));
                truth.entry_force = self.world_from_phantom.rotation * across;
            }
        } else {
            truth.needle.entry_arc = edges as f64 * spacing;
            truth.entry_stretch = 0.0;
            truth.entry_force = Vector3::zeros();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::default_setup;
    use crate::plant::Plant;
    use crate::settings::Settings;

    /// A holder that yields to forces which no needle exerts is thrown away, and stays there: every
    /// further pose is refused.
    #[test]
    fn forces_of_a_shape_out_of_balance_reach_nobody() {
        let settings = Settings::preset("paper").unwrap();
        let setup = default_setup(&settings, 1);
        let mut plant = RodPlant::new(
            &settings,
            &setup.world_from_phantom,
            &setup.world_from_base,
            1,
        )
        .unwrap();
        let start = *setup.world_from_base.isometry();
        for k in 1..=300_u32 {
            let depth = 1e-4 * f64::from(k);
            let pose = start * Isometry3::translation(0.05 * depth, 0.0, depth);
            plant.advance(
                &Transform::assume(pose),
                Stamp::from_secs(f64::from(k) / 30.0),
            );
        }
        let before = plant.truth().clone();
        assert!(before.base_wrench.force.norm() > 1e-3 && before.entry_force.norm() > 1e-3);
        plant.rod.load.fill(Vector3::from_element(1e9));
        plant.truth.events = vec![Event::Unconverged {
            last_step_m: 1.0,
            held: true,
        }];
        let base = before.world_from_base;
        plant.publish(before.stamp, &base);
        assert_eq!(plant.truth().base_wrench, before.base_wrench);
        assert_eq!(plant.truth().entry_force, before.entry_force);
    }
}
