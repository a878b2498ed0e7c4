//! A beam on a bed laid along a given path, condensed to its two ends: the linear core of the
//! predictive model.
//!
//! Cubic elements with consistent bed, load and axial-load terms. Growing the bed by an element
//! eliminates the former tip node, so a step costs the same at any depth. Both lateral directions
//! share the stiffness; each right-hand side is a column.

/// Columns carried: free path in both lateral directions, then the rates by pivot, shift and bevel.
pub(crate) const COLUMNS: usize = 5;

pub(crate) type Row = [f64; COLUMNS];

/// Stiffness and load of a beam seen from its ends (w, w' at the entry, w, w' at the tip).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Span {
    stiffness: [[f64; 4]; 4],
    load: [Row; 4],
}

/// Tip of the held beam: its slope and the force of the path on it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Held {
    pub slope: Row,
    pub reaction: Row,
}

impl Span {
    /// Element of length `h` \[m\] on a bed of stiffness `k` \[N/m2\] whose path goes from `c0` to
    /// `c1`, under the axial compression `p` \[N\].
    pub(crate) fn element(ei: f64, p: f64, k: f64, h: f64, c0: &Row, c1: &Row) -> Self {
        let (b, bed, axial) = (ei / (h * h * h), k * h / 420.0, p / (30.0 * h));
        let shape = |bend: f64, mass: f64, stress: f64, power: i32| {
            (b * bend + bed * mass - axial * stress) * h.powi(power)
        };
        let (ww, wt) = (shape(12.0, 156.0, 36.0, 0), shape(6.0, 22.0, 3.0, 1));
        let (wv, wu) = (shape(-12.0, 54.0, -36.0, 0), shape(6.0, -13.0, 3.0, 1));
        let (tt, tu) = (shape(4.0, 4.0, 4.0, 2), shape(2.0, -3.0, -1.0, 2));
        let stiffness = [
            [ww, wt, wv, wu],
            [wt, tt, -wu, tu],
            [wv, -wu, ww, -wt],
            [wu, tu, -wt, tt],
        ];
        let mut load = [[0.0; COLUMNS]; 4];
        for c in 0..COLUMNS {
            let (a, b) = (c0[c], c1[c]);
            load[0][c] = k * h * (7.0 * a + 3.0 * b) / 20.0;
            load[1][c] = k * h * h * (3.0 * a + 2.0 * b) / 60.0;
            load[2][c] = k * h * (3.0 * a + 7.0 * b) / 20.0;
            load[3][c] = -k * h * h * (2.0 * a + 3.0 * b) / 60.0;
        }
        Self { stiffness, load }
    }

    /// This span and then `next`, the node between them eliminated.
    pub(crate) fn join(&self, next: &Self) -> Self {
        let (a, b) = (&self.stiffness, &next.stiffness);
        let (m00, m01, m11) = (a[2][2] + b[0][0], a[2][3] + b[0][1], a[3][3] + b[1][1]);
        let determinant = m00 * m11 - m01 * m01;
        let inverse = [
            [m11 / determinant, -m01 / determinant],
            [-m01 / determinant, m00 / determinant],
        ];
        // Coupling of the four end unknowns to the middle ones.
        let couple = [
            [a[0][2], a[0][3]],
            [a[1][2], a[1][3]],
            [b[2][0], b[2][1]],
            [b[3][0], b[3][1]],
        ];
        let mut through = [[0.0; 2]; 4];
        for i in 0..4 {
            for j in 0..2 {
                through[i][j] = couple[i][0] * inverse[0][j] + couple[i][1] * inverse[1][j];
            }
        }
        let mut joined = Self {
            stiffness: [[0.0; 4]; 4],
            load: [[0.0; COLUMNS]; 4],
        };
        for i in 0..2 {
            for j in 0..2 {
                joined.stiffness[i][j] = a[i][j];
                joined.stiffness[i + 2][j + 2] = b[i + 2][j + 2];
            }
            joined.load[i] = self.load[i];
            joined.load[i + 2] = next.load[i + 2];
        }
        for i in 0..4 {
            for j in 0..4 {
                joined.stiffness[i][j] -=
                    through[i][0] * couple[j][0] + through[i][1] * couple[j][1];
            }
            for c in 0..COLUMNS {
                joined.load[i][c] -= through[i][0] * (self.load[2][c] + next.load[0][c])
                    + through[i][1] * (self.load[3][c] + next.load[1][c]);
            }
        }
        joined
    }

