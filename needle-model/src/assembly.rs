//! The Newton tangent and residual of the needle's equations, node by node into the block-tridiagonal
//! system.

use nalgebra::Vector3;

use crate::block::{Block, Singular, Square, WIDE};
use crate::equilibrium::Equilibrium;
use crate::piece::{Node, Piece};

impl Equilibrium {
    /// Factors the tangent at the present state, leaving minus the residual in `rhs`.
    ///
    /// `frozen` planes and lengths make the tangent that of the fixed-point step.
    #[expect(
        clippy::too_many_lines,
        reason = "one pass over the nodes, in the equations' order"
    )]
    pub(crate) fn linearize(&mut self, frozen: bool) -> Result<Block<2, 1>, Singular> {
        self.factored_within = 0.0;
        let n = self.springs.len();
        let (z, x) = (self.nodes[0].d, self.nodes[0].e[0]);
        for (node, spring) in self.nodes[1..].iter_mut().zip(&self.springs) {
            node.refresh(&z, &x, &spring.rest);
            if frozen {
                node.w = Vector3::zeros();
            }
        }
        self.settle_tip();
        self.pieces.resize(n, Piece::default());
        self.system.clear();
        self.rhs.clear();

        let tip = &self.tip;
        let load = self.load;
        // Residuals of total length and roll, with the pieces' own corrections.
        let mut length = tip.arc - self.needle.length();
        let mut roll = tip.roll - self.theta;
        for i in 1..=n {
            let piece = &mut self.pieces[i - 1];
            piece.set(
                self.stiffness,
                &self.nodes[i - 1],
                &self.nodes[i],
                &z,
                i == 1,
            );
            if frozen {
                piece.freeze();
            }
            length += self.nodes[i].l + piece.slack;
            roll += piece.roll + piece.roll_l * piece.slack;
        }
        for i in 1..=n {
            let (node, piece) = (&self.nodes[i], &self.pieces[i - 1]);
            let after = self.pieces.get(i);
            let spring = &self.springs[i - 1];

            let mut force = piece.shear
                + piece.shear_l * piece.slack
                + (node.p - spring.rest) * spring.stiffness;
            let mut moment = piece.end + piece.end_l * piece.slack;
            let mut by_p = piece.l_by[0];
            let mut by_d = piece.l_by[2];
            let mut roll_p = piece.roll_by[0];
            let mut roll_d = piece.roll_by[2];

            let mut diagonal = coupling(
                node,
                node,
                piece.alpha,
                -piece.beta,
                -piece.beta,
                piece.gamma,
            );
            add_outer(
                &mut diagonal,
                &node.project(&piece.shear_l, &piece.end_l),
                &node.reduce(&piece.l_by[0], &piece.l_by[2]),
            );
            let mut lower = [[0.0; WIDE]; 5];
            if i > 1 {
                let before = &self.nodes[i - 1];
                lower = coupling(
                    node,
                    before,
                    -piece.alpha,
                    -piece.beta,
                    piece.beta,
                    piece.gamma / 2.0,
                );
                add_outer(
                    &mut lower,
                    &node.project(&piece.shear_l, &piece.end_l),
                    &before.reduce(&-piece.l_by[0], &piece.l_by[1]),
                );
            }
            let mut upper = [[0.0; WIDE]; 5];
            if let Some(after) = after {
                force -= after.shear + after.shear_l * after.slack;
                moment += after.start + after.start_l * after.slack;
                by_p -= after.l_by[0];
                by_d += after.l_by[1];
                roll_p -= after.roll_by[0];
                roll_d += after.roll_by[1];
                let own = coupling(node, node, after.alpha, after.beta, after.beta, after.gamma);
                let rows = node.project(&-after.shear_l, &after.start_l);
                add(&mut diagonal, &own);
                add_outer(
                    &mut diagonal,
                    &rows,
                    &node.reduce(&-after.l_by[0], &after.l_by[1]),
                );
                let next = &self.nodes[i + 1];
                upper = coupling(
                    node,
                    next,
                    -after.alpha,
                    after.beta,
                    -after.beta,
                    after.gamma / 2.0,
                );
                add_outer(
                    &mut upper,
                    &rows,
                    &next.reduce(&after.l_by[0], &after.l_by[2]),
                );
            } else {
                // The tip's piece: its load is carried by the last node.
                force -= tip.y * load.force;
                moment -= tip.y * tip.moment;
                for r in 0..2 {
                    let row = node.e[r].transpose() * tip.y_d * load.force;
                    for c in 0..3 {
                        diagonal[r][2 + c] -= row[c];
                    }
                }
                for r in 0..3 {
                    for c in 0..3 {
                        diagonal[2 + r][2 + c] -= tip.moment * tip.y_d[(r, c)];
                    }
                }
                by_d += tip.arc_d + tip.y_d.tr_mul(&tip.arc_y);
                roll_d += tip.roll_d + tip.y_d.tr_mul(&tip.roll_y);
            }
            diagonal[0][0] += spring.stiffness;
            diagonal[1][1] += spring.stiffness;
            // The plane turns with the needle: its reaction tilts into the balance.
            let reaction = if frozen {
                0.0
            } else {
                node.n.dot(&force) / node.d.norm()
            };
            for r in 0..2 {
                for c in 0..3 {
                    diagonal[r][2 + c] -= reaction * node.e[r][c];
                }
            }
            let border = [node.reduce(&by_p, &by_d), node.reduce(&roll_p, &roll_d)];
            self.system.push(&lower, &diagonal, &upper, &border)?;
            self.rhs.push(node.project(&force, &moment).map(|v| [-v]));
        }
        let mut column = [[0.0; 2]; 5];
        if n > 0 {
            let node = &self.nodes[n];
            let by_l = node.project(
                &(tip.y_l * -load.force),
                &(tip.y_l * -tip.moment - tip.y * load.force),
            );
            let by_theta = node.project(&(tip.y_theta * -load.force), &(tip.y_theta * -tip.moment));
            column = std::array::from_fn(|r| [by_l[r], by_theta[r]]);
        }
        let corner = [
            [
                tip.arc_l + tip.arc_y.dot(&tip.y_l),
                tip.arc_y.dot(&tip.y_theta),
            ],
            [
                tip.roll_l + tip.roll_y.dot(&tip.y_l),
                tip.roll_y.dot(&tip.y_theta) - 1.0,
            ],
        ];
        self.system.close(&column, &corner)?;
        Ok([[-length], [-roll]])
    }
}

