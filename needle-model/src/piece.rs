//! Forces, true length and roll of the pieces between nodes, with their gradients.
//!
//! The needle is written in Hermite nodes (position p, derivative d). A piece of parametric length
//! l between nodes a and b stores the energy EI/2 int |S''|^2; its length is the root of
//! "arc length = l", eliminated here, so each gradient below counts the length's own change.

use nalgebra::Vector3;

use crate::block::WIDE;
use crate::segment::{GAUSS_3, GAUSS_10};

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
    /// Newton correction of the length with the nodes held, and the inverse slope behind it.
    pub slack: f64,
    pub l_by_excess: f64,
    /// Gradients of the length by p_b - p_a, d_a, d_b.
    pub l_by: [Vector3<f64>; 3],
    /// Roll and its gradients (length eliminated), its derivative by the length, by the base axis.
    pub roll: f64,
    pub roll_by: [Vector3<f64>; 3],
    pub roll_l: f64,
    pub roll_z: Vector3<f64>,
}

/// A quadrature point: weight; derivatives of the Hermite shape by the three vectors that span the
/// piece (chord, start, end); their products, which are all that arc length and roll need.
#[derive(Debug, Clone, Copy)]
struct Point {
    w: f64,
    /// dS = h0 chord + h1 start + h2 end.
    h: [f64; 3],
    /// h_j h_k for (j, k) in `PAIRS`.
    hh: [f64; 6],
    /// h_j s_k - h_k s_j for the last three of `PAIRS`, with s the second derivatives.
    hs: [f64; 3],
}

/// Places of a symmetric 3x3 matrix, diagonal first.
const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

const fn points<const N: usize>(rule: &[(f64, f64); N]) -> [Point; N] {
    let mut points = [Point {
        w: 0.0,
        h: [0.0; 3],
        hh: [0.0; 6],
        hs: [0.0; 3],
    }; N];
    let mut i = 0;
    while i < N {
        let (u, w) = rule[i];
        let h = [
            6.0 * u * (1.0 - u),
            1.0 + u * (3.0 * u - 4.0),
            u * (3.0 * u - 2.0),
        ];
        let s = [6.0 - 12.0 * u, 6.0 * u - 4.0, 6.0 * u - 2.0];
        let mut p = 0;
        while p < 6 {
            let (j, k) = PAIRS[p];
            points[i].hh[p] = h[j] * h[k];
            if p >= 3 {
                points[i].hs[p - 3] = h[j] * s[k] - h[k] * s[j];
            }
            p += 1;
        }
        (points[i].w, points[i].h) = (w, h);
        i += 1;
    }
    points
}

/// Length up to which three quadrature points do \[m\].
const SHORT_PIECE: f64 = 4e-3;

static SHORT: [Point; 3] = points(&GAUSS_3);
static LONG: [Point; 10] = points(&GAUSS_10);

/// Inner products that length and roll of a piece follow from.
struct Products {
    /// Of the spanning vectors, off the diagonal twice: |dS|^2 = gram . hh.
    gram: [f64; 6],
    /// With z: z . dS = along . h.
    along: [f64; 3],
    /// z . (q_j x q_k): z . (dS x ddS) = triple . hs.
    triple: [f64; 3],
}

impl Products {
    #[inline]
    fn new(z: &Vector3<f64>, q: &[Vector3<f64>; 3]) -> Self {
        let (z0, z1) = (z.cross(&q[0]), z.cross(&q[1]));
        Self {
            gram: [
                q[0].norm_squared(),
                q[1].norm_squared(),
                q[2].norm_squared(),
                2.0 * q[0].dot(&q[1]),
                2.0 * q[0].dot(&q[2]),
                2.0 * q[1].dot(&q[2]),
            ],
            along: [z.dot(&q[0]), z.dot(&q[1]), z.dot(&q[2])],
            triple: [z0.dot(&q[1]), z0.dot(&q[2]), z1.dot(&q[2])],
        }
    }

    /// (|dS|, z . dS, z . (dS x ddS)) at a point.
    #[inline]
    fn at(&self, point: &Point) -> (f64, f64, f64) {
        let g = &self.gram;
        let hh = &point.hh;
        let square = (g[0] * hh[0] + g[1] * hh[1] + g[2] * hh[2])
            + (g[3] * hh[3] + g[4] * hh[4] + g[5] * hh[5]);
        let dot = |a: &[f64; 3], b: &[f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        (
            square.sqrt(),
            dot(&self.along, &point.h),
            dot(&self.triple, &point.hs),
        )
    }
}

/// The quadrature points of a piece: many for a long one, so that its length is true to far below
/// a nanometre however the needle bends.
fn rule(first: bool, l: f64) -> &'static [Point] {
    if first || l > SHORT_PIECE {
        &LONG
    } else {
        &SHORT
    }
}

