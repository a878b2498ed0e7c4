//! Forces, true length and roll of the pieces between nodes, with their gradients.
//!
//! The needle is written in Hermite nodes (position p, derivative d). A piece of parametric length
//! l between nodes a and b stores the energy EI/2 int |S''|^2; its length is the root of
//! "arc length = l", eliminated here, so each gradient below counts the length's own change.

use nalgebra::{Matrix3, Vector3};

use crate::block::WIDE;
use crate::frame::{roll_rate, tip_y, tip_y_by_axis};
use crate::segment::{GAUSS_3, GAUSS_7};

/// A Hermite node and what its spring's plane makes of it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    /// Position \[m\].
    pub p: Vector3<f64>,
    /// Derivative along the needle.
    pub d: Vector3<f64>,
    /// Length of the piece that ends here \[m\].
    pub l: f64,
    /// Plane normal: unit derivative.
    pub n: Vector3<f64>,
    /// Orthonormal basis of the plane.
    pub e: [Vector3<f64>; 2],
    /// In-plane stretch over |d|: a turning plane moves the node by -n (w . dd).
    pub w: Vector3<f64>,
}

impl Node {
    /// Unit normal, basis and `w` from `p`, `d` and the rest point; puts `p` into the plane.
    #[inline]
    pub(crate) fn refresh(&mut self, z: &Vector3<f64>, x: &Vector3<f64>, rest: &Vector3<f64>) {
        let inverse = 1.0 / self.d.norm();
        self.n = self.d * inverse;
        let first = crate::frame::carry(z, &self.n, x);
        self.e = [first, self.n.cross(&first)];
        let q = self.p - rest;
        let out = self.n * self.n.dot(&q);
        self.p -= out;
        self.w = (q - out) * inverse;
    }

    /// Gradient by the node's 5 unknowns from the gradients by p and d.
    #[inline]
    pub(crate) fn reduce(&self, by_p: &Vector3<f64>, by_d: &Vector3<f64>) -> [f64; WIDE] {
        let d = by_d - self.w * self.n.dot(by_p);
        [self.e[0].dot(by_p), self.e[1].dot(by_p), d.x, d.y, d.z, 0.0]
    }

    /// The 5 equations of the node from a force at p and a moment-like term at d.
    #[inline]
    pub(crate) fn project(&self, force: &Vector3<f64>, moment: &Vector3<f64>) -> [f64; 5] {
        [
            self.e[0].dot(force),
            self.e[1].dot(force),
            moment.x,
            moment.y,
            moment.z,
        ]
    }

    /// (dp, dd) of the node's 5 unknowns.
    #[inline]
    pub(crate) fn expand(&self, x: &[f64; 5]) -> (Vector3<f64>, Vector3<f64>) {
        let d = Vector3::new(x[2], x[3], x[4]);
        (
            self.e[0] * x[0] + self.e[1] * x[1] - self.n * self.w.dot(&d),
            d,
        )
    }
}

/// A piece between two nodes.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Piece {
    /// Force on node b (minus that on node a): dE/dp_b.
    pub shear: Vector3<f64>,
    /// dE/dd_a and dE/dd_b.
    pub start: Vector3<f64>,
    pub end: Vector3<f64>,
    /// Their derivatives by the length, nodes fixed.
    pub shear_l: Vector3<f64>,
    pub start_l: Vector3<f64>,
    pub end_l: Vector3<f64>,
    /// 12 EI / l^3, 6 EI / l^2, 4 EI / l.
    pub alpha: f64,
    pub beta: f64,
    pub gamma: f64,
    /// Newton correction of the length with the nodes held.
    pub slack: f64,
    /// Gradients of the length by p_b - p_a, d_a, d_b.
    pub l_by: [Vector3<f64>; 3],
    /// Roll and its gradients (length eliminated), its derivative by the length, by the base axis.
    pub roll: f64,
    pub roll_by: [Vector3<f64>; 3],
    pub roll_l: f64,
    pub roll_z: Vector3<f64>,
}

impl Piece {
    /// The piece between the nodes, in place; `long` pieces take more quadrature points.
    pub(crate) fn set(&mut self, stiffness: f64, a: &Node, b: &Node, z: &Vector3<f64>, long: bool) {
        let rule: &[(f64, f64)] = if long { &GAUSS_7 } else { &GAUSS_3 };
        self.with_rule(stiffness, a, b, z, rule);
    }

    /// Makes the length independent of the nodes.
    pub(crate) fn freeze(&mut self) {
        self.slack = 0.0;
        self.l_by = [Vector3::zeros(); 3];
        self.roll_by = [Vector3::zeros(); 3];
        for v in [&mut self.shear_l, &mut self.start_l, &mut self.end_l] {
            *v = Vector3::zeros();
        }
    }

