//! The path grows, relaxes and tears.

use nalgebra::Vector3;

use super::{HOLE_REACH, LONGEST_STEP, RodPlant};
use crate::path::{CutPath, Rip, Tear};
use crate::truth::Event;

impl RodPlant {
    /// Extends the path to where the cutting edge went, or begins or leaves it.
    pub(super) fn cut(&mut self, advance: f64) {
        let (edge, direction) = self.edge();
        let material = self.placement.material_of(&edge);
        match &mut self.path {
            Some(path) => {
                let ahead = self.contact.edge.arc - path.length();
                if ahead > 0.0 {
                    path.cut(ahead, self.tissue.stiffness(material.z), &self.placement);
                } else if material.z < 0.0 || self.contact.edge.arc < 0.0 && advance <= 0.0 {
                    self.pull_out();
                }
            }
            None if material.z > 0.0 && direction.z > 0.05 => {
                let entry = edge - direction * (material.z / direction.z);
                let old = self
                    .parked
                    .take()
                    .filter(|p| p.enters_near(&entry, HOLE_REACH));
                let reused = old.is_some();
                let mut path = old.unwrap_or_else(|| {
                    let surface = self.tissue.stiffness(0.0);
                    let mut fresh =
                        CutPath::starting_at(entry, direction, surface, &self.placement);
                    let depth = material.z / direction.z;
                    let pieces = (depth / LONGEST_STEP).ceil().clamp(1.0, 4e3);
                    let mut cut = 0.0;
                    while cut < depth * (1.0 - 1e-9) {
                        cut += depth / pieces;
                        let stiffness = self.tissue.stiffness(cut * direction.z);
                        fresh.cut(depth / pieces, stiffness, &self.placement);
                    }
                    fresh
                });
                if reused {
                    path.place(&self.placement);
                }
                self.contact.edge = path.locate(&edge, 0);
                if !reused {
                    self.skin.pierce(Some(&entry), &self.placement);
                }
                self.path = Some(path);
                self.report(Event::Entered { reused });
            }
            None => {}
        }
    }

    fn pull_out(&mut self) {
        self.parked = self.path.take();
        self.contact.clear(self.rod.nodes.len());
        self.skin.stretch = Vector3::zeros();
        self.report(Event::PulledOut);
    }

    /// Relaxation and tearing.
    pub(super) fn age(&mut self, dt: f64) {
        let relaxes = self.tissue.law.relaxed > 0.0;
        let overstretched = self.tissue.tear.is_finite()
            && self
                .contact
                .displacement
                .iter()
                .any(|u| u.norm_squared() > self.tissue.tear * self.tissue.tear);
        let (edge, heading) = self.edge();
        let bevel_length = self.bevel_length();
        let Some(path) = &mut self.path else {
            return;
        };
        if !relaxes && !overstretched {
            return;
        }
        let creep = if relaxes {
            -(-dt / self.tissue.relaxation).exp_m1()
        } else {
            0.0
        };
        let contact = &self.contact;
        let last = contact.feet.len() - 1;
        let ripped = contact.displacement[last].norm() > self.tissue.tear;
        if ripped && contact.feet[last].arc < bevel_length {
            // Nothing is left to hold it.
            self.pull_out();
            return;
        }
        let tear = Tear {
            threshold: self.tissue.tear,
            rip: ripped.then_some(Rip {
                tip: contact.feet[last],
                edge,
                heading,
            }),
        };
        // The first node outside is about an edge farther back, and there the tissue ends.
        let reach = 2.0 * self.rod.edge;
        let mut i = contact.first.min(last);
        let torn = path.age(creep, &tear, &self.placement, |arc| {
            let beside = |first: usize| contact.feet[first].arc - reach..=contact.feet[last].arc;
            if contact.first > last || !beside(contact.first).contains(&arc) {
                return Vector3::zeros();
            }
            while i < last && contact.feet[i].arc < arc {
                i += 1;
            }
            if i == contact.first {
                return contact.displacement[i];
            }
            let (a, b) = (contact.feet[i - 1].arc, contact.feet[i].arc);
            let share = if b > a { (arc - a) / (b - a) } else { 1.0 };
            contact.displacement[i - 1].lerp(&contact.displacement[i], share)
        });
        if let Some((depth_m, by_m)) = torn {
            // The path moved under the cutting edge.
            let segment = self.contact.edge.segment;
            self.contact.edge = path.locate(&edge, segment);
            self.report(Event::Tearing { depth_m, by_m });
        }
    }
}
