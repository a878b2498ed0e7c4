//! The rod that the predictions stand on: two lateral planes of small slope, a bed along the cut
//! path, axial load, the tip held on its path. One factorisation serves several load columns.

use crate::estimator::path::CutPath;

/// Load columns solved together.
pub(crate) const COLUMNS: usize = 5;

/// One number for each column.
pub(crate) type Row = [f64; COLUMNS];

/// Elements of the free length outside the tissue.
const FREE_ELEMENTS: usize = 3;

/// Unknowns coupled to the right of the diagonal, and the diagonal.
const BAND: usize = 4;

/// What stays constant during an insertion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RodConstants {
    /// Bending stiffness \[N m2\].
    pub bending: f64,
    /// Axial load \[N\], positive in compression.
    pub axial: f64,
    /// Stiffness of the bed per length \[N/m2\].
    pub bed: f64,
}

impl RodConstants {
    /// Lateral force on the tip that bends the needle as much as one radian of cut angle does,
    /// 2 E I / lambda^2 \[N/rad\].
    pub(crate) fn force_of_angle(&self) -> f64 {
        (self.bending * self.bed).sqrt()
    }
}

/// Base of one solve: height over the surface is `-z`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Clamp {
    /// Position along the insertion axis, negative outside the tissue \[m\].
    pub z: f64,
    /// Lateral position of each column \[m\].
    pub w: Row,
    /// Slope of each column.
    pub slope: Row,
}

/// Workspace and last solution.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rod {
    z: Vec<f64>,
    band: Vec<[f64; BAND]>,
    x: Vec<Row>,
    first_in_tissue: usize,
    reaction: Row,
}

impl Rod {
    /// Equilibrium for a clamp and a path that ends at the tip.
    pub(crate) fn solve(&mut self, constants: &RodConstants, clamp: &Clamp, path: &CutPath) {
        self.place_nodes(clamp, path);
        let nodes = self.z.len();
        self.band.clear();
        self.band.resize(2 * nodes, [0.0; BAND]);
        self.x.clear();
        self.x.resize(2 * nodes, [0.0; COLUMNS]);
        self.assemble(constants, path);
        let tip = 2 * nodes - 2;
        // The tip's own equation, kept for its reaction.
        let row = [
            self.band[tip - 2][2],
            self.band[tip - 1][1],
            self.band[tip][0],
            self.band[tip][1],
        ];
        let load = self.x[tip];
        self.hold(tip, path.tip());
        self.hold(0, &clamp.w);
        self.hold(1, &clamp.slope);
        self.factorise_and_solve();
        for c in 0..COLUMNS {
            self.reaction[c] = row[0] * self.x[tip - 2][c]
                + row[1] * self.x[tip - 1][c]
                + row[2] * self.x[tip][c]
                + row[3] * self.x[tip + 1][c]
                - load[c];
        }
    }

    /// Slope at the tip.
    pub(crate) fn tip_slope(&self) -> Row {
        self.x.last().copied().unwrap_or_default()
    }

    /// Force of the path on the tip \[N\].
    pub(crate) fn reaction(&self) -> Row {
        self.reaction
    }

    /// Lateral position at the entry \[m\].
    pub(crate) fn entry(&self) -> Row {
        self.x
            .get(2 * self.first_in_tissue)
            .copied()
            .unwrap_or_default()
    }

    /// Lateral position at `z` \[m\], by the elements' cubics; the ends are held constant.
    pub(crate) fn lateral(&self, z: f64) -> Row {
        let Some(last) = self.z.len().checked_sub(2) else {
            return Row::default();
        };
        let e = self
            .z
            .partition_point(|&node| node <= z)
            .saturating_sub(1)
            .min(last);
        let h = self.z[e + 1] - self.z[e];
        let t = ((z - self.z[e]) / h).clamp(0.0, 1.0);
        let (t2, t3) = (t * t, t * t * t);
        let n = [
            1.0 - 3.0 * t2 + 2.0 * t3,
            h * (t - 2.0 * t2 + t3),
            3.0 * t2 - 2.0 * t3,
            h * (t3 - t2),
        ];
        core::array::from_fn(|c| (0..4).map(|a| n[a] * self.x[2 * e + a][c]).sum())
    }

