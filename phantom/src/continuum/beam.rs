//! The needle: an inextensible beam, bent without limit of slope, in tissue that is not local.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Vector2, Vector3};

/// Steepest slope against the way into the tissue (sine).
pub(crate) const STEEPEST: f64 = 0.85;
/// Newton steps of one equilibrium, and after how many the stiffness is taken anew.
const MOST_STEPS: usize = 60;
const STEPS_A_STIFFNESS: usize = 12;
/// Change of direction at which an equilibrium is found \[rad\], and that which counts as one where
/// the steps end.
const SETTLED: f64 = 1e-9;
const NEARLY_SETTLED: f64 = 1e-6;
/// Largest change of a direction in one step \[rad\].
const LARGEST_CHANGE: f64 = 0.05;

/// A beam by the directions of its edges, clamped at its base. Node 0 is the base.
#[derive(Clone, Debug)]
pub(crate) struct Beam {
    /// Bending stiffness \[N m2\].
    pub(crate) bending: f64,
    /// Length of an edge \[m\].
    pub(crate) edge: f64,
    /// Direction of the clamp.
    pub(crate) clamp: Vector3<f64>,
    /// Directions of the edges across z.
    pub(crate) across: Vec<Vector2<f64>>,
    /// The nodes \[m\].
    pub(crate) nodes: Vec<Vector3<f64>>,
}

/// Loads of one equilibrium.
pub(crate) trait Loads {
    /// Forces on the nodes as they are \[N\].
    fn forces(&mut self, beam: &Beam, forces: &mut [Vector3<f64>]);

    /// First node in the tissue, and the stiffness of the tissue against lateral displacements of
    /// the nodes from there on \[N/m\].
    fn stiffness(&self) -> (usize, &DMatrix<f64>);
}

/// What became of an equilibrium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Found {
    /// Last change of a direction \[rad\].
    pub(crate) last: f64,
    /// Whether it is one.
    pub(crate) converged: bool,
    /// Whether the shaft resists every small change of its shape.
    pub(crate) stable: bool,
}

impl Beam {
    pub(crate) fn straight(
        bending: f64,
        length: f64,
        edges: usize,
        base: Vector3<f64>,
        axis: Vector3<f64>,
    ) -> Self {
        let mut beam = Self {
            bending,
            edge: length / edges as f64,
            clamp: axis,
            across: vec![axis.xy(); edges],
            nodes: vec![base; edges + 1],
        };
        beam.place(&base);
        beam
    }

    /// Direction of edge `e`.
    pub(crate) fn direction(&self, e: usize) -> Vector3<f64> {
        let q = self.across[e];
        Vector3::new(q.x, q.y, (1.0 - q.norm_squared()).max(0.0).sqrt())
    }

    /// Lays the nodes from a base on.
    pub(crate) fn place(&mut self, base: &Vector3<f64>) {
        self.nodes[0] = *base;
        for e in 0..self.across.len() {
            self.nodes[e + 1] = self.nodes[e] + self.direction(e) * self.edge;
        }
    }

    /// Bending moment over stiffness at the base, as change of direction per length \[1/m\].
    pub(crate) fn base_bend(&self) -> Vector3<f64> {
        (self.direction(0) - self.clamp) / (0.5 * self.edge)
    }

    /// Change of direction at a joint over the length that it stands for \[1/m\].
    fn bend(&self, e: usize) -> f64 {
        let before = if e == 0 {
            self.clamp
        } else {
            self.direction(e - 1)
        };
        let length = if e == 0 { 0.5 } else { 1.0 } * self.edge;
        (self.direction(e) - before).norm() / length
    }

    /// Largest curvature \[1/m\].
    pub(crate) fn sharpest_bend(&self) -> f64 {
        (0..self.across.len())
            .map(|e| self.bend(e))
            .fold(0.0, f64::max)
    }

    /// Energy of bending \[J\].
    pub(crate) fn energy(&self) -> f64 {
        let joint = |e: usize| {
            let length = self.bending / self.joint(e);
            0.5 * self.bending * self.bend(e).powi(2) * length
        };
        (0..self.across.len()).map(joint).sum()
    }

    /// Bending stiffness over length between the neighbours of joint `e` (before edge `e`).
    fn joint(&self, e: usize) -> f64 {
        let length = if e == 0 { 0.5 } else { 1.0 } * self.edge;
        self.bending / length
    }

    /// Generalised force on the direction of every edge \[N m\].
    fn residual(&self, forces: &[Vector3<f64>]) -> Vec<Vector2<f64>> {
        let n = self.across.len();
        let mut beyond = Vector3::zeros();
        let mut out = vec![Vector2::zeros(); n];
        for e in (0..n).rev() {
            beyond += forces[e + 1];
            let here = self.direction(e);
            let slope = self.across[e] / here.z;
            let before = if e == 0 {
                self.clamp
            } else {
                self.direction(e - 1)
            };
            let mut r = (before.xy() - slope * before.z) * self.joint(e);
            if e + 1 < n {
                let after = self.direction(e + 1);
                r += (after.xy() - slope * after.z) * self.joint(e + 1);
            }
            out[e] = r + (beyond.xy() - slope * beyond.z) * self.edge;
        }
        out
    }

