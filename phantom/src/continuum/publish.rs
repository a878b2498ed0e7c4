//! The plant's state as others see it.

use hal::frame::{NeedleBase, World};
use hal::{Stamp, Transform};
use nalgebra::{Isometry3, Point3, Translation3, Vector3};

use super::ContinuumPlant;
use crate::truth::{Event, Wrench};

impl ContinuumPlant {
    pub(super) fn publish(&mut self, stamp: Stamp, world_from_base: &Transform<World, NeedleBase>) {
        self.check_yield();
        let world = self.world_from_phantom;
        let turn = world.rotation;
        let n = &self.settings.needle;
        let length = n.length_mm * 1e-3;
        let count = n.elements;
        let spacing = length / count as f64;
        let rotation = self.tip_rotation();
        let tip = (world * Point3::from(self.shaft_at(length))).coords;
        let entry_arc = (self.length() - self.inserted()).min(length);
        let bend = self.beam.base_bend() * self.beam.bending;
        let axis = {
            let first = self.first.clamp(1, self.beam.across.len());
            self.beam.direction(first - 1)
        };
        let inside = self.cut.inside();
        // The surface's dent is no stretch along a path.
        let held = if inside { self.held.as_slice() } else { &[] };
        let sizes = || {
            let all = self.displaced.iter().zip(&self.sources);
            all.filter(move |_| inside)
                .map(|(u, s)| (u.norm(), s.length))
        };
        let entry_force = if inside {
            self.loads - axis * axis.dot(&self.loads)
        } else {
            Vector3::zeros()
        };
        let (entry_stretch, _) = sizes().next().unwrap_or_default();
        let max_stretch = sizes().map(|(u, _)| u).fold(0.0, f64::max);
        let stretched: f64 = sizes().map(|(u, length)| u * length).sum();
        let mean_stretch = stretched / self.inserted().max(f64::MIN_POSITIVE);
        let tip_force = self.face + held.last().copied().unwrap_or_default();
        let path: f64 = self.cut.path.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
        let end = self.cut.end().map_or(0.0, |end| end.z);
        let behind = (end - self.placement.material_of(&self.edge()).z).max(0.0);
        let line = (0..=count).map(|k| self.shaft_at(spacing * k as f64));
        let line: Vec<_> = line.map(|p| (world * Point3::from(p)).coords).collect();
        let t = &mut self.truth;
        t.stamp = stamp;
        t.needle.stamp = stamp;
        t.needle.centreline = line;
        t.needle.world_from_tip = Transform::assume(Isometry3::from_parts(
            Translation3::from(tip),
            turn * rotation,
        ));
        t.needle.entry_arc = entry_arc;
        t.world_from_base = *world_from_base;
        t.torsion = self.torsion;
        t.tip_force = turn * tip_force;
        t.entry_force = turn * entry_force;
        t.entry_stretch = entry_stretch;
        t.max_stretch = max_stretch;
        t.mean_stretch = mean_stretch;
        t.base_wrench = Wrench {
            force: turn * -self.loads,
            moment: turn * self.beam.clamp.cross(&-bend),
        };
        t.cut_path.clear();
        let points = self.cut.path.iter().map(|p| self.placement.phantom_of(p));
        t.cut_path
            .extend(points.map(|p| (world * Point3::from(p)).coords));
        t.depth = (path - behind).max(0.0);
    }

    fn check_yield(&mut self) {
        let strain = self.beam.sharpest_bend() * self.space.radius;
        let stress_pa = strain * self.settings.needle.young_gpa * 1e9;
        if stress_pa > self.settings.needle.yield_mpa * 1e6 {
            self.report(Event::Yielding { stress_pa });
        }
    }

    /// The shaft at an arc length from the base \[m\], without the corners of its edges: cubic by the
    /// directions at the nodes.
    fn shaft_at(&self, arc: f64) -> Vector3<f64> {
        let (beam, edges) = (&self.beam, self.beam.across.len());
        let tangent = |i: usize| {
            if i == 0 {
                beam.clamp
            } else if i == edges {
                beam.direction(edges - 1)
            } else {
                (beam.direction(i - 1) + beam.direction(i)).normalize()
            }
        };
        let place = arc / beam.edge;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "from 0 to the number of edges"
        )]
        let e = (place as usize).min(edges - 1);
        let t = place - e as f64;
        let (t2, t3) = (t * t, t * t * t);
        beam.nodes[e] * (1.0 - 3.0 * t2 + 2.0 * t3)
            + tangent(e) * (beam.edge * (t - 2.0 * t2 + t3))
            + beam.nodes[e + 1] * (3.0 * t2 - 2.0 * t3)
            + tangent(e + 1) * (beam.edge * (t3 - t2))
    }
}