    /// Length of the rod lost along z by the slopes of columns `x` and `y` \[m\].
    pub(crate) fn shortening(&self, x: usize, y: usize) -> f64 {
        let square = |i: usize| {
            let s = self.x[2 * i + 1];
            s[x] * s[x] + s[y] * s[y]
        };
        (1..self.z.len())
            .map(|i| 0.25 * (self.z[i] - self.z[i - 1]) * (square(i) + square(i - 1)))
            .sum()
    }

    /// Mean distance of rod and path inside the tissue for columns `x` and `y` \[m\].
    pub(crate) fn mean_stretch(&self, path: &CutPath, x: usize, y: usize) -> f64 {
        let start = self.first_in_tissue;
        let count = self.z.len() - start;
        let total: f64 = (0..count)
            .map(|i| {
                let (w, c) = (self.x[2 * (start + i)], path.value(i));
                (w[x] - c[x]).hypot(w[y] - c[y])
            })
            .sum();
        total / count.max(1) as f64
    }

    /// Multiple of column `by` that takes the most squared distance out of column `of`, inside
    /// the tissue.
    pub(crate) fn relief(&self, path: &CutPath, of: usize, by: usize) -> f64 {
        let start = self.first_in_tissue;
        let (mut product, mut square) = (0.0, 0.0);
        for i in 0..self.z.len() - start {
            let (w, c) = (self.x[2 * (start + i)], path.value(i));
            let effect = w[by] - c[by];
            product += effect * (w[of] - c[of]);
            square += effect * effect;
        }
        if square > 1e-3 {
            -product / square
        } else {
            0.0
        }
    }

    fn place_nodes(&mut self, clamp: &Clamp, path: &CutPath) {
        self.z.clear();
        let free = (-clamp.z).max(1e-4);
        for i in 0..FREE_ELEMENTS {
            self.z.push(-free * (1.0 - i as f64 / FREE_ELEMENTS as f64));
        }
        self.first_in_tissue = FREE_ELEMENTS;
        for i in 0..path.len() {
            self.z.push(path.depth(i));
        }
    }

    fn assemble(&mut self, constants: &RodConstants, path: &CutPath) {
        for e in 0..self.z.len() - 1 {
            let h = self.z[e + 1] - self.z[e];
            let (h2, i) = (h * h, 2 * e);
            let b = constants.bending / (h2 * h);
            let p = constants.axial / (30.0 * h);
            let in_tissue = e >= self.first_in_tissue;
            let m = if in_tissue {
                constants.bed * h / 420.0
            } else {
                0.0
            };
            let band = &mut self.band;
            band[i][0] += 12.0 * b - 36.0 * p + 156.0 * m;
            band[i][1] += (6.0 * b - 3.0 * p + 22.0 * m) * h;
            band[i][2] += -12.0 * b + 36.0 * p + 54.0 * m;
            band[i][3] += (6.0 * b - 3.0 * p - 13.0 * m) * h;
            band[i + 1][0] += (4.0 * b - 4.0 * p + 4.0 * m) * h2;
            band[i + 1][1] += (-6.0 * b + 3.0 * p + 13.0 * m) * h;
            band[i + 1][2] += (2.0 * b + p - 3.0 * m) * h2;
            band[i + 2][0] += 12.0 * b - 36.0 * p + 156.0 * m;
            band[i + 2][1] += (-6.0 * b + 3.0 * p - 22.0 * m) * h;
            band[i + 3][0] += (4.0 * b - 4.0 * p + 4.0 * m) * h2;
            if in_tissue {
                let k = constants.bed * h / 60.0;
                let at = e - self.first_in_tissue;
                let (near, far) = (path.value(at), path.value(at + 1));
                for c in 0..COLUMNS {
                    let (n, f) = (near[c], far[c]);
                    self.x[i][c] += k * (21.0 * n + 9.0 * f);
                    self.x[i + 1][c] += k * h * (3.0 * n + 2.0 * f);
                    self.x[i + 2][c] += k * (9.0 * n + 21.0 * f);
                    self.x[i + 3][c] -= k * h * (2.0 * n + 3.0 * f);
                }
            }
        }
    }