    // Not inlined, like the blocks' products: a Newton step should stay in the instruction cache.
    #[inline(never)]
    fn with_rule(
        &mut self,
        stiffness: f64,
        a: &Node,
        b: &Node,
        z: &Vector3<f64>,
        rule: &[(f64, f64)],
    ) {
        let (l, inverse) = (b.l, 1.0 / b.l);
        let delta = b.p - a.p;
        let (sum, turn) = (a.d + b.d, b.d - a.d);
        let bow = delta - sum * (0.5 * l);
        let chord = delta * inverse;

        let mut excess = -1.0;
        let mut by = [Vector3::zeros(); 3];
        let mut roll = 0.0;
        let (mut roll_by, mut roll_z) = ([Vector3::zeros(); 3], Vector3::zeros());
        for &(u, w) in rule {
            let hill = 6.0 * u * (1.0 - u);
            let (ha, hb) = (1.0 + u * (3.0 * u - 4.0), u * (3.0 * u - 2.0));
            let d = chord * hill + a.d * ha + b.d * hb;
            let norm = d.norm();
            excess += w * norm;
            let t = d * (w / norm);
            by[0] += t * hill;
            by[1] += t * ha;
            by[2] += t * hb;
            let (slope, va, vb) = (6.0 - 12.0 * u, 6.0 * u - 4.0, 6.0 * u - 2.0);
            let v = chord * slope + a.d * va + b.d * vb;
            let (f, f_d, f_v, f_z) = roll_rate(z, &d, &v);
            roll += w * f;
            roll_by[0] += (f_d * hill + f_v * slope) * w;
            roll_by[1] += (f_d * ha + f_v * va) * w;
            roll_by[2] += (f_d * hb + f_v * vb) * w;
            roll_z += f_z * w;
        }
        by[0] *= inverse;
        roll_by[0] *= inverse;
        // excess(l, nodes) = 0; d excess / dl = -by_delta . delta / l.
        let by_l = -by[0].dot(&delta) * inverse;
        let l_by = by.map(|g| g / -by_l);
        let roll_l = -roll_by[0].dot(&delta) * inverse;
        for k in 0..3 {
            roll_by[k] += l_by[k] * roll_l;
        }

        let (i2, i3) = (inverse * inverse, inverse * inverse * inverse);
        let (tilt, arch) = (turn * (stiffness * inverse), bow * (6.0 * stiffness * i2));
        *self = Self {
            shear: bow * (12.0 * stiffness * i3),
            start: -tilt - arch,
            end: tilt - arch,
            shear_l: (sum - chord * 3.0) * (12.0 * stiffness * i3),
            start_l: (chord * 12.0 - a.d * 4.0 - b.d * 2.0) * (stiffness * i2),
            end_l: (chord * 12.0 - a.d * 2.0 - b.d * 4.0) * (stiffness * i2),
            alpha: 12.0 * stiffness * i3,
            beta: 6.0 * stiffness * i2,
            gamma: 4.0 * stiffness * inverse,
            slack: -excess / by_l,
            l_by,
            roll,
            roll_by,
            roll_l,
            roll_z,
        };
    }
}

/// Load at O: a force along `y_tip` and the end curvature times E I along `y_tip`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TipLoad {
    /// Force on the needle along `y_tip` \[N\].
    pub force: f64,
    /// E I S''(L) along `y_tip` \[N m\].
    pub bending: f64,
}

impl From<crate::bevel::BevelLoad> for TipLoad {
    /// In the paper's signs: the force acts along +`y_tip` (eq. 8), the moment as
    /// E I S'' = -M `y_tip` (eq. 11).
    fn from(load: crate::bevel::BevelLoad) -> Self {
        Self {
            force: load.force,
            bending: -load.moment,
        }
    }
}

impl std::ops::Mul<f64> for TipLoad {
    type Output = Self;

    fn mul(self, scale: f64) -> Self {
        Self {
            force: self.force * scale,
            bending: self.bending * scale,
        }
    }
}

/// The tip's piece: from the last node to the free end O, known from that node and the load,
/// S(l) = p + d l + y (A l^2 / 2 + B l^3 / 6), so it needs no node of its own.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TipPiece {
    /// `y_tip` and the unit tip axis.
    pub y: Vector3<f64>,
    pub t: Vector3<f64>,
    /// |S'| at O.
    pub norm: f64,
    /// E I S'' at the last node along `y_tip`: bending + l force.
    pub moment: f64,
    /// S'(l) = d + `turn` y and S(l) = p + d l + `lift` y; derivatives by l.
    pub turn: f64,
    pub turn_l: f64,
    pub lift: f64,
    pub lift_l: f64,
    /// Inverse of (1 - turn dy/dS'): the load turns with the tip it bends.
    pub follow: Matrix3<f64>,
    /// dy/dt over |S'|.
    pub y_by_axis: Matrix3<f64>,
    /// Gradients of `y_tip` by d, l and theta.
    pub y_d: Matrix3<f64>,
    pub y_l: Vector3<f64>,
    pub y_theta: Vector3<f64>,
    /// Arc length, its gradients by d and y, its derivative by l.
    pub arc: f64,
    pub arc_d: Vector3<f64>,
    pub arc_y: Vector3<f64>,
    pub arc_l: f64,
    pub roll: f64,
    pub roll_d: Vector3<f64>,
    pub roll_y: Vector3<f64>,
    pub roll_l: f64,
    pub roll_z: Vector3<f64>,
    /// Derivatives of arc length and roll by force and bending, y fixed.
    pub arc_load: [f64; 2],
    pub roll_load: [f64; 2],
}

