//! Bordered block-tridiagonal systems: 5 unknowns a node, 2 global ones.
//!
//! ```text
//! | D1 C1          .  | | x1 |   | r1 |
//! | A2 D2 C2       .  | | x2 | = | r2 |      unsymmetric, factored once without pivoting between
//! |    .. .. ..    .  | | .. |   | .. |      blocks; O(N) in time, storage kept between calls
//! |       An Dn    Bn | | xn |   | rn |
//! | b1 b2 .. bn    E  | | z  |   | s  |
//! ```

/// Unknowns of a node: two in its spring's plane, three of the derivative.
pub(crate) const NODE: usize = 5;
/// Global unknowns: length of the tip segment, roll of the tip frame.
pub(crate) const BORDER: usize = 2;

/// Width of a stored row of a node's block: one spare column, always 0, so that rows are whole
/// vectors of two and loads match the stores before them.
pub(crate) const WIDE: usize = 6;

pub(crate) type Block<const R: usize, const C: usize> = [[f64; C]; R];
/// Block of a node's equations by a node's unknowns.
pub(crate) type Square = Block<NODE, WIDE>;

/// A pivot vanished or was not finite.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Singular;

#[derive(Debug, Clone, Copy)]
struct Row {
    upper: Square,
    inverse: Square,
    multiplier: Square,
    border: Block<BORDER, WIDE>,
}

impl Row {
    const EMPTY: Self = Self {
        upper: [[0.0; WIDE]; NODE],
        inverse: [[0.0; WIDE]; NODE],
        multiplier: [[0.0; WIDE]; NODE],
        border: [[0.0; WIDE]; BORDER],
    };
}

/// The factored system.
#[derive(Debug, Clone, Default)]
pub(crate) struct Bordered {
    /// Storage; the first `used` hold the system.
    rows: Vec<Row>,
    used: usize,
    border_column: Block<NODE, BORDER>,
    corner_inverse: Block<BORDER, BORDER>,
}

/// `c -= a b`, over the first K columns of `a`.
#[inline]
fn sub_mul<const R: usize, const A: usize, const K: usize, const C: usize>(
    c: &mut Block<R, C>,
    a: &Block<R, A>,
    b: &Block<K, C>,
) {
    for i in 0..R {
        let mut row = c[i];
        for k in 0..K {
            for j in 0..C {
                row[j] -= a[i][k] * b[k][j];
            }
        }
        c[i] = row;
    }
}

#[inline]
fn mul<const R: usize, const A: usize, const K: usize, const C: usize>(
    a: &Block<R, A>,
    b: &Block<K, C>,
) -> Block<R, C> {
    let mut c = [[0.0; C]; R];
    for i in 0..R {
        let mut row = [0.0; C];
        for k in 0..K {
            for j in 0..C {
                row[j] += a[i][k] * b[k][j];
            }
        }
        c[i] = row;
    }
    c
}