    /// Prescribes unknown `i` in every column.
    fn hold(&mut self, i: usize, value: &Row) {
        for j in 1..BAND {
            if i + j < self.band.len() {
                let k = core::mem::take(&mut self.band[i][j]);
                for c in 0..COLUMNS {
                    self.x[i + j][c] -= k * value[c];
                }
            }
            if i >= j {
                let k = core::mem::take(&mut self.band[i - j][j]);
                for c in 0..COLUMNS {
                    self.x[i - j][c] -= k * value[c];
                }
            }
        }
        self.band[i][0] = 1.0;
        self.x[i] = *value;
    }

    fn factorise_and_solve(&mut self) {
        let n = self.band.len();
        for i in 0..n {
            let pivot = 1.0 / self.band[i][0];
            for j in 1..BAND.min(n - i) {
                let l = self.band[i][j] * pivot;
                for m in j..BAND {
                    self.band[i + j][m - j] -= l * self.band[i][m];
                }
                for c in 0..COLUMNS {
                    self.x[i + j][c] -= l * self.x[i][c];
                }
            }
        }
        for i in (0..n).rev() {
            for j in 1..BAND.min(n - i) {
                let k = self.band[i][j];
                for c in 0..COLUMNS {
                    self.x[i][c] -= k * self.x[i + j][c];
                }
            }
            let pivot = 1.0 / self.band[i][0];
            for c in 0..COLUMNS {
                self.x[i][c] *= pivot;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEEL: RodConstants = RodConstants {
        bending: 1.836e-3,
        axial: 0.0,
        bed: 1e4,
    };

    /// Tip slope per unit shift, per unit tilt and per unit pivot with a straight path.
    fn authority(bed: f64, depth: f64) -> [f64; 3] {
        let mut path = CutPath::new(1e-3);
        path.extend_to(depth, &[0.0; COLUMNS]);
        let z = depth - 0.126;
        let clamp = Clamp {
            z,
            w: [1.0, 0.0, z, 0.0, 0.0],
            slope: [0.0, 1.0, 1.0, 0.0, 0.0],
        };
        let mut rod = Rod::default();
        rod.solve(&RodConstants { bed, ..STEEL }, &clamp, &path);
        let s = rod.tip_slope();
        [s[0], s[1], s[2]]
    }

    /// Depth at which one of the authorities changes sign \[mm\].
    fn zero_of(bed: f64, which: usize) -> f64 {
        let mut depth = 15e-3;
        let sign = authority(bed, depth)[which].signum();
        while authority(bed, depth)[which] * sign > 0.0 && depth < 0.12 {
            depth += 0.1e-3;
        }
        depth * 1e3
    }

    /// The depths at which the authority over the tip's slope vanishes, as an independent study
    /// of the same rod found them (126 mm free length, uniform stiffness, no axial load).
    #[test]
    fn authority_vanishes_where_the_study_says() {
        for (bed, shift, pivot) in [
            (5e3, 76.0, 61.0),
            (1e4, 58.0, 51.0),
            (2e4, 46.0, 43.0),
            (5e4, 35.0, 33.0),
        ] {
            assert!(
                (zero_of(bed, 0) - shift).abs() < 1.0,
                "shift {bed}: {}",
                zero_of(bed, 0)
            );
            assert!(
                (zero_of(bed, 2) - pivot).abs() < 1.0,
                "pivot {bed}: {}",
                zero_of(bed, 2)
            );
        }
        assert!((zero_of(2e4, 1) - 52.0).abs() < 1.0);
    }

    /// Outside the tissue with its tip held the rod is a propped cantilever.
    #[test]
    fn held_tip_reacts_as_a_propped_cantilever() {
        let mut path = CutPath::new(1e-3);
        path.extend_to(1e-3, &[1e-3, 0.0, 0.0, 0.0, 0.0]);
        let clamp = Clamp {
            z: -0.125,
            w: [0.0; COLUMNS],
            slope: [0.0; COLUMNS],
        };
        let mut rod = Rod::default();
        rod.solve(&RodConstants { bed: 1e-9, ..STEEL }, &clamp, &path);
        let exact = 3.0 * STEEL.bending * 1e-3 / 0.126_f64.powi(3);
        assert!((rod.reaction()[0] / exact - 1.0).abs() < 1e-6);
        assert!((rod.tip_slope()[0] - 1.5e-3 / 0.126).abs() < 1e-8);
    }
}