/// Block between equations of `row` and unknowns of `column` for coefficients times the identity:
/// force by position, force by derivative, moment by position, moment by derivative.
#[inline]
fn coupling(row: &Node, column: &Node, pp: f64, pd: f64, dp: f64, dd: f64) -> Square {
    let mut m = [[0.0; WIDE]; 5];
    for r in 0..2 {
        let (e, slip) = (&row.e[r], pp * row.e[r].dot(&column.n));
        m[r][0] = pp * e.dot(&column.e[0]);
        m[r][1] = pp * e.dot(&column.e[1]);
        for c in 0..3 {
            m[r][2 + c] = pd * e[c] - slip * column.w[c];
        }
    }
    for r in 0..3 {
        m[2 + r][0] = dp * column.e[0][r];
        m[2 + r][1] = dp * column.e[1][r];
        for c in 0..3 {
            m[2 + r][2 + c] = -dp * column.n[r] * column.w[c];
        }
        m[2 + r][2 + r] += dd;
    }
    m
}

#[inline]
fn add(m: &mut Square, other: &Square) {
    for r in 0..5 {
        for c in 0..WIDE {
            m[r][c] += other[r][c];
        }
    }
}

#[inline]
fn add_outer(m: &mut Square, rows: &[f64; 5], columns: &[f64; WIDE]) {
    for r in 0..5 {
        for c in 0..WIDE {
            m[r][c] += rows[r] * columns[c];
        }
    }
}