    /// Stiffness against changes of the directions, the same in both planes.
    fn factorise(
        &self,
        forces: &[Vector3<f64>],
        (first, tissue): (usize, &DMatrix<f64>),
    ) -> (Cholesky<f64, Dyn>, bool) {
        let n = self.across.len();
        let mut h = DMatrix::<f64>::zeros(n, n);
        // What lies beyond an edge moves with it: sums over all nodes behind.
        let count = tissue.nrows();
        let mut sums = DMatrix::<f64>::zeros(count + 1, count + 1);
        for i in (0..count).rev() {
            for j in (0..count).rev() {
                sums[(i, j)] =
                    tissue[(i, j)] + sums[(i + 1, j)] + sums[(i, j + 1)] - sums[(i + 1, j + 1)];
            }
        }
        let square = self.edge * self.edge;
        for e in 0..n {
            let i = (e + 1).saturating_sub(first);
            for d in 0..n {
                let j = (d + 1).saturating_sub(first);
                h[(e, d)] = square * sums[(i.min(count), j.min(count))];
            }
        }
        for e in 0..n {
            h[(e, e)] += self.joint(e);
            if e + 1 < n {
                h[(e, e)] += self.joint(e + 1);
                h[(e, e + 1)] -= self.joint(e + 1);
                h[(e + 1, e)] -= self.joint(e + 1);
            }
        }
        let stiff = h.clone();
        // Axial load beyond an edge.
        let mut beyond = 0.0;
        for e in (0..n).rev() {
            beyond += forces[e + 1].z;
            h[(e, e)] += beyond * self.edge;
        }
        match h.cholesky() {
            Some(found) => (found, true),
            // Without the load that buckles it the matrix is a sum of squares.
            None => (
                stiff.cholesky().unwrap_or_else(|| {
                    Cholesky::pack_dirty(DMatrix::identity(n, n) * self.joint(0).sqrt())
                }),
                false,
            ),
        }
    }

    /// Finds the equilibrium from the present shape.
    ///
    /// A shape that stays out of balance must not cost every step the full search: `brief` is a short
    /// one.
    pub(crate) fn settle(
        &mut self,
        base: &Vector3<f64>,
        loads: &mut impl Loads,
        brief: bool,
    ) -> Found {
        let n = self.across.len();
        let mut forces = vec![Vector3::zeros(); n + 1];
        self.place(base);
        loads.forces(self, &mut forces);
        let (mut factors, mut stable) = self.factorise(&forces, loads.stiffness());
        let mut found = Found {
            last: f64::INFINITY,
            converged: false,
            stable,
        };
        let mut share = 1.0;
        let most_steps = if brief { STEPS_A_STIFFNESS } else { MOST_STEPS };
        for k in 1..=most_steps {
            let r = self.residual(&forces);
            let step = |plane: usize| {
                factors.solve(&DVector::from_iterator(n, r.iter().map(|v| v[plane])))
            };
            let (x, y) = (step(0), step(1));
            let size = x.amax().max(y.amax());
            if !size.is_finite() {
                found.last = size;
                return found;
            }
            // A step that grows has gone too far.
            share = if size > found.last {
                0.5 * share
            } else {
                (1.2_f64 * share).min(1.0)
            };
            found.last = size;
            let most = (LARGEST_CHANGE / size).min(share);
            for e in 0..n {
                let q = self.across[e] + Vector2::new(x[e], y[e]) * most;
                self.across[e] = q.cap_magnitude(STEEPEST);
            }
            self.place(base);
            loads.forces(self, &mut forces);
            if size < SETTLED {
                break;
            }
            if k % STEPS_A_STIFFNESS == 0 && k < most_steps {
                (factors, stable) = self.factorise(&forces, loads.stiffness());
                found.stable = stable;
            }
        }
        found.converged = found.last < NEARLY_SETTLED;
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct End(Vector3<f64>, DMatrix<f64>);

    impl Loads for End {
        fn forces(&mut self, _: &Beam, forces: &mut [Vector3<f64>]) {
            forces.fill(Vector3::zeros());
            if let Some(last) = forces.last_mut() {
                *last = self.0;
            }
        }

        fn stiffness(&self) -> (usize, &DMatrix<f64>) {
            (1, &self.1)
        }
    }

    fn bent(force: Vector3<f64>) -> (Beam, Found) {
        let (base, axis) = (Vector3::zeros(), Vector3::z());
        let mut beam = Beam::straight(1.836e-3, 0.1, 64, base, axis);
        let found = beam.settle(&base, &mut End(force, DMatrix::zeros(0, 0)), false);
        (beam, found)
    }

    #[test]
    fn a_small_force_bends_it_as_a_cantilever() {
        let (beam, found) = bent(Vector3::new(1e-3, 0.0, 0.0));
        let exact = 1e-3 * 0.1_f64.powi(3) / (3.0 * 1.836e-3);
        assert!(found.converged && found.stable);
        assert!(
            (beam.nodes[64].x / exact - 1.0).abs() < 2e-3,
            "{}",
            beam.nodes[64].x
        );
    }

    /// The elastica: a lateral force of P L^2 / E I = 1 on a cantilever moves its end by 0.3017 L
    /// aside and 0.0564 L back (closed form by elliptic integrals; Bisshopp and Drucker, 1945).
    #[test]
    fn a_large_force_bends_it_as_the_elastica() {
        let (beam, found) = bent(Vector3::new(1.836e-3 / 0.01, 0.0, 0.0));
        let end = beam.nodes[64] / 0.1;
        assert!(found.converged);
        assert!((end.x - 0.3017).abs() < 1e-3, "{end}");
        assert!((1.0 - end.z - 0.0564).abs() < 1e-3, "{end}");
    }

    /// Clamped and free, it buckles at pi^2 E I / (4 L^2).
    #[test]
    fn too_large_a_push_buckles_it() {
        let critical = core::f64::consts::PI.powi(2) * 1.836e-3 / 0.04;
        assert!(bent(Vector3::new(0.0, 0.0, -0.98 * critical)).1.stable);
        assert!(!bent(Vector3::new(0.0, 0.0, -1.02 * critical)).1.stable);
    }
}
