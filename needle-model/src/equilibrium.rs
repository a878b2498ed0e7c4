//! Equilibrium of the needle on its springs (section II.C), O(N) a Newton step.
//!
//! Unknowns: at each spring's node two coordinates in the spring's plane and the derivative (three),
//! then the length of the tip's piece and the roll of the tip frame. Equations: the force balance
//! in each plane, moment continuity, plane normal = tangent, arc length of each piece = its
//! parametric length, total arc length = the needle's, load along `y_tip`. The Newton tangent is
//! exact, so at convergence it also gives every derivative (module `jacobian`).

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use thiserror::Error;

use crate::block::{Block, Bordered, Singular, Square, WIDE};
use crate::needle::Needle;
use crate::piece::{Node, Piece, TipInput, TipLoad, TipPiece};
use crate::segment::Segment;
use crate::spring::Spring;

/// Newton steps before giving up.
const MAX_ITERATIONS: usize = 60;
/// Fixed-point steps before Newton's method on a cold start.
const RELAXATIONS: usize = 3;
/// Largest change of a derivative in one step.
const MAX_TURN: f64 = 0.5;
/// Arm that turns a change of slope into a length, for the tolerance \[m\].
const SLOPE_ARM: f64 = 0.01;

/// Why there is no equilibrium.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum EquilibriumError {
    /// The base pose has a coordinate that is not finite.
    #[error("the base pose is not finite")]
    BasePose,
    /// The tip load is not finite.
    #[error("the tip load is not finite: force {force_n} N, moment {moment_nm} N m")]
    TipLoad {
        /// Force \[N\].
        force_n: f64,
        /// End moment \[N m\].
        moment_nm: f64,
    },
    /// A rest point has a coordinate that is not finite.
    #[error("spring {index}: the rest point is not finite")]
    RestPoint {
        /// Offending spring, from 0 at the surface.
        index: usize,
    },
    /// A stiffness that is not finite and positive (0 is accepted for a newborn spring).
    #[error(
        "spring {index}: stiffness must be finite and not negative, got {stiffness_n_per_m} N/m"
    )]
    Stiffness {
        /// Offending spring.
        index: usize,
        /// Offending stiffness \[N/m\].
        stiffness_n_per_m: f64,
    },
    /// A rest point not in front of the base.
    #[error("spring {index} lies {ahead_m} m ahead of the base along its axis: behind the base")]
    BehindBase {
        /// Offending spring.
        index: usize,
        /// Distance along the base axis \[m\].
        ahead_m: f64,
    },
    /// Rest points not in order from the base to the tip.
    #[error(
        "spring {index} is out of order: {ahead_m} m ahead of the one before along the base axis"
    )]
    Order {
        /// Offending spring.
        index: usize,
        /// Distance along the base axis \[m\].
        ahead_m: f64,
    },
    /// The needle does not reach its last spring.
    #[error("the needle is too short: {needed_m} m to its last spring, length {length_m} m")]
    TooShort {
        /// Arc length up to the last spring \[m\].
        needed_m: f64,
        /// Needle length \[m\].
        length_m: f64,
    },
    /// Newton's method did not reach the tolerance.
    #[error("no equilibrium after {iterations} iterations (last step {last_step_m} m)")]
    NotConverged {
        /// Iterations done.
        iterations: usize,
        /// Last step \[m\].
        last_step_m: f64,
    },
    /// The tangent is singular: the needle buckles or folds back.
    #[error("the needle is unstable: singular tangent at iteration {iteration}")]
    Unstable {
        /// Iteration at which it happened.
        iteration: usize,
    },
}

/// How an equilibrium was reached.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Convergence {
    /// Newton steps.
    pub iterations: usize,
    /// Length of the last step \[m\]: the largest move of a node (or turn times 10 mm). Newton
    /// converges quadratically, so the state is far closer than this to the equilibrium.
    pub residual: f64,
}