/// Inverse, from the 2x2 block of the positions and the 3x3 Schur complement of the derivatives. The
/// block is positive definite up to small unsymmetric terms, so no pivot need be searched.
#[inline]
fn invert(m: &Square, inverse: &mut Square) -> Result<(), Singular> {
    // | P Q |   P 2x2, S 3x3
    // | R S |
    let determinant = m[0][0] * m[1][1] - m[0][1] * m[1][0];
    if !(determinant.abs() > 1e-13 * (m[0][0] * m[1][1]).abs()) || !determinant.is_finite() {
        return Err(Singular);
    }
    let d = 1.0 / determinant;
    let p = [[m[1][1] * d, -m[0][1] * d], [-m[1][0] * d, m[0][0] * d]];
    let (mut pq, mut rp, mut s) = ([[0.0; 3]; 2], [[0.0; 2]; 3], [[0.0; 3]; 3]);
    for c in 0..3 {
        for r in 0..2 {
            pq[r][c] = p[r][0] * m[0][2 + c] + p[r][1] * m[1][2 + c];
            rp[c][r] = m[2 + c][0] * p[0][r] + m[2 + c][1] * p[1][r];
        }
    }
    for r in 0..3 {
        for c in 0..3 {
            s[r][c] = m[2 + r][2 + c] - m[2 + r][0] * pq[0][c] - m[2 + r][1] * pq[1][c];
        }
    }
    let cofactor = |r: usize, c: usize| {
        let ((r1, r2), (c1, c2)) = (((r + 1) % 3, (r + 2) % 3), ((c + 1) % 3, (c + 2) % 3));
        s[r1][c1] * s[r2][c2] - s[r1][c2] * s[r2][c1]
    };
    let cofactors = [
        [cofactor(0, 0), cofactor(0, 1), cofactor(0, 2)],
        [cofactor(1, 0), cofactor(1, 1), cofactor(1, 2)],
        [cofactor(2, 0), cofactor(2, 1), cofactor(2, 2)],
    ];
    let determinant =
        s[0][0] * cofactors[0][0] + s[0][1] * cofactors[0][1] + s[0][2] * cofactors[0][2];
    let size = (s[0][0] * s[1][1] * s[2][2]).abs();
    if !(determinant.abs() > 1e-13 * size) || !determinant.is_finite() {
        return Err(Singular);
    }
    let d = 1.0 / determinant;
    for r in 0..3 {
        for c in 0..3 {
            inverse[2 + r][2 + c] = cofactors[c][r] * d;
        }
    }
    for r in 0..3 {
        for c in 0..2 {
            inverse[2 + r][c] = -(inverse[2 + r][2] * rp[0][c]
                + inverse[2 + r][3] * rp[1][c]
                + inverse[2 + r][4] * rp[2][c]);
            inverse[c][2 + r] = -(pq[c][0] * inverse[2][2 + r]
                + pq[c][1] * inverse[3][2 + r]
                + pq[c][2] * inverse[4][2 + r]);
        }
    }
    for r in 0..2 {
        for c in 0..2 {
            inverse[r][c] = p[r][c]
                - inverse[r][2] * rp[0][c]
                - inverse[r][3] * rp[1][c]
                - inverse[r][4] * rp[2][c];
        }
    }
    Ok(())
}

impl Bordered {
    pub(crate) fn with_capacity(nodes: usize) -> Self {
        Self {
            rows: Vec::with_capacity(nodes),
            ..Self::default()
        }
    }

    fn rows(&self) -> &[Row] {
        &self.rows[..self.used]
    }

    pub(crate) fn clear(&mut self) {
        self.used = 0;
    }

    /// Appends and eliminates the next node: its row of blocks and its part of the border rows.
    /// `lower` of the first node is not used; `upper` of the last is not used.
    #[inline(never)]
    pub(crate) fn push(
        &mut self,
        lower: &Square,
        diagonal: &Square,
        upper: &Square,
        border: &Block<BORDER, WIDE>,
    ) -> Result<(), Singular> {
        if self.rows.len() <= self.used {
            self.rows.push(Row::EMPTY);
        }
        // Written in place: copies of whole rows cost more than the arithmetic.
        let (done, rest) = self.rows.split_at_mut(self.used);
        let row = &mut rest[0];
        row.upper = *upper;
        row.border = *border;
        let mut pivot = *diagonal;
        if let Some(before) = done.last() {
            row.multiplier = mul(lower, &before.inverse);
            sub_mul(&mut pivot, &row.multiplier, &before.upper);
            sub_mul(&mut row.border, &before.border, &before.upper);
        }
        invert(&pivot, &mut row.inverse)?;
        row.border = mul(&row.border, &row.inverse);
        self.used += 1;
        Ok(())
    }

    /// Closes the factorization with the border column of the last node and the corner.
    pub(crate) fn close(
        &mut self,
        border_column: &Block<NODE, BORDER>,
        corner: &Block<BORDER, BORDER>,
    ) -> Result<(), Singular> {
        let mut corner = *corner;
        if let Some(last) = self.rows().last() {
            sub_mul(&mut corner, &last.border, border_column);
        }
        let determinant = corner[0][0] * corner[1][1] - corner[0][1] * corner[1][0];
        if !(determinant.abs() > 1e-13) || !determinant.is_finite() {
            return Err(Singular);
        }
        self.corner_inverse = [
            [corner[1][1] / determinant, -corner[0][1] / determinant],
            [-corner[1][0] / determinant, corner[0][0] / determinant],
        ];
        self.border_column = *border_column;
        Ok(())
    }

