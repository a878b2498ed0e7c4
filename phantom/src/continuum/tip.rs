//! The cut: the path through the tissue at rest, and the slit in which the bevel cuts on.

use nalgebra::{Vector2, Vector3};

/// Spacing of the path's points along depth \[m\].
const SPACING: f64 = 0.25e-3;
/// Exponent by which a slit that was laid in many directions still has one: of the mean `m` of what
/// cut it, it keeps `|m|^(1 - REGAINED)`. With it the curvature left at duty cycles from 0.1 to 0.9
/// is within 0.1 of needles photographed in gel (LARA, Universidade de Brasilia: by their regression
/// 1 - 0.891 DC of that without spin), with more left at low and less at high ones than 1 - DC.
const REGAINED: f64 = 0.25;

/// What has been cut, in the phantom frame at rest.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Cut {
    /// The path from the entry to its end, deeper from point to point \[m\]; empty before the entry.
    pub(crate) path: Vec<Vector3<f64>>,
    /// Where the edge first touched the surface that it dents and has not cut.
    pub(crate) dent: Option<Vector3<f64>>,
    /// Force with which the edge presses on the tissue ahead of it \[N\].
    pub(crate) pressed: f64,
    /// Mean of the bevel's directions over the latest cut: how far the slit has one.
    slit: Vector3<f64>,
}

impl Cut {
    /// A straight cut along `axis` up to `edge`, if that is in the tissue.
    pub(crate) fn straight(edge: &Vector3<f64>, axis: &Vector3<f64>, bevel: &Vector3<f64>) -> Self {
        let mut cut = Self {
            slit: *bevel,
            ..Self::default()
        };
        if edge.z > 0.0 {
            cut.path.push(edge - axis * (edge.z / axis.z));
            cut.go_on(edge);
        }
        cut
    }

    /// Breaks the surface at its dent, along `axis` as far as the depth `bottom` \[m\].
    pub(crate) fn enter(&mut self, axis: &Vector3<f64>, bevel: &Vector3<f64>, bottom: f64) {
        if let Some(dent) = self.dent.take() {
            self.slit = *bevel;
            self.path.clear();
            self.path.push(dent);
            self.go_on(&(dent + axis * (bottom / axis.z)));
        }
    }

    /// Forgets a cut that the needle has left.
    pub(crate) fn leave(&mut self) {
        self.path.clear();
        self.dent = None;
        self.pressed = 0.0;
    }

    /// Whether the edge is in the tissue.
    pub(crate) fn inside(&self) -> bool {
        self.path.len() >= 2
    }

    /// Where the path ends.
    pub(crate) fn end(&self) -> Option<&Vector3<f64>> {
        self.path.last()
    }

    /// Goes on straight to a deeper `place`, point by point.
    pub(crate) fn go_on(&mut self, place: &Vector3<f64>) {
        let n = self.path.len();
        // The last point is kept once it is a spacing away from the one before.
        if n >= 2 && self.path[n - 1].z - self.path[n - 2].z < SPACING {
            self.path.pop();
        }
        let Some(from) = self.path.last().copied() else {
            self.path.push(*place);
            return;
        };
        let pieces = ((place.z - from.z) / SPACING).floor();
        let mut piece = 1.0;
        while piece <= pieces {
            self.path
                .push(from.lerp(place, piece * SPACING / (place.z - from.z)));
            piece += 1.0;
        }
        if self.path.last().is_some_and(|last| last.z < place.z) {
            self.path.push(*place);
        }
    }

    /// The path at a depth \[m\], and its direction; it goes on straight beyond its end.
    pub(crate) fn at(&self, depth: f64) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let last = self.path.len().checked_sub(2)?;
        let i = self
            .path
            .partition_point(|p| p.z <= depth)
            .saturating_sub(1)
            .min(last);
        let (a, b) = (self.path[i], self.path[i + 1]);
        let share = (depth - a.z) / (b.z - a.z);
        Some((a + (b - a) * share, (b - a).normalize()))
    }

    /// Moves the path aside by what `by` says at every depth \[m\].
    pub(crate) fn displace(&mut self, by: impl Fn(f64) -> Vector2<f64>) {
        for point in &mut self.path {
            let aside = by(point.z);
            point.x += aside.x;
            point.y += aside.y;
        }
    }

    /// The slit goes on by `way` \[m\] while the bevel looks to `bevel`; it remembers `memory` \[m\].
    pub(crate) fn split(&mut self, bevel: &Vector3<f64>, way: f64, memory: f64) {
        self.slit += (bevel - self.slit) * -(-way / memory).exp_m1();
    }

    /// Where the slit leads the tip, across it: of norm 1 where all of it was cut in one direction.
    pub(crate) fn lead(&self) -> Vector3<f64> {
        let size = self.slit.norm();
        if size > 0.0 {
            self.slit * size.powf(-REGAINED)
        } else {
            Vector3::zeros()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_and_large_steps_lay_the_same_path() {
        let line = |z: f64| Vector3::new(0.1 * z, -0.2 * z, z);
        let (mut one, mut many) = (Cut::default(), Cut::default());
        one.path.push(line(0.0));
        many.path.push(line(0.0));
        one.go_on(&line(7.3e-3));
        for i in 1..=73 {
            many.go_on(&line(f64::from(i) * 1e-4));
        }
        for z in [1e-3, 4.4e-3, 7.3e-3] {
            assert!((one.at(z).unwrap().0 - line(z)).norm() < 1e-12);
            assert!((many.at(z).unwrap().0 - line(z)).norm() < 1e-12);
        }
        assert!(many.path.len() <= 32, "{}", many.path.len());
    }

    /// Half of the cut in each of two opposite directions leads nowhere; three quarters in one lead
    /// there, by more than half.
    #[test]
    fn the_slit_leads_where_most_of_it_was_cut() {
        let mut cut = Cut::straight(&Vector3::z(), &Vector3::z(), &Vector3::x());
        let mut alternate = |share: f64| {
            let mut mean = Vector3::zeros();
            for i in 0..80_000 {
                let there = (f64::from(i) * 1e-3).fract() < share;
                let bevel = if there { Vector3::x() } else { -Vector3::x() };
                cut.split(&bevel, 1e-6, 4e-3);
                // Once what was before is forgotten.
                if i >= 40_000 {
                    mean += cut.lead() / 40_000.0;
                }
            }
            mean.x
        };
        let half = alternate(0.5);
        assert!(half.abs() < 0.1, "{half}");
        let most = alternate(0.75);
        assert!(most > 0.52 && most < 0.75, "{most}");
    }
}