/// Base axes and load, as the tip's piece needs them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TipInput {
    pub stiffness: f64,
    pub load: TipLoad,
    pub z: Vector3<f64>,
    pub y: Vector3<f64>,
}

impl TipPiece {
    /// The piece of length `l` after a node of derivative `d`, with roll `theta`; `y` is the start
    /// value for `y_tip`.
    pub(crate) fn new(
        input: &TipInput,
        d: &Vector3<f64>,
        l: f64,
        theta: f64,
        y: Vector3<f64>,
    ) -> Self {
        let TipInput {
            stiffness,
            load,
            z,
            y: y_base,
        } = *input;
        let moment = load.bending + l * load.force;
        let turn = (load.bending * l + load.force * l * l / 2.0) / stiffness;
        let turn_l = moment / stiffness;
        let lift = (load.bending * l * l / 2.0 + load.force * l * l * l / 3.0) / stiffness;

        // y_tip depends on the tip axis, which depends on y_tip through the load: Newton.
        let mut y = y;
        let (mut t, mut norm, mut y_by_axis, mut follow);
        let mut round = 0;
        loop {
            let end = d + y * turn;
            norm = end.norm();
            t = end / norm;
            let carried = tip_y(&z, &y_base, &t, theta);
            y_by_axis = tip_y_by_axis(&z, &t, &carried) / norm;
            follow = (Matrix3::identity() - y_by_axis * turn)
                .try_inverse()
                .unwrap_or_else(Matrix3::identity);
            let step = follow * (carried - y);
            y += step;
            round += 1;
            if step.norm_squared() < 1e-28 || round == 20 {
                break;
            }
        }
        let y_theta = follow * t.cross(&y);

        let (mut arc, mut arc_d, mut arc_y, mut arc_l) =
            (0.0, Vector3::zeros(), Vector3::zeros(), 0.0);
        let (mut roll, mut roll_d, mut roll_y, mut roll_l) =
            (0.0, Vector3::zeros(), Vector3::zeros(), 0.0);
        let (mut arc_load, mut roll_load, mut roll_z) = ([0.0; 2], [0.0; 2], Vector3::zeros());
        for (u, w) in GAUSS_7 {
            // S' = d + k y and dS'/du = k_u y, with u = (coordinate) / l.
            let k = (moment * l * u - load.force * l * l * u * u / 2.0) / stiffness;
            let k_l =
                ((load.bending + 2.0 * load.force * l) * u - load.force * l * u * u) / stiffness;
            let k_u = (moment * l - load.force * l * l * u) / stiffness;
            let k_ul = (load.bending + 2.0 * load.force * l - 2.0 * load.force * l * u) / stiffness;
            let tangent = d + y * k;
            let size = tangent.norm();
            let unit = tangent / size;
            arc += w * l * size;
            arc_d += unit * (w * l);
            arc_y += unit * (w * l * k);
            arc_l += w * (size + l * unit.dot(&y) * k_l);
            let (f, f_d, f_v, f_z) = roll_rate(&z, &tangent, &(y * k_u));
            roll += w * f;
            roll_d += f_d * w;
            roll_y += (f_d * k + f_v * k_u) * w;
            roll_l += w * (f_d.dot(&y) * k_l + f_v.dot(&y) * k_ul);
            let by_force = (l * l * (u - u * u / 2.0), l * l * (1.0 - u));
            for (m, (by_k, by_k_u)) in [by_force, (l * u, l)].into_iter().enumerate() {
                arc_load[m] += w * l * unit.dot(&y) * by_k / stiffness;
                roll_load[m] += w * (f_d.dot(&y) * by_k + f_v.dot(&y) * by_k_u) / stiffness;
            }
            roll_z += f_z * w;
        }
        Self {
            y,
            t,
            norm,
            moment,
            turn,
            turn_l,
            lift,
            lift_l: (load.bending * l + load.force * l * l) / stiffness,
            follow,
            y_by_axis,
            y_d: follow * y_by_axis,
            y_l: follow * (y_by_axis * y) * turn_l,
            y_theta,
            arc,
            arc_d,
            arc_y,
            arc_l,
            roll,
            roll_d,
            roll_y,
            roll_l,
            roll_z,
            arc_load,
            roll_load,
        }
    }
}