    /// Forward elimination of right-hand sides, down to the border.
    #[inline]
    pub(crate) fn eliminate<const M: usize>(
        &self,
        rhs: &mut [Block<NODE, M>],
        border: &mut Block<BORDER, M>,
    ) {
        for i in 0..self.used {
            if i > 0 {
                let before = rhs[i - 1];
                sub_mul(&mut rhs[i], &self.rows[i].multiplier, &before);
            }
            sub_mul(border, &self.rows[i].border, &rhs[i]);
        }
    }

    /// The global unknowns, from an eliminated right-hand side.
    #[inline]
    pub(crate) fn border<const M: usize>(&self, border: &Block<BORDER, M>) -> Block<BORDER, M> {
        mul(&self.corner_inverse, border)
    }

    /// Unknowns of node `i` from its eliminated right-hand side and what follows it.
    #[inline]
    pub(crate) fn substitute<const M: usize>(
        &self,
        i: usize,
        eliminated: &Block<NODE, M>,
        next: Option<&Block<NODE, M>>,
        border: &Block<BORDER, M>,
    ) -> Block<NODE, M> {
        let mut rhs = *eliminated;
        match next {
            Some(next) => sub_mul(&mut rhs, &self.rows[i].upper, next),
            None => sub_mul(&mut rhs, &self.border_column, border),
        }
        mul(&self.rows[i].inverse, &rhs)
    }

    /// Solves in place.
    pub(crate) fn solve<const M: usize>(
        &self,
        rhs: &mut [Block<NODE, M>],
        border: &mut Block<BORDER, M>,
    ) {
        self.eliminate(rhs, border);
        *border = self.border(border);
        let mut next = None;
        for i in (0..self.used).rev() {
            rhs[i] = self.substitute(i, &rhs[i], next.as_ref(), border);
            next = Some(rhs[i]);
        }
    }

    /// Solves for the last node and the border alone, where only the `first` and `last` nodes'
    /// right-hand sides and the `border`'s are not zero: one pass down.
    #[inline]
    pub(crate) fn solve_ends<const M: usize>(
        &self,
        first: &Block<NODE, M>,
        last: &Block<NODE, M>,
        border: &Block<BORDER, M>,
    ) -> (Block<NODE, M>, Block<BORDER, M>) {
        let (mut rhs, mut border) = (*first, *border);
        for (i, row) in self.rows().iter().enumerate() {
            if i > 0 {
                let before = std::mem::replace(&mut rhs, [[0.0; M]; NODE]);
                sub_mul(&mut rhs, &row.multiplier, &before);
            }
            if i + 1 == self.used {
                for r in 0..NODE {
                    for c in 0..M {
                        rhs[r][c] += last[r][c];
                    }
                }
            }
            sub_mul(&mut border, &row.border, &rhs);
        }
        border = mul(&self.corner_inverse, &border);
        if let Some(i) = self.used.checked_sub(1) {
            rhs = self.substitute(i, &rhs, None, &border);
        }
        (rhs, border)
    }