    /// The beam whose clamp stands at `base` (w, w') at the end of `free`, its tip held at `tip`;
    /// `None` when it buckles.
    pub(crate) fn hold(&self, free: &Clamp, base: &[Row; 2], tip: &Row) -> Option<Held> {
        let (f, s) = (&free.stiffness, &self.stiffness);
        // Unknown: w and w' at the entry, w' at the tip.
        let m = [
            [f[2][2] + s[0][0], f[2][3] + s[0][1], s[0][3]],
            [f[2][3] + s[0][1], f[3][3] + s[1][1], s[1][3]],
            [s[0][3], s[1][3], s[3][3]],
        ];
        // Cholesky-like elimination; a pivot that is not positive is a buckled beam.
        let p0 = m[0][0];
        let l10 = m[0][1] / p0;
        let l20 = m[0][2] / p0;
        let p1 = m[1][1] - l10 * m[0][1];
        let m12 = m[1][2] - l10 * m[0][2];
        let l21 = m12 / p1;
        let p2 = m[2][2] - l20 * m[0][2] - l21 * m12;
        if !(p0 > 0.0 && p1 > 0.0 && p2 > 0.0) {
            return None;
        }
        let (mut slope, mut reaction) = ([0.0; COLUMNS], [0.0; COLUMNS]);
        for c in 0..COLUMNS {
            let r0 =
                self.load[0][c] - f[2][0] * base[0][c] - f[2][1] * base[1][c] - s[0][2] * tip[c];
            let r1 =
                self.load[1][c] - f[3][0] * base[0][c] - f[3][1] * base[1][c] - s[1][2] * tip[c];
            let r2 = self.load[3][c] - s[3][2] * tip[c];
            let y1 = r1 - l10 * r0;
            let turn = (r2 - l20 * r0 - l21 * y1) / p2;
            let entry_turn = y1 / p1 - l21 * turn;
            let entry = r0 / p0 - l10 * entry_turn - l20 * turn;
            slope[c] = turn;
            reaction[c] =
                s[2][0] * entry + s[2][1] * entry_turn + s[2][2] * tip[c] + s[2][3] * turn
                    - self.load[2][c];
        }
        Some(Held { slope, reaction })
    }
}

/// Stiffness of the free part between holder and entry (w, w' at both ends), without load.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Clamp {
    stiffness: [[f64; 4]; 4],
}

impl Clamp {
    /// Free part of length `l` \[m\] under the compression `p` \[N\], exact; `None` beyond the load at
    /// which it would buckle between two clamps.
    pub(crate) fn new(ei: f64, p: f64, l: f64) -> Option<Self> {
        let k = (p / ei).sqrt() * l;
        // Below, the exact formulas cancel; the consistent element is then as exact.
        if k < 0.03 {
            let zero = [0.0; COLUMNS];
            return Some(Self {
                stiffness: Span::element(ei, p, 0.0, l, &zero, &zero).stiffness,
            });
        }
        let (sin, cos) = k.sin_cos();
        let denominator = 2.0 - 2.0 * cos - k * sin;
        if k >= std::f64::consts::TAU || !(denominator > 0.0) {
            return None;
        }
        let scale = ei / (l * l * l * denominator);
        let ww = scale * k * k * k * sin;
        let wt = scale * l * k * k * (1.0 - cos);
        let tt = scale * l * l * k * (sin - k * cos);
        let tu = scale * l * l * k * (k - sin);
        let stiffness = [
            [ww, wt, -ww, wt],
            [wt, tt, -wt, tu],
            [-ww, -wt, ww, -wt],
            [wt, tu, -wt, tt],
        ];
        Some(Self { stiffness })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joined_halves_are_the_whole_without_bed() {
        let zero = [0.0; COLUMNS];
        let half = Span::element(2.0, 0.0, 0.0, 0.5, &zero, &zero);
        let (joined, whole) = (
            half.join(&half),
            Span::element(2.0, 0.0, 0.0, 1.0, &zero, &zero),
        );
        for i in 0..4 {
            for j in 0..4 {
                assert!((joined.stiffness[i][j] - whole.stiffness[i][j]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn exact_compression_matches_many_elements() {
        let zero = [0.0; COLUMNS];
        let (ei, p, l) = (1.836e-3, 0.4, 0.12);
        let mut span = Span::element(ei, p, 0.0, l / 64.0, &zero, &zero);
        for _ in 0..6 {
            span = span.join(&span);
        }
        let exact = Clamp::new(ei, p, l).unwrap();
        for i in 0..4 {
            for j in 0..4 {
                // Element error (k h)^4 / 720 with k h = 0.03.
                let gap = (span.stiffness[i][j] - exact.stiffness[i][j]).abs();
                assert!(gap < 1e-8 * exact.stiffness[0][0].abs(), "{i} {j}: {gap:e}");
            }
        }
        assert!(Clamp::new(ei, 40.0 * ei / (l * l), l).is_none());
        let (small, none) = (
            Clamp::new(ei, 1e-3 * ei / (l * l), l),
            Clamp::new(ei, 0.0, l),
        );
        let gap = small.unwrap().stiffness[0][0] - none.unwrap().stiffness[0][0];
        // -6/5 P / l to first order.
        assert!((gap / (-1.2e-3 * ei / l.powi(3)) - 1.0).abs() < 1e-3);
    }
}
