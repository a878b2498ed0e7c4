//! Relaxation and tearing of the tissue along the path.

use nalgebra::Vector3;

use super::{CutPath, Foot, SPACING, Station};
use crate::motion::Placement;

/// Radius of the sharpest bend of a torn path over the tear threshold. The shaft is never much
/// farther from the path than that threshold: with more than one times the radius its nearest
/// place on the path is unique, with two it moves gently.
const FAIR_RADIUS: f64 = 2.0;
const MOST_PASSES: u32 = 100;
/// Behind a tip that is torn out sideways the path tears with it over this length \[m\].
const RIP_LENGTH: f64 = 5e-3;

/// Where and how the tissue tears.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tear {
    /// Displacement beyond which the path tears \[m\].
    pub(crate) threshold: f64,
    /// The tip, where it is torn out of the path.
    pub(crate) rip: Option<Rip>,
}

/// A tip torn out of its path sideways: the old hole ahead is lost to it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rip {
    /// Where on the path O is.
    pub(crate) tip: Foot,
    /// The cutting edge.
    pub(crate) edge: Vector3<f64>,
    /// Where the tip points.
    pub(crate) heading: Vector3<f64>,
}

impl Tear {
    /// Share of the displacement by which a ripped tip takes the path at `arc` \[m\] along.
    fn ripped(&self, arc: f64) -> f64 {
        let Some(rip) = &self.rip else {
            return 0.0;
        };
        let share = ((arc - rip.tip.arc) / RIP_LENGTH + 1.0).clamp(0.0, 1.0);
        share * share * (3.0 - 2.0 * share)
    }
}

impl CutPath {
    /// Lets the tissue creep by the fraction `creep` towards the present displacement and tear
    /// where that is beyond the threshold. `displacement(arc)` is the needle's, zero where there
    /// is none. Returns the depth of the worst tear and how far it went \[m\].
    pub(crate) fn age(
        &mut self,
        creep: f64,
        tear: &Tear,
        placement: &Placement,
        mut displacement: impl FnMut(f64) -> Vector3<f64>,
    ) -> Option<(f64, f64)> {
        let mut worst: Option<(f64, f64)> = None;
        for i in 0..self.stations.len() {
            let u = displacement(self.arcs[i]);
            let station = &mut self.stations[i];
            station.crept += creep * (u - station.crept);
            let size = u.norm();
            let torn = (1.0 - tear.threshold / size).max(tear.ripped(self.arcs[i]));
            if size > 0.0 && torn > 0.0 {
                self.points[i] += u * torn;
                station.rest = placement.material_of(&self.points[i]);
                if worst.is_none_or(|(_, w)| w < size * torn) {
                    worst = Some((self.arcs[i], size * torn));
                }
            }
        }
        if worst.is_some() {
            if let Some(rip) = &tear.rip {
                self.end_at(rip, placement);
            }
            self.reach_surface(placement);
            self.space();
            self.fair(FAIR_RADIUS * tear.threshold, placement);
            self.measure();
        }
        worst
    }

    /// Forgets the hole ahead of a tip that was torn out of it, and ends at the cutting edge.
    fn end_at(&mut self, rip: &Rip, placement: &Placement) {
        let keep = (rip.tip.segment + 1).min(self.points.len());
        self.stations.truncate(keep);
        self.points.truncate(keep);
        self.arcs.truncate(keep);
        self.tangents.truncate(keep);
        self.stations.push(Station {
            rest: placement.material_of(&rip.edge),
            crept: Vector3::zeros(),
            stiffness: self.stations[keep - 1].stiffness,
        });
        self.points.push(rip.edge);
        self.arcs.push(0.0);
        self.tangents.push(rip.heading);
    }

    /// Restores the spacing of stations that tearing drew apart or pushed together.
    fn space(&mut self) {
        let mut i = 1;
        while i < self.points.len() {
            let gap = (self.points[i] - self.points[i - 1]).norm();
            if gap < 0.3 * SPACING && i + 1 < self.points.len() && i > 1 {
                self.stations.remove(i);
                self.points.remove(i);
                self.arcs.pop();
                // The ray is last and stays so.
                self.tangents.remove(i - 1);
            } else if gap > 2.0 * SPACING {
                let (a, b) = (self.stations[i - 1], self.stations[i]);
                let half = Station {
                    rest: 0.5 * (a.rest + b.rest),
                    crept: 0.5 * (a.crept + b.crept),
                    stiffness: 0.5 * (a.stiffness + b.stiffness),
                };
                let middle = 0.5 * (self.points[i - 1] + self.points[i]);
                self.stations.insert(i, half);
                self.points.insert(i, middle);
                self.arcs.push(0.0);
                self.tangents.insert(i - 1, self.tangents[i - 1]);
            } else {
                i += 1;
            }
        }
    }

    /// Moves the entry along its first segment back to the surface.
    fn reach_surface(&mut self, placement: &Placement) {
        let Some([first, second]) = self.stations.first_chunk().map(|pair| pair.map(|s| s.rest))
        else {
            return;
        };
        let inward = second - first;
        // A path that runs along the surface is left where it is but for its depth.
        let back = if inward.z > 0.1 * inward.norm() {
            inward * (first.z / inward.z)
        } else {
            Vector3::z() * first.z
        };
        self.stations[0].rest = first - back;
        self.points[0] = placement.phantom_of(&self.stations[0].rest);
    }

    /// Bends the path nowhere sharper than `radius` \[m\]: gel tears smoothly beside a shaft.
    fn fair(&mut self, radius: f64, placement: &Placement) {
        let last = self.points.len() - 1;
        for _ in 0..MOST_PASSES {
            let mut fair = true;
            for i in 1..last {
                let [a, p, b] = [self.points[i - 1], self.points[i], self.points[i + 1]];
                let (before, after) = (p - a, b - p);
                let (la, lb) = (before.norm(), after.norm());
                let sine = before.cross(&after).norm() / (la * lb);
                let turn = sine.atan2(before.dot(&after) / (la * lb));
                let allowed = 0.5 * (la + lb) / radius;
                if turn > 1.02 * allowed {
                    let chord = (a * lb + b * la) / (la + lb);
                    let point = p + (chord - p) * (1.0 - allowed / turn);
                    self.points[i] = point;
                    self.stations[i].rest = placement.material_of(&point);
                    fair = false;
                }
            }
            if fair {
                break;
            }
        }
    }
}