/// The needle in equilibrium; also the workspace of the solver, kept between calls.
#[derive(Debug, Clone)]
pub struct Equilibrium {
    pub(crate) needle: Needle,
    pub(crate) stiffness: f64,
    pub(crate) base: Isometry3<f64>,
    pub(crate) load: TipLoad,
    pub(crate) springs: Vec<Spring>,
    /// The base, then one node a spring.
    pub(crate) nodes: Vec<Node>,
    pub(crate) tip_length: f64,
    pub(crate) theta: f64,
    pub(crate) tip: TipPiece,
    pub(crate) pieces: Vec<Piece>,
    pub(crate) system: Bordered,
    rhs: Vec<Block<5, 1>>,
    tolerance: f64,
    convergence: Convergence,
    /// Length of the last step when `system` was factored within it of the present state.
    factored_within: f64,
}

impl Equilibrium {
    /// Default tolerance on the last step \[m\].
    pub const TOLERANCE: f64 = 1e-9;

    /// A straight needle at `world_from_base` (the shaft is +z of the base), without springs.
    pub fn new(needle: Needle, world_from_base: Isometry3<f64>) -> Self {
        let z = world_from_base * Vector3::z();
        let y = world_from_base * Vector3::y();
        let stiffness = needle.bending_stiffness();
        let load = TipLoad::default();
        let input = TipInput {
            stiffness,
            load,
            z,
            y,
        };
        let base = Node {
            p: world_from_base.translation.vector,
            d: z,
            l: 0.0,
            n: z,
            e: [world_from_base * Vector3::x(), y],
            w: Vector3::zeros(),
        };
        Self {
            needle,
            stiffness,
            base: world_from_base,
            load,
            springs: Vec::with_capacity(64),
            nodes: {
                let mut nodes = Vec::with_capacity(65);
                nodes.push(base);
                nodes
            },
            tip_length: needle.length(),
            theta: 0.0,
            tip: TipPiece::new(&input, &z, needle.length(), 0.0, y),
            pieces: Vec::with_capacity(64),
            system: Bordered::with_capacity(64),
            rhs: Vec::with_capacity(64),
            tolerance: Self::TOLERANCE,
            convergence: Convergence {
                iterations: 0,
                residual: 0.0,
            },
            factored_within: f64::INFINITY,
        }
    }

    /// Sets the tolerance on the last Newton step \[m\] (ignored unless finite and positive).
    pub fn set_tolerance(&mut self, tolerance: f64) {
        if tolerance.is_finite() && tolerance > 0.0 {
            self.tolerance = tolerance;
        }
    }

    /// Solves for the pose of the base, the springs from the surface to the tip and the load at O.
    ///
    /// Starts from the present state when the number of springs is the same. No allocation unless
    /// there are more springs than ever before.
    ///
    /// # Errors
    /// [`EquilibriumError`]; the state is then a fresh start for the next call.
    pub fn solve(
        &mut self,
        world_from_base: &Isometry3<f64>,
        springs: &[Spring],
        load: TipLoad,
    ) -> Result<Convergence, EquilibriumError> {
        validate(world_from_base, springs, load)?;
        let warm = self.springs.len() == springs.len() && self.convergence.residual.is_finite();
        self.springs.clear();
        self.springs.extend_from_slice(springs);
        self.set_base(world_from_base);
        self.load = load;
        if warm {
            let result = self.converge(|_, _| {});
            if result.is_ok() {
                return self.reaches_last_spring(result);
            }
        }
        let result = self.restart(|_, _| {});
        self.reaches_last_spring(result)
    }

    fn reaches_last_spring(
        &mut self,
        result: Result<Convergence, EquilibriumError>,
    ) -> Result<Convergence, EquilibriumError> {
        if result.is_ok() && self.tip_length < -self.tolerance {
            self.convergence.residual = f64::NAN;
            let length_m = self.needle.length();
            let needed_m = length_m - self.tip_length;
            return Err(EquilibriumError::TooShort { needed_m, length_m });
        }
        result
    }

    /// As [`Self::converge`], from cold.
    pub(crate) fn restart(
        &mut self,
        update: impl FnMut(&mut Self, usize),
    ) -> Result<Convergence, EquilibriumError> {
        self.start();
        self.relax()?;
        let result = self.converge(update)?;
        self.convergence.iterations = result.iterations + RELAXATIONS;
        Ok(self.convergence)
    }

