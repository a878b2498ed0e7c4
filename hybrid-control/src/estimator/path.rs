//! The cut path: where the tip has been, at marks of constant spacing and at the tip.

use crate::estimator::rod::{COLUMNS, Row};

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
    /// between are kept. A depth at or above the tip's only moves the tip sideways: a retracted
    /// needle keeps its hole.
    pub(crate) fn extend_to(&mut self, depth: f64, value: &Row) {
        let (start, from) = (self.tip_depth(), *self.tip());
        if depth <= start {
            self.set_tip(value);
            return;
        }
        let before = self.len() - 2;
        // The sample at the tip is kept as a mark only where it is one.
        let mut next = self.depths[before] + self.spacing;
        if start < next - 1e-7 {
            self.depths.pop();
            self.values.pop();
        } else {
            next = start + self.spacing;
        }
        while next < depth - 1e-6 {
            let t = (next - start) / (depth - start);
            self.depths.push(next);
            self.values
                .push(core::array::from_fn(|c| from[c] * (1.0 - t) + value[c] * t));
            next += self.spacing;
        }
        self.depths.push(depth);
        self.values.push(*value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn retraction_keeps_the_hole() {
        let mut path = CutPath::new(2e-3);
        path.extend_to(10e-3, &[1e-3; COLUMNS]);
        let before = path.len();
        path.extend_to(5e-3, &[1e-3; COLUMNS]);
        assert_eq!(path.len(), before);
    }
}
