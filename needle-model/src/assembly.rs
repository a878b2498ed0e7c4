//! The Newton tangent and residual of the needle's equations, node by node into the block-tridiagonal
//! system.

use nalgebra::Vector3;

use crate::block::{Block, Singular, Square, WIDE};
use crate::equilibrium::Equilibrium;
use crate::piece::{Node, Piece};

impl Equilibrium {
    /// Factors the tangent at the present, settled state, leaving minus the residual in `rhs`.
    ///
    /// `frozen` planes and lengths make the tangent that of the fixed-point step.
    #[expect(
        clippy::too_many_lines,
        reason = "one pass over the nodes, in the equations' order"
    )]
    pub(crate) fn linearize(&mut self, frozen: bool) -> Result<Block<2, 1>, Singular> {
        self.factored = false;
        let n = self.springs.len();
        let z = self.nodes[0].d;
        self.pieces.resize(n, Piece::default());
        self.system.clear();
        self.rhs.clear();

        let input = self.tip_input();
        self.tip
            .differentiate(&input, &self.nodes[n].d, self.tip_length);
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

            // alpha, beta and gamma of the pieces before and after, in the node's own block.
            let mut own = [piece.alpha, -piece.beta, piece.gamma];
            let mut diagonal = [[0.0; WIDE]; 5];
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
                own[0] += after.alpha;
                own[1] += after.beta;
                own[2] += after.gamma;
                let rows = node.project(&-after.shear_l, &after.start_l);
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
            own[0] += spring.stiffness;
            // The plane turns with the needle: its reaction tilts into the balance.
            let reaction = if frozen {
                0.0
            } else {
                node.n.dot(&force) / node.d.norm()
            };
            add_own(&mut diagonal, node, own, reaction);
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
        self.factored = !frozen;
        self.searches = 0;
        self.factored_within = 0.0;
        Ok([[-length], [-roll]])
    }

    /// Leaves minus the residual at the present, settled state in `rhs`, for the tangent factored
    /// before: the pieces keep their gradients.
    pub(crate) fn residual(&mut self) -> Block<2, 1> {
        let (n, tip, load) = (self.springs.len(), &self.tip, self.load);
        let z = self.nodes[0].d;
        let mut length = tip.arc - self.needle.length();
        let mut roll = tip.roll - self.theta;
        self.rhs.clear();
        let mut carried = (Vector3::zeros(), Vector3::zeros());
        for i in 1..=n {
            let (a, b) = (&self.nodes[i - 1], &self.nodes[i]);
            let (piece, spring) = (&mut self.pieces[i - 1], &self.springs[i - 1]);
            piece.renew(self.stiffness, a, b, &z, i == 1);
            length += b.l + piece.slack;
            roll += piece.roll + piece.roll_l * piece.slack;
            let shear = piece.shear + piece.shear_l * piece.slack;
            if i > 1 {
                let start = piece.start + piece.start_l * piece.slack;
                let row = a.project(&(carried.0 - shear), &(carried.1 + start));
                self.rhs.push(row.map(|v| [-v]));
            }
            carried = (
                shear + (b.p - spring.rest) * spring.stiffness,
                piece.end + piece.end_l * piece.slack,
            );
        }
        if n > 0 {
            let force = carried.0 - tip.y * load.force;
            let moment = carried.1 - tip.y * tip.moment;
            self.rhs
                .push(self.nodes[n].project(&force, &moment).map(|v| [-v]));
        }
        [[-length], [-roll]]
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

/// Adds the block of a node by itself: as `coupling`, where plane and normal are orthogonal; the
/// plane's `reaction` tilts with the derivative.
#[inline]
fn add_own(m: &mut Square, node: &Node, [pp, pd, dd]: [f64; 3], reaction: f64) {
    let tilt = pd - reaction;
    for r in 0..2 {
        m[r][r] += pp;
        for c in 0..3 {
            m[r][2 + c] += tilt * node.e[r][c];
        }
    }
    for r in 0..3 {
        let slide = pd * node.n[r];
        m[2 + r][0] += pd * node.e[0][r];
        m[2 + r][1] += pd * node.e[1][r];
        for c in 0..3 {
            m[2 + r][2 + c] -= slide * node.w[c];
        }
        m[2 + r][2 + r] += dd;
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
