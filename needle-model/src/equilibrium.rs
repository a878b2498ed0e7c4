//! Equilibrium of the needle on its springs (section II.C), O(N) a Newton step.
//!
//! Unknowns: at each spring's node two coordinates in the spring's plane and the derivative (three),
//! then the length of the tip's piece and the roll of the tip frame. Equations: the force balance
//! in each plane, moment continuity, plane normal = tangent, arc length of each piece = its
//! parametric length, total arc length = the needle's, load along `y_tip`. The Newton tangent is
//! exact, so at convergence it also gives every derivative (module `jacobian`).

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::block::{Block, Bordered};
use crate::equilibrium_error::{EquilibriumError, validate};
use crate::needle::Needle;
use crate::piece::{Node, Piece};
use crate::segment::Segment;
use crate::spring::Spring;
use crate::tip_piece::{TipInput, TipLoad, TipPiece};

/// How an equilibrium was reached.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Convergence {
    /// Newton steps, those with a tangent factored before included.
    pub iterations: usize,
    /// Length of the last step \[m\]: the largest move of a node (or turn times 10 mm). The state is
    /// within a hundredth of the tolerance of the equilibrium: Newton converges quadratically, and
    /// steps with an older tangent go on until their ratio says so.
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
    pub(crate) rhs: Vec<Block<5, 1>>,
    pub(crate) tolerance: f64,
    pub(crate) convergence: Convergence,
    /// Whether `system` holds the tangent of a state with as many springs.
    pub(crate) factored: bool,
    /// Searches since then, and whether even the first of them found the steps not to shrink: with
    /// springs close together a tangent is soon too old.
    pub(crate) searches: usize,
    pub(crate) soon_old: bool,
    /// How far the state has moved since then \[m\]; infinite when its inputs changed.
    pub(crate) factored_within: f64,
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
            tip: TipPiece::straight(&input, needle.length()),
            pieces: Vec::with_capacity(64),
            system: Bordered::with_capacity(64),
            rhs: Vec::with_capacity(64),
            tolerance: Self::TOLERANCE,
            convergence: Convergence {
                iterations: 0,
                residual: 0.0,
            },
            factored: false,
            searches: 0,
            soon_old: false,
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

    /// Another length of needle beyond the base \[m\]: it slides through its springs, as far as they
    /// let it, when a guide lets it through.
    pub(crate) fn set_length(&mut self, needle: Needle) {
        self.factored_within = f64::INFINITY;
        self.tip_length += needle.length() - self.needle.length();
        self.needle = needle;
    }

    /// Start values: nodes on the line from the base to the last rest point.
    pub(crate) fn start(&mut self) {
        self.forget_tangent();
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
        self.forget_tangent();
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
        self.forget_tangent();
        let spring = self.springs.pop()?;
        self.tip_length += self.nodes.pop().map_or(0.0, |node| node.l);
        self.settle_tip();
        Some(spring)
    }

    fn forget_tangent(&mut self) {
        self.factored = false;
        self.soon_old = false;
        self.factored_within = f64::INFINITY;
    }

    pub(crate) fn settle_tip(&mut self) {
        let input = self.tip_input();
        let d = self.nodes[self.springs.len()].d;
        self.tip.renew(&input, &d, self.tip_length, self.theta);
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