    /// Solves the transposed system in place (row vectors `rhs`, `border` times the inverse).
    pub(crate) fn solve_transposed<const M: usize>(
        &self,
        rhs: &mut [Block<M, WIDE>],
        border: &mut Block<M, BORDER>,
    ) {
        // x^T (L U) = r^T: first y^T U = r^T going down, then x^T L = y^T going up.
        let n = self.used;
        for i in 0..n {
            if i > 0 {
                let before = rhs[i - 1];
                sub_mul(&mut rhs[i], &before, &self.rows[i - 1].upper);
            }
            rhs[i] = mul(&rhs[i], &self.rows[i].inverse);
        }
        if n > 0 {
            let last = rhs[n - 1];
            sub_mul(border, &last, &self.border_column);
        }
        *border = mul(border, &self.corner_inverse);
        for i in (0..n).rev() {
            // `border` of a row already holds (eliminated border row) x (pivot inverse).
            sub_mul(&mut rhs[i], border, &self.rows[i].border);
            if i + 1 < n {
                let next = rhs[i + 1];
                sub_mul(&mut rhs[i], &next, &self.rows[i + 1].multiplier);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    /// Pseudo-random, diagonally dominant system; returns it dense beside the factored form.
    fn random_system(n: usize) -> (Bordered, DMatrix<f64>) {
        let mut seed = 7_u64;
        let mut next = move || {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963);
            (seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let size = NODE * n + BORDER;
        let mut dense = DMatrix::zeros(size, size);
        let mut banded = Bordered::with_capacity(n);
        let mut square = |shift: f64| {
            let mut m = [[0.0; WIDE]; NODE];
            for (i, row) in m.iter_mut().enumerate() {
                for (j, v) in row.iter_mut().take(NODE).enumerate() {
                    *v = next() + if i == j { shift } else { 0.0 };
                }
            }
            m
        };
        let blocks: Vec<_> = (0..n)
            .map(|_| [square(0.0), square(8.0), square(0.0)])
            .collect();
        let borders: Vec<_> = (0..n).map(|_| square(0.0)).collect();
        let last = square(0.0);
        for i in 0..n {
            for r in 0..NODE {
                for c in 0..NODE {
                    if i > 0 {
                        dense[(NODE * i + r, NODE * (i - 1) + c)] = blocks[i][0][r][c];
                    }
                    dense[(NODE * i + r, NODE * i + c)] = blocks[i][1][r][c];
                    if i + 1 < n {
                        dense[(NODE * i + r, NODE * (i + 1) + c)] = blocks[i][2][r][c];
                    }
                }
            }
            let border = [borders[i][0], borders[i][1]];
            for r in 0..BORDER {
                for c in 0..NODE {
                    dense[(NODE * n + r, NODE * i + c)] = border[r][c];
                }
            }
            banded
                .push(&blocks[i][0], &blocks[i][1], &blocks[i][2], &border)
                .unwrap();
        }
        let mut column = [[0.0; BORDER]; NODE];
        for r in 0..NODE {
            for c in 0..BORDER {
                column[r][c] = last[r][c];
                if n > 0 {
                    dense[(NODE * (n - 1) + r, NODE * n + c)] = last[r][c];
                }
            }
        }
        let corner = [[3.0, 0.5], [-0.2, 2.0]];
        for r in 0..BORDER {
            for c in 0..BORDER {
                dense[(NODE * n + r, NODE * n + c)] = corner[r][c];
            }
        }
        banded.close(&column, &corner).unwrap();
        (banded, dense)
    }

    #[test]
    fn solves_like_the_dense_matrix() {
        for n in [0, 1, 2, 7] {
            let (banded, dense) = random_system(n);
            let x = DVector::from_fn(NODE * n + BORDER, |i, _| (i as f64 * 0.7).sin() + 0.1);
            for transposed in [false, true] {
                let r = if transposed {
                    dense.tr_mul(&x)
                } else {
                    &dense * &x
                };
                let solved: Vec<f64> = if transposed {
                    let mut rows: Vec<Block<1, WIDE>> = (0..n)
                        .map(|i| {
                            [std::array::from_fn(|c| {
                                if c < NODE { r[NODE * i + c] } else { 0.0 }
                            })]
                        })
                        .collect();
                    let mut border = [std::array::from_fn(|c| r[NODE * n + c])];
                    banded.solve_transposed(&mut rows, &mut border);
                    rows.iter()
                        .flat_map(|b| [b[0][0], b[0][1], b[0][2], b[0][3], b[0][4]])
                        .chain(border[0])
                        .collect()
                } else {
                    let mut rows: Vec<Block<NODE, 1>> = (0..n)
                        .map(|i| std::array::from_fn(|c| [r[NODE * i + c]]))
                        .collect();
                    let mut border = std::array::from_fn(|c| [r[NODE * n + c]]);
                    banded.solve(&mut rows, &mut border);
                    rows.iter()
                        .flatten()
                        .flatten()
                        .chain(border.iter().flatten())
                        .copied()
                        .collect()
                };
                // Condition number below 1e2: rounding only.
                let error = (DVector::from_vec(solved) - &x).amax();
                assert!(
                    error < 1e-13,
                    "{n} nodes, transposed {transposed}: {error:e}"
                );
            }
        }
    }

    #[test]
    fn a_singular_block_is_reported() {
        let zero = [[0.0; WIDE]; NODE];
        let mut banded = Bordered::default();
        assert_eq!(
            banded.push(&zero, &zero, &zero, &[[0.0; WIDE]; BORDER]),
            Err(Singular)
        );
    }
}