    /// Fixed-point steps from a cold start: linear beam with planes and lengths frozen, then both
    /// renewed. Converges from far away, where Newton's method may not.
    fn relax(&mut self) -> Result<(), EquilibriumError> {
        for iteration in 1..=RELAXATIONS {
            let unstable = |_| EquilibriumError::Unstable { iteration };
            let mut border = self.linearize(true).map_err(unstable)?;
            self.advance(&mut border).map_err(unstable)?;
            let z = self.nodes[0].d;
            let mut used = 0.0;
            for i in 1..self.nodes.len() {
                for _ in 0..3 {
                    let (a, b) = (&self.nodes[i - 1], &self.nodes[i]);
                    let mut piece = Piece::default();
                    piece.set(self.stiffness, a, b, &z, true);
                    self.nodes[i].l = (self.nodes[i].l + piece.slack).max(0.5 * self.nodes[i].l);
                }
                used += self.nodes[i].l;
            }
            self.tip_length = self.needle.length() - used;
        }
        self.settle_tip();
        Ok(())
    }

    /// Newton's method; `update` may renew stiffnesses and load from the state before each step.
    pub(crate) fn converge(
        &mut self,
        mut update: impl FnMut(&mut Self, usize),
    ) -> Result<Convergence, EquilibriumError> {
        self.convergence.residual = f64::NAN;
        let mut last_step_m = f64::NAN;
        for iteration in 1..=MAX_ITERATIONS {
            update(self, iteration - 1);
            let step = self
                .iterate()
                .map_err(|Singular| EquilibriumError::Unstable { iteration })?;
            if !step.is_finite() {
                return Err(EquilibriumError::Unstable { iteration });
            }
            last_step_m = step;
            if step <= self.tolerance {
                self.convergence = Convergence {
                    iterations: iteration,
                    residual: step,
                };
                return Ok(self.convergence);
            }
        }
        Err(EquilibriumError::NotConverged {
            iterations: MAX_ITERATIONS,
            last_step_m,
        })
    }

    pub(crate) fn set_base(&mut self, world_from_base: &Isometry3<f64>) {
        self.factored_within = f64::INFINITY;
        self.base = *world_from_base;
        let z = world_from_base * Vector3::z();
        // Better start values: the needle slides through its springs as the base advances.
        let advance = z.dot(&(world_from_base.translation.vector - self.nodes[0].p));
        if let Some(first) = self
            .nodes
            .get_mut(1)
            .filter(|first| first.l > 2.0 * advance)
        {
            first.l -= advance;
            self.tip_length += advance;
            self.settle_tip();
        }
        let base = &mut self.nodes[0];
        base.p = world_from_base.translation.vector;
        base.d = z;
        base.n = z;
        base.e = [
            world_from_base * Vector3::x(),
            world_from_base * Vector3::y(),
        ];
    }

    /// Start values: nodes on the line from the base to the last rest point.
    pub(crate) fn start(&mut self) {
        self.nodes.truncate(1);
        let base = self.nodes[0];
        let chord = self
            .springs
            .last()
            .map_or(base.d, |last| (last.rest - base.p).normalize());
        let mut before = 0.0;
        for spring in &self.springs {
            let s = chord.dot(&(spring.rest - base.p));
            // Noisy rest points may come out of order along the chord; any positive length will do.
            let l = (s - before).max(1e-6);
            before += l;
            let mut node = Node {
                p: base.p + chord * before,
                d: chord,
                l,
                ..base
            };
            node.refresh(&base.d, &base.e[0], &spring.rest);
            self.nodes.push(node);
        }
        self.tip_length = self.needle.length() - before;
        self.theta = 0.0;
        self.tip.y = base.e[1];
        self.settle_tip();
    }

    /// Adds a spring at the tip: the last piece of the needle becomes a piece between nodes.
    pub(crate) fn push_spring(&mut self, spring: Spring) {
        self.factored_within = f64::INFINITY;
        let base = self.nodes[0];
        let last = self.nodes[self.springs.len()];
        let d = last.d + self.tip.y * self.tip.turn;
        let l = self.tip_length;
        let mut node = Node {
            p: self.tip_position(),
            d,
            l,
            ..base
        };
        node.refresh(&base.d, &base.e[0], &spring.rest);
        self.nodes.push(node);
        self.springs.push(spring);
        self.tip_length = 0.0;
        self.settle_tip();
    }

