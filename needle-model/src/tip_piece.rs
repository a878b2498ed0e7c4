//! The tip's piece: from the last node to the free end O.

use nalgebra::{Matrix3, Vector3};

use crate::frame::{carry, roll_rate, rolled, tip_y_by_axis};
use crate::segment::GAUSS_10;

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

/// The piece at one place: S' = d + `k` y, dS'/du = `k_u` y, with u = (coordinate) / l.
struct Place {
    k: f64,
    k_u: f64,
    tangent: Vector3<f64>,
}

impl TipPiece {
    /// A straight piece of length `l` along the base axis.
    pub(crate) fn straight(input: &TipInput, l: f64) -> Self {
        let (zero, none) = (Vector3::zeros(), Matrix3::zeros());
        let mut piece = Self {
            y: input.y,
            t: input.z,
            norm: 1.0,
            moment: 0.0,
            turn: 0.0,
            turn_l: 0.0,
            lift: 0.0,
            lift_l: 0.0,
            follow: Matrix3::identity(),
            y_by_axis: none,
            y_d: none,
            y_l: zero,
            y_theta: zero,
            arc: l,
            arc_d: zero,
            arc_y: zero,
            arc_l: 1.0,
            roll: 0.0,
            roll_d: zero,
            roll_y: zero,
            roll_l: 0.0,
            roll_z: zero,
            arc_load: [0.0; 2],
            roll_load: [0.0; 2],
        };
        piece.renew(input, &input.z, l, 0.0);
        piece.differentiate(input, &input.z, l);
        piece
    }

    /// The piece of length `l` after a node of derivative `d`, with roll `theta`, without gradients;
    /// the present `y` is the start value for `y_tip`.
    pub(crate) fn renew(&mut self, input: &TipInput, d: &Vector3<f64>, l: f64, theta: f64) {
        let TipInput {
            stiffness,
            load,
            z,
            y: y_base,
        } = *input;
        self.moment = load.bending + l * load.force;
        self.turn = (load.bending * l + load.force * l * l / 2.0) / stiffness;
        self.turn_l = self.moment / stiffness;
        self.lift = (load.bending * l * l / 2.0 + load.force * l * l * l / 3.0) / stiffness;
        self.lift_l = (load.bending * l + load.force * l * l) / stiffness;

        // y_tip depends on the tip axis, which depends on y_tip through the load: Newton's method,
        // at first with the derivative last used.
        let turned = rolled(&z, &y_base, theta);
        let mut round = 0;
        loop {
            let end = d + self.y * self.turn;
            self.norm = end.norm();
            self.t = end / self.norm;
            let carried = carry(&z, &self.t, &turned);
            if round > 3 {
                self.set_follow(&z, &carried);
            }
            let step = self.follow * (carried - self.y);
            self.y += step;
            round += 1;
            if step.norm_squared() < 1e-28 || round == 24 {
                break;
            }
        }
        (self.arc, self.roll) = (0.0, 0.0);
        for (u, w) in GAUSS_10 {
            let Place { k_u, tangent, .. } = self.place(input, d, l, u);
            let size = tangent.norm();
            self.arc += w * l * size;
            let turning = z.dot(&tangent.cross(&self.y)) * k_u;
            self.roll += w * turning / (size * (size + z.dot(&tangent)));
        }
    }

    fn place(&self, input: &TipInput, d: &Vector3<f64>, l: f64, u: f64) -> Place {
        let (force, inverse) = (input.load.force * l * l, 1.0 / input.stiffness);
        let k = (self.moment * l - force * u / 2.0) * u * inverse;
        Place {
            k,
            k_u: (self.moment * l - force * u) * inverse,
            tangent: d + self.y * k,
        }
    }

    fn set_follow(&mut self, z: &Vector3<f64>, y: &Vector3<f64>) {
        self.y_by_axis = tip_y_by_axis(z, &self.t, y) / self.norm;
        self.follow = (Matrix3::identity() - self.y_by_axis * self.turn)
            .try_inverse()
            .unwrap_or_else(Matrix3::identity);
    }

    /// Gradients at the state last renewed.
    pub(crate) fn differentiate(&mut self, input: &TipInput, d: &Vector3<f64>, l: f64) {
        let TipInput {
            stiffness, load, z, ..
        } = *input;
        let y = self.y;
        self.set_follow(&z, &y);
        self.y_d = self.follow * self.y_by_axis;
        self.y_l = self.y_d * y * self.turn_l;
        self.y_theta = self.follow * self.t.cross(&y);

        let (mut arc_d, mut arc_y, mut arc_l) = (Vector3::zeros(), Vector3::zeros(), 0.0);
        let (mut roll_d, mut roll_y, mut roll_l) = (Vector3::zeros(), Vector3::zeros(), 0.0);
        let (mut arc_load, mut roll_load, mut roll_z) = ([0.0; 2], [0.0; 2], Vector3::zeros());
        for (u, w) in GAUSS_10 {
            let Place { k, k_u, tangent } = self.place(input, d, l, u);
            let k_l =
                ((load.bending + 2.0 * load.force * l) * u - load.force * l * u * u) / stiffness;
            let k_ul = (load.bending + 2.0 * load.force * l - 2.0 * load.force * l * u) / stiffness;
            let size = tangent.norm();
            let unit = tangent / size;
            arc_d += unit * (w * l);
            arc_y += unit * (w * l * k);
            arc_l += w * (size + l * unit.dot(&y) * k_l);
            let (_, f_d, f_v, f_z) = roll_rate(&z, &tangent, &(y * k_u));
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
        (self.arc_d, self.arc_y, self.arc_l) = (arc_d, arc_y, arc_l);
        (self.roll_d, self.roll_y, self.roll_l) = (roll_d, roll_y, roll_l);
        (self.arc_load, self.roll_load, self.roll_z) = (arc_load, roll_load, roll_z);
    }
}
