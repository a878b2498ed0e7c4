//! One equilibrium: prediction, friction, aim of the cut, Newton.

use nalgebra::{Isometry3, Vector3};

use super::{CUTTING_TRAVEL, Recent, RodPlant};
use crate::guide::Guide;
use crate::medium::{Hold, Medium};
use crate::rod::Solution;
use crate::twist::Sliding;

impl RodPlant {
    pub(super) fn bevel_length(&self) -> f64 {
        2.0 * self.radius / self.bevel_angle.tan()
    }

    /// The guide with the base at `pose`, where there is one.
    fn guide(&self, pose: &Isometry3<f64>) -> Option<Guide> {
        let gap = self.settings.guide.gap_mm * 1e-3;
        (gap > 0.0).then(|| Guide::at(pose, gap))
    }

    /// Position and direction of the cutting edge in the phantom frame.
    pub(super) fn edge(&self) -> (Vector3<f64>, Vector3<f64>) {
        let direction = self.rod.direction(self.rod.edges() - 1);
        let o = self.rod.nodes[self.rod.edges()];
        (o + direction * self.bevel_length(), direction)
    }

    /// Slides the shape along itself with the base, and sideways where it is free.
    pub(super) fn predict(&mut self, pose: &Isometry3<f64>) {
        let motion = pose.translation.vector - self.rod.nodes[0];
        let axis = pose.rotation * Vector3::z();
        let along = axis.dot(&motion);
        let across = motion - axis * along;
        let edges = self.rod.edges();
        let free = self.contact.first.clamp(edges / 8, edges) as f64;
        let guided = self
            .guide(pose)
            .map_or(0.0, |guide| guide.nodes(self.rod.edge).min(free - 1.0));
        self.rod.nodes[0] += motion;
        let mut ahead = axis;
        for i in 1..=edges {
            let here = if i < edges {
                (self.rod.nodes[i + 1] - self.rod.nodes[i]) / self.rod.edge
            } else {
                ahead
            };
            ahead = here;
            let share = (1.0 - (i as f64 - guided).max(0.0) / (free - guided)).max(0.0);
            self.rod.nodes[i] += here * along + across * share;
        }
        self.rod.clamp = axis;
        self.pose = *pose;
    }

    /// How far the prediction slides through the tissue \[m\].
    pub(super) fn slide(&self) -> f64 {
        let Some(path) = &self.path else {
            return 0.0;
        };
        // Against the last equilibrium, so that a motion of the tissue counts too.
        let last = &self.contact.edge;
        path.locate(&self.edge().0, last.segment).arc - last.arc
    }

    /// Friction along and around the shaft, and the force of cutting.
    pub(super) fn rub(&mut self, pose: &Isometry3<f64>, advance: f64) {
        self.fixed.fill(Vector3::zeros());
        self.axial.fill(advance);
        for i in 0..self.touching.len() {
            self.touching[i] = self.contact.weight[i + 1];
        }
        let entry = &self.settings.entry;
        let first = self.contact.first;
        if entry.grip_n > 0.0 && (1..=self.touching.len()).contains(&first) {
            // The skin's grip is that of some length of tissue.
            self.touching[first - 1] += entry.grip_n / self.settings.friction.shaft_n_m;
        }
        let sliding = Sliding {
            axial: &self.axial,
            contact: &self.touching,
            radius: self.radius,
        };
        let director = pose.rotation * Vector3::x();
        self.twist.advance(
            &mut self.rod,
            director,
            &sliding,
            &self.settings.friction,
            &mut self.fixed,
        );
        self.note_resistance();
        self.cutting = (self.cutting + advance).clamp(0.0, CUTTING_TRAVEL);
        let at_end = self
            .path
            .as_ref()
            .is_some_and(|p| self.contact.edge.arc >= p.length() - CUTTING_TRAVEL);
        if at_end && self.cutting > 0.0 {
            let (edge, direction) = self.edge();
            let depth = self.placement.material_of(&edge).z;
            let force = self.tissue.cutting_force(depth) * self.cutting / CUTTING_TRAVEL;
            if let Some(last) = self.fixed.last_mut() {
                *last -= direction * force;
            }
        }
    }