impl Piece {
    /// The piece between the nodes, in place; the `first`, free one takes more quadrature points.
    pub(crate) fn set(
        &mut self,
        stiffness: f64,
        a: &Node,
        b: &Node,
        z: &Vector3<f64>,
        first: bool,
    ) {
        self.with_rule(stiffness, a, b, z, rule(first, b.l));
    }

    /// Forces, slack and roll of the piece between the nodes, in place; the gradients stay those of
    /// nodes near these.
    #[inline]
    pub(crate) fn renew(
        &mut self,
        stiffness: f64,
        a: &Node,
        b: &Node,
        z: &Vector3<f64>,
        first: bool,
    ) {
        let inverse = 1.0 / b.l;
        let delta = b.p - a.p;
        let (sum, turn) = (a.d + b.d, b.d - a.d);
        let bow = (delta - sum * (0.5 * b.l)) * (6.0 * stiffness * inverse * inverse);
        let tilt = turn * (stiffness * inverse);
        let products = Products::new(z, &[delta * inverse, a.d, b.d]);
        let (mut excess, mut roll) = (-1.0, 0.0);
        for point in rule(first, b.l) {
            let (norm, along, triple) = products.at(point);
            excess += point.w * norm;
            roll += point.w * triple / (norm * (norm + along));
        }
        self.shear = bow * (2.0 * inverse);
        self.start = -tilt - bow;
        self.end = tilt - bow;
        self.slack = excess * self.l_by_excess;
        self.roll = roll;
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
    fn with_rule(&mut self, stiffness: f64, a: &Node, b: &Node, z: &Vector3<f64>, rule: &[Point]) {
        let (l, inverse) = (b.l, 1.0 / b.l);
        let delta = b.p - a.p;
        let (sum, turn) = (a.d + b.d, b.d - a.d);
        let bow = delta - sum * (0.5 * l);
        let chord = delta * inverse;
        let q = [chord, a.d, b.d];
        let products = Products::new(z, &q);

        // Sums over the points: `length` |dS| by hh, then the parts of roll's gradients.
        let (mut excess, mut roll) = (-1.0, 0.0);
        let (mut length, mut bend) = ([0.0; 6], [0.0; 6]);
        let (mut twist, mut lean) = ([0.0; 3], [0.0; 3]);
        for point in rule {
            let (norm, along, triple) = products.at(point);
            excess += point.w * norm;
            let by_norm = 1.0 / norm;
            let weight = point.w * by_norm / (norm + along);
            let value = triple * weight;
            roll += value;
            let again = value * by_norm / (norm + along);
            let (stretch, bending, leaning) = (
                point.w * by_norm,
                again * (2.0 + along * by_norm),
                again * norm,
            );
            for p in 0..6 {
                length[p] += stretch * point.hh[p];
                bend[p] += bending * point.hh[p];
            }
            for p in 0..3 {
                twist[p] += weight * point.hs[p];
                lean[p] += leaning * point.h[p];
            }
        }
        let symmetric = |m: &[f64; 6]| {
            [
                q[0] * m[0] + q[1] * m[3] + q[2] * m[4],
                q[0] * m[3] + q[1] * m[1] + q[2] * m[5],
                q[0] * m[4] + q[1] * m[5] + q[2] * m[2],
            ]
        };
        let mut by = symmetric(&length);
        let turned = q.map(|q| z.cross(&q));
        let bent = symmetric(&bend);
        let mut roll_by = [
            turned[1] * -twist[0] - turned[2] * twist[1] - bent[0] - z * lean[0],
            turned[0] * twist[0] - turned[2] * twist[2] - bent[1] - z * lean[1],
            turned[0] * twist[1] + turned[1] * twist[2] - bent[2] - z * lean[2],
        ];
        // q0 x (twist0 q1 + twist1 q2) + twist2 q1 x q2.
        let roll_z = q[0].cross(&(q[1] * twist[0] + q[2] * twist[1]))
            + q[1].cross(&(q[2] * twist[2]))
            - (q[0] * lean[0] + q[1] * lean[1] + q[2] * lean[2]);
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
            l_by_excess: -1.0 / by_l,
            l_by,
            roll,
            roll_by,
            roll_l,
            roll_z,
        };
    }
}