    /// Removes the last spring, if any.
    pub(crate) fn pop_spring(&mut self) -> Option<Spring> {
        self.factored_within = f64::INFINITY;
        let spring = self.springs.pop()?;
        self.tip_length += self.nodes.pop().map_or(0.0, |node| node.l);
        self.settle_tip();
        Some(spring)
    }

    fn settle_tip(&mut self) {
        let input = self.tip_input();
        let d = self.nodes[self.springs.len()].d;
        self.tip = TipPiece::new(&input, &d, self.tip_length, self.theta, self.tip.y);
    }

    pub(crate) fn tip_input(&self) -> TipInput {
        let base = &self.nodes[0];
        TipInput {
            stiffness: self.stiffness,
            load: self.load,
            z: base.d,
            y: base.e[1],
        }
    }

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

    /// One Newton step; returns its length \[m\].
    fn iterate(&mut self) -> Result<f64, Singular> {
        let mut border = self.linearize(false)?;
        self.advance(&mut border)
    }

    /// Solves for the step and takes it; returns its length \[m\].
    fn advance(&mut self, border: &mut Block<2, 1>) -> Result<f64, Singular> {
        self.system.solve(&mut self.rhs, border);
        let n = self.springs.len();
        let mut turn = 0.0_f64;
        for x in &self.rhs {
            turn = turn.max(x[2][0].abs().max(x[3][0].abs()).max(x[4][0].abs()));
        }
        let mut scale = if turn > MAX_TURN {
            MAX_TURN / turn
        } else {
            1.0
        };
        // Lengths first: they need the old nodes, and bound the step so that no piece folds.
        let mut before = (Vector3::zeros(), Vector3::zeros());
        let mut changes = [0.0_f64; 2];
        for i in 1..=n {
            let x: [f64; 5] = std::array::from_fn(|k| self.rhs[i - 1][k][0]);
            let now = self.nodes[i].expand(&x);
            let piece = &mut self.pieces[i - 1];
            piece.slack += piece.l_by[0].dot(&(now.0 - before.0))
                + piece.l_by[1].dot(&before.1)
                + piece.l_by[2].dot(&now.1);
            if piece.slack < -0.9 * self.nodes[i].l {
                scale = scale.min(-0.5 * self.nodes[i].l / piece.slack);
            }
            changes[0] = changes[0].max(now.0.norm_squared());
            changes[1] = changes[1].max(now.1.norm_squared());
            before = now;
        }
        for i in 1..=n {
            let x: [f64; 5] = std::array::from_fn(|k| self.rhs[i - 1][k][0] * scale);
            let node = &mut self.nodes[i];
            let (dp, dd) = node.expand(&x);
            node.p = settled(&(node.p + dp));
            node.d = settled(&(node.d + dd));
            node.l += self.pieces[i - 1].slack * scale;
        }
        self.tip_length += border[0][0] * scale;
        self.theta += border[1][0] * scale;
        let z = self.nodes[0].d;
        if n > 0 && self.nodes[n].d.dot(&z) < -0.9 * self.nodes[n].d.norm() {
            return Err(Singular);
        }
        let (z, x) = (self.nodes[0].d, self.nodes[0].e[0]);
        for (node, spring) in self.nodes[1..].iter_mut().zip(&self.springs) {
            node.refresh(&z, &x, &spring.rest);
        }
        self.settle_tip();
        let slope = changes[1].sqrt().max(border[1][0].abs());
        let step = changes[0]
            .sqrt()
            .max(border[0][0].abs())
            .max(slope * SLOPE_ARM);
        self.factored_within = step;
        Ok(step)
    }

    /// Whether the factored tangent is that of the present state, to rounding of its uses.
    pub(crate) fn tangent_is_fresh(&self) -> bool {
        self.factored_within <= Self::TOLERANCE
    }

    /// The needle.
    pub const fn needle(&self) -> &Needle {
        &self.needle
    }

    /// Pose of the base in World.
    pub const fn world_from_base(&self) -> &Isometry3<f64> {
        &self.base
    }

    /// Springs, from the surface to the tip.
    pub fn springs(&self) -> &[Spring] {
        &self.springs
    }

    /// Load at O.
    pub const fn load(&self) -> TipLoad {
        self.load
    }

    /// How the present state was reached.
    pub const fn convergence(&self) -> Convergence {
        self.convergence
    }