    /// What friction can still do where the shaft slides otherwise than predicted. The friction
    /// of the prediction is all there is in `fixed` so far.
    fn note_resistance(&mut self) {
        let edges = self.rod.edges();
        let per_length = self.settings.friction.shaft_n_m;
        for i in 0..=edges {
            let along = self.rod.direction(i.min(edges - 1));
            let beside = |edge: usize| self.touching.get(edge).copied().unwrap_or_default();
            let before = if i > 0 { beside(i - 1) } else { 0.0 };
            let limit = 0.5 * per_length * (before + beside(i));
            let now = self.fixed[i].dot(&along);
            let noted = &mut self.resistance;
            noted.at[i] = self.rod.nodes[i];
            noted.along[i] = along;
            noted.forward[i] = (limit + now).max(0.0);
            noted.backward[i] = (limit - now).max(0.0);
        }
    }

    pub(super) fn bevel_direction(&self, tangent: &Vector3<f64>) -> Vector3<f64> {
        // -y = -(z x x).
        self.twist.tip_director(tangent).cross(tangent)
    }

    /// Points the path's ray where the tissue will be cut: the tip's direction at the middle
    /// of the step, turned by the cut angle in the bevel's direction there.
    pub(super) fn aim(
        &mut self,
        direction: &Vector3<f64>,
        bevel_before: &Vector3<f64>,
        advance: f64,
    ) {
        let force = self.contact.tip_force;
        let half = if self.recent.advance > 0.0 && advance > 0.0 {
            0.5 * (advance / self.recent.advance).min(2.0)
        } else {
            0.0
        };
        let middle = (direction + (direction - self.recent.direction) * half).normalize();
        let force_middle = force + (force - self.recent.force) * half;
        self.recent = Recent {
            direction: *direction,
            force,
            advance,
        };
        let edges = self.rod.edges();
        let bevel_after = self.bevel_direction(&self.rod.direction(edges - 1));
        let across = |v: Vector3<f64>| v - middle * middle.dot(&v);
        let bevel = across(bevel_before + bevel_after);
        let bevel = bevel / bevel.norm().max(1e-9);
        let Some(path) = &mut self.path else {
            return;
        };
        let depth = self.placement.material_of(&path.end()).z + 0.5 * advance;
        let tissue = &self.tissue;
        let mut turn = bevel * tissue.cut_angle(depth) + across(tissue.direction_noise(depth));
        turn -= across(force_middle) * tissue.compliance;
        if tissue.moment_compliance > 0.0 {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a few edges"
            )]
            let back = ((2.0 * self.radius / self.bevel_angle.tan() / self.rod.edge) as usize)
                .clamp(1, edges - 1);
            let moment = self.rod.bending_moment(edges - back).cross(&middle);
            turn += across(moment) * tissue.moment_compliance;
        }
        let angle = turn.norm();
        path.aim(if angle > 0.0 {
            middle * angle.cos() + turn * (angle.sin() / angle)
        } else {
            middle
        });
    }

    pub(super) fn equilibrate(&mut self) -> Solution {
        let hold = Hold {
            stiffness: self.settings.tip.hold_n_m,
            reach: self.bevel_length(),
            fade: self.bevel_length(),
        };
        let guide = self.guide(&self.pose);
        let solution = self.rod.relax(&mut Medium {
            path: self.path.as_ref(),
            law: self.tissue.law,
            hold,
            contact: &mut self.contact,
            fixed: &self.fixed,
            edge_length: self.rod.edge,
            keep_places: false,
            resistance: &self.resistance,
            resists: false,
            skin: &mut self.skin,
            guide,
        });
        self.iterations += u64::from(solution.iterations);
        solution
    }
}
