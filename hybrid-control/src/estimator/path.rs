//! The cut path: where the tip has been, at marks of constant spacing and at the tip.

use crate::estimator::rod::{COLUMNS, Row};

/// Least piece between the last mark and the tip, as a share of the spacing: the rod's stiffness
/// there grows with the inverse cube of its length, and drowns that of all others from 1e-5 on.
const LEAST_PIECE: f64 = 0.01;

/// Path samples over depth, starting at the surface; the last one is the tip.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct CutPath {
    spacing: f64,
    depths: Vec<f64>,
    values: Vec<Row>,
}

impl CutPath {
    /// A path of no length at the origin; `spacing` of its marks \[m\].
    pub(crate) fn new(spacing: f64) -> Self {
        let mut path = Self {
            spacing,
            depths: Vec::with_capacity(128),
            values: Vec::with_capacity(128),
        };
        path.depths.extend([0.0, 1e-6]);
        path.values.extend([[0.0; COLUMNS]; 2]);
        path
    }

    /// Copies without giving up the memory.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.spacing = other.spacing;
        self.depths.clone_from(&other.depths);
        self.values.clone_from(&other.values);
    }

    pub(crate) fn len(&self) -> usize {
        self.depths.len()
    }

    pub(crate) fn depth(&self, i: usize) -> f64 {
        self.depths[i]
    }

    pub(crate) fn value(&self, i: usize) -> &Row {
        &self.values[i]
    }

    /// Depth of the tip \[m\].
    pub(crate) fn tip_depth(&self) -> f64 {
        self.depths[self.len() - 1]
    }

    /// Lateral position of the tip \[m\].
    pub(crate) fn tip(&self) -> &Row {
        &self.values[self.len() - 1]
    }

    /// Corrects the position of the tip \[m\].
    pub(crate) fn set_tip(&mut self, value: &Row) {
        let last = self.len() - 1;
        self.values[last] = *value;
    }

    /// Rewrites every sample.
    pub(crate) fn for_each(&mut self, mut f: impl FnMut(f64, &mut Row)) {
        for (depth, value) in self.depths.iter().zip(&mut self.values) {
            f(*depth, value);
        }
    }

    /// Lateral position of the path at a depth \[m\].
    pub(crate) fn at(&self, depth: f64) -> Row {
        let last = self.len() - 2;
        let i = self
            .depths
            .partition_point(|&d| d <= depth)
            .saturating_sub(1)
            .min(last);
        let t = (depth - self.depths[i]) / (self.depths[i + 1] - self.depths[i]);
        let t = t.clamp(0.0, 1.0);
        core::array::from_fn(|c| self.values[i][c] * (1.0 - t) + self.values[i + 1][c] * t)
    }

    /// Cuts on in a straight line to `depth`, where the tip is then at `value`; marks that lie
    /// between are kept, the last one once the tip is away from it. A depth at or above the tip's
    /// only moves the tip sideways: a retracted needle keeps its hole.
    pub(crate) fn extend_to(&mut self, depth: f64, value: &Row) {
        let (start, tip) = (self.tip_depth(), *self.tip());
        if depth <= start {
            self.set_tip(value);
            return;
        }
        // The sample at the tip gives way to the marks that it has passed.
        self.depths.pop();
        self.values.pop();
        let before = self.len() - 1;
        let (mark, at_mark) = (self.depths[before], self.values[before]);
        let mut next = mark + self.spacing;
        while next < depth - LEAST_PIECE * self.spacing {
            let (from_depth, from, to_depth, to) = if next < start {
                (mark, &at_mark, start, &tip)
            } else {
                (start, &tip, depth, value)
            };
            let t = (next - from_depth) / (to_depth - from_depth);
            self.depths.push(next);
            self.values
                .push(core::array::from_fn(|c| from[c] * (1.0 - t) + to[c] * t));
            next += self.spacing;
        }
        self.depths.push(depth);
        self.values.push(*value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::rod::{Clamp, Rod, RodConstants};

    #[test]
    fn small_and_large_steps_lay_the_same_path() {
        let line = |d: f64| [2.0 * d, -d, 0.0, 0.0, 1.0 * d];
        let mut one = CutPath::new(2e-3);
        one.extend_to(13.3e-3, &line(13.3e-3));
        let mut many = CutPath::new(2e-3);
        for i in 1..=133 {
            let d = f64::from(i) * 1e-4;
            many.extend_to(d, &line(d));
        }
        assert_eq!(one.len(), many.len());
        for i in 0..one.len() {
            assert!((one.depth(i) - many.depth(i)).abs() < 2e-4);
            assert!((many.at(one.depth(i))[0] - 2.0 * one.depth(i)).abs() < 1e-9);
        }
    }

    /// A tip that stops anywhere about a mark: the rod on the path has the slope that it has
    /// elsewhere. With a piece of some nanometres between mark and tip it had any.
    #[test]
    fn a_tip_that_stops_about_a_mark_keeps_its_slope() {
        let (spacing, mark) = (2e-3, 16e-3);
        let bent = |d: f64| [2.0 * d * d, 0.0, 0.0, 0.0, 0.0];
        let slope = |beyond: f64| {
            let mut path = CutPath::new(spacing);
            for depth in [5e-3, 11e-3, mark, mark + beyond] {
                path.extend_to(depth, &bent(depth));
            }
            let clamp = Clamp {
                z: -0.11,
                w: [1e-3, 0.0, 0.0, 0.0, 0.0],
                slope: [0.0; COLUMNS],
            };
            let steel = RodConstants {
                bending: 1.836e-3,
                axial: 0.0,
                bed: 2e4,
            };
            let mut rod = Rod::default();
            rod.solve(&steel, &clamp, &path);
            rod.tip_slope()[0]
        };
        let there = slope(0.0);
        for beyond in [1e-12, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 3e-5, 1e-4] {
            let change = (slope(beyond) - there).abs();
            assert!(change < 1e-5 + 20.0 * beyond, "{beyond}: {change}");
        }
    }

    #[test]
    fn retraction_keeps_the_hole() {
        let mut path = CutPath::new(2e-3);
        path.extend_to(10e-3, &[1e-3; COLUMNS]);
        let before = path.len();
        path.extend_to(5e-3, &[1e-3; COLUMNS]);
        assert_eq!(path.len(), before);
    }
}