    /// Points where the needle crosses the springs' planes \[m\], with the unit tangents there.
    pub fn spring_points(
        &self,
    ) -> impl ExactSizeIterator<Item = (Vector3<f64>, Vector3<f64>)> + '_ {
        self.nodes[1..].iter().map(|node| (node.p, node.n))
    }

    /// Arc lengths of the segments, base to tip: one more than springs \[m\].
    pub fn segment_lengths(&self) -> impl Iterator<Item = f64> + '_ {
        self.nodes[1..]
            .iter()
            .map(|node| node.l)
            .chain([self.tip.arc])
    }

    /// Arc length from the base to the first spring \[m\] (the needle's when there is none).
    pub fn free_length(&self) -> f64 {
        self.nodes.get(1).map_or(self.tip.arc, |node| node.l)
    }

    /// Arc length from the first spring to O \[m\].
    pub fn inserted_length(&self) -> f64 {
        if self.springs.is_empty() {
            0.0
        } else {
            self.needle.length() - self.free_length()
        }
    }

    /// Position of O in World \[m\].
    pub fn tip_position(&self) -> Vector3<f64> {
        let last = &self.nodes[self.springs.len()];
        last.p + last.d * self.tip_length + self.tip.y * self.tip.lift
    }

    /// Unit tip axis in World.
    pub const fn tip_axis(&self) -> Vector3<f64> {
        self.tip.t
    }

    /// Tip frame in World: origin O, z the tip axis, y away from the bevel direction.
    pub fn world_from_tip(&self) -> Isometry3<f64> {
        let (y, z) = (self.tip.y, self.tip.t);
        let axes = Matrix3::from_columns(&[y.cross(&z), y, z]);
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        Isometry3::from_parts(Translation3::from(self.tip_position()), rotation)
    }

    /// The cubic segments, base to tip (N + 1).
    pub fn segments(&self) -> impl Iterator<Item = Segment> + '_ {
        (0..=self.springs.len()).map(|i| self.segment(i))
    }

    /// Segment `i`; the last is the tip's.
    pub(crate) fn segment(&self, i: usize) -> Segment {
        let a = &self.nodes[i];
        if let Some(b) = self.nodes.get(i + 1) {
            Segment::hermite(&a.p, &a.d, &b.p, &b.d, b.l)
        } else {
            let y = self.tip.y / self.stiffness;
            let coefficients = [
                a.p,
                a.d,
                y * (self.tip.moment / 2.0),
                y * (-self.load.force / 6.0),
            ];
            Segment {
                coefficients,
                length: self.tip_length,
            }
        }
    }
}

fn validate(
    base: &Isometry3<f64>,
    springs: &[Spring],
    load: TipLoad,
) -> Result<(), EquilibriumError> {
    let position = base.translation.vector;
    if !position
        .iter()
        .chain(base.rotation.coords.iter())
        .all(|v| v.is_finite())
    {
        return Err(EquilibriumError::BasePose);
    }
    if !(load.force.is_finite() && load.bending.is_finite()) {
        return Err(EquilibriumError::TipLoad {
            force_n: load.force,
            moment_nm: load.bending,
        });
    }
    let z = base * Vector3::z();
    let mut before = position;
    for (index, spring) in springs.iter().enumerate() {
        if !spring.rest.iter().all(|v| v.is_finite()) {
            return Err(EquilibriumError::RestPoint { index });
        }
        if !(spring.stiffness.is_finite() && spring.stiffness >= 0.0) {
            let stiffness_n_per_m = spring.stiffness;
            return Err(EquilibriumError::Stiffness {
                index,
                stiffness_n_per_m,
            });
        }
        let ahead_m = z.dot(&(spring.rest - before));
        if !(ahead_m > 0.0) {
            return Err(if index == 0 {
                EquilibriumError::BehindBase { index, ahead_m }
            } else {
                EquilibriumError::Order { index, ahead_m }
            });
        }
        before = spring.rest;
    }
    Ok(())
}

/// The vector with coordinates far below any length made 0: in a plane needle the rounding noise
/// across the plane shrinks with every step, down to slow subnormal numbers.
#[inline]
fn settled(v: &Vector3<f64>) -> Vector3<f64> {
    v.map(|x| if x.abs() < 1e-40 { 0.0 } else { x })
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
