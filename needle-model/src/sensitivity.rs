//! Change of the whole needle with the base twist, the stiffness of the tissue and the tip load.

use nalgebra::{Matrix6, RowSVector, SMatrix, SVector, Vector3};

use crate::block::{Block, WIDE};
use crate::equilibrium::Equilibrium;
use crate::jacobian::{Direction, TangentError, TipChange};
use crate::segment::GAUSS_10;

/// Parameters: twist of the base \[v; w\] in World, logarithm of all spring stiffnesses, logarithm
/// of the tip load.
pub const PARAMETERS: usize = 8;
/// Column of the logarithm of the spring stiffnesses.
pub const STIFFNESS: usize = 6;
/// Column of the logarithm of the tip load.
pub const LOAD: usize = 7;

/// Derivatives of a scalar by the parameters.
pub type Gradient = RowSVector<f64, PARAMETERS>;
/// Derivatives of a vector by the parameters.
pub type VectorRates = SMatrix<f64, 3, PARAMETERS>;
/// Derivatives of a twist or wrench by the parameters.
pub type TwistRates = SMatrix<f64, 6, PARAMETERS>;

/// Derivatives of the needle's state by the parameters; a workspace to keep between calls.
///
/// With K_T as the paper has it, spring stiffnesses and tip load are both proportional to it
/// (eqs. 2 and 3): the derivative by ln K_T is the sum of both columns.
#[derive(Debug, Clone, Default)]
pub struct Sensitivities {
    pub(crate) p: Vec<VectorRates>,
    pub(crate) d: Vec<VectorRates>,
    /// Of the pieces' lengths; the tip's last.
    pub(crate) l: Vec<Gradient>,
    pub(crate) y: VectorRates,
    tip: TwistRates,
    rhs: Vec<Block<5, PARAMETERS>>,
}

impl Sensitivities {
    /// Derivatives of the tip's twist \[linear; angular\].
    pub const fn tip(&self) -> &TwistRates {
        &self.tip
    }

    /// The base columns of [`Self::tip`]: eq. (12)'s matrix.
    pub fn tip_jacobian(&self) -> Matrix6<f64> {
        self.tip.fixed_columns::<6>(0).into_owned()
    }

    /// Derivatives of the position of the point at the arc length `s` \[m\] of `needle`, the state
    /// these derivatives were taken at.
    pub fn point(&self, needle: &Equilibrium, s: f64) -> VectorRates {
        let (i, coordinate) = needle.locate(s);
        // At fixed arc length: the point also slides along the needle as arc lengths change.
        let (at_coordinate, tangent) = self.at_coordinate(needle, i, coordinate);
        let mut arc = self.l[..i].iter().sum::<Gradient>();
        let full = needle.segment(i).length;
        if i == needle.springs.len() || coordinate < full {
            for (u, w) in GAUSS_10 {
                let (tangent, rates) = self.tangent_rates(needle, i, coordinate, u);
                arc += tangent.normalize().transpose() * rates * w;
            }
        } else {
            arc += self.l[i];
        }
        at_coordinate - tangent * (arc / tangent.norm())
    }

    /// Derivatives of the point of segment `i` at the fraction of its coordinate, and the tangent.
    pub(crate) fn at_coordinate(
        &self,
        needle: &Equilibrium,
        i: usize,
        l: f64,
    ) -> (VectorRates, Vector3<f64>) {
        let segment = needle.segment(i);
        let tangent = segment.derivative(l);
        if i == needle.springs.len() {
            let (arm, by_load) = Self::tip_terms(needle, l);
            let rates = self.p[i]
                + self.d[i] * l
                + self.y * arm.0
                + needle.tip.y * (by_load.0 + self.l[i] * arm.2);
            return (rates, tangent);
        }
        let (a, b) = (&needle.nodes[i], &needle.nodes[i + 1]);
        let u = l / segment.length;
        let (h01, h10, h11) = (
            u * u * (3.0 - 2.0 * u),
            u * (1.0 - u).powi(2),
            u * u * (u - 1.0),
        );
        let rates = self.p[i] * (1.0 - h01)
            + self.p[i + 1] * h01
            + (self.d[i] * h10 + self.d[i + 1] * h11) * segment.length
            + (a.d * h10 + b.d * h11) * self.l[i];
        (rates, tangent)
    }

    /// The tip segment is p + d l + lift y: (lift, turn, d lift / d length) at the coordinate l held,
    /// and the gradients of lift and turn by the load.
    fn tip_terms(needle: &Equilibrium, l: f64) -> ((f64, f64, f64, f64), (Gradient, Gradient)) {
        let (load, stiffness) = (needle.load, needle.stiffness);
        let (moment, force) = (needle.tip.moment / stiffness, load.force / stiffness);
        let lift = moment * l * l / 2.0 - force * l * l * l / 6.0;
        let turn = moment * l - force * l * l / 2.0;
        let mut by_load = (Gradient::zeros(), Gradient::zeros());
        by_load.0[LOAD] = lift;
        by_load.1[LOAD] = turn;
        ((lift, turn, force * l * l / 2.0, force * l), by_load)
    }

    /// dS/du and its rates at the fraction `u` of the coordinate `l` of segment `i`, for arc length.
    fn tangent_rates(
        &self,
        needle: &Equilibrium,
        i: usize,
        l: f64,
        u: f64,
    ) -> (Vector3<f64>, VectorRates) {
        let segment = needle.segment(i);
        let tangent = segment.derivative(u * l) * l;
        if i == needle.springs.len() {
            let (arm, by_load) = Self::tip_terms(needle, u * l);
            let rates = self.d[i] + self.y * arm.1 + needle.tip.y * (by_load.1 + self.l[i] * arm.3);
            return (tangent, rates * l);
        }
        let full = segment.length;
        let (a, b) = (&needle.nodes[i], &needle.nodes[i + 1]);
        let v = u * l / full;
        let hill = 6.0 * v * (1.0 - v);
        let (ha, hb) = (1.0 + v * (3.0 * v - 4.0), v * (3.0 * v - 2.0));
        // d/dv of the position, times the fraction l / full that u covers.
        let rates = (self.p[i + 1] - self.p[i]) * hill
            + (self.d[i] * ha + self.d[i + 1] * hb) * full
            + (a.d * ha + b.d * hb) * self.l[i];
        (tangent, rates * (l / full))
    }
}

impl Equilibrium {
    /// Derivatives of the state, into `out`. Rest points and the set of springs are held, the load
    /// turns with the tip. No allocation once `out` has held as many springs.
    ///
    /// # Errors
    /// [`TangentError`] at a limit point.
    pub fn sensitivities(&mut self, out: &mut Sensitivities) -> Result<(), TangentError> {
        self.tangent()?;
        let n = self.springs.len();
        let all = Direction::all(self.load);
        out.rhs.clear();
        out.rhs.resize(n, [[0.0; PARAMETERS]; 5]);
        let mut border = [[0.0; PARAMETERS]; 2];
        for (c, direction) in all.iter().enumerate() {
            let (first, last, globals) = self.explicit(direction);
            for r in 0..5 {
                if n > 0 {
                    out.rhs[0][r][c] += first[r];
                    out.rhs[n - 1][r][c] += last[r];
                }
            }
            for r in 0..2 {
                border[r][c] = globals[r];
            }
        }
        for (i, spring) in self.springs.iter().enumerate() {
            let node = &self.nodes[i + 1];
            let force = (node.p - spring.rest) * spring.stiffness;
            for r in 0..2 {
                out.rhs[i][r][STIFFNESS] -= node.e[r].dot(&force);
            }
        }
        self.system.solve(&mut out.rhs, &mut border);

        out.p.clear();
        out.d.clear();
        out.l.clear();
        let z = self.nodes[0].d;
        let by_column = |f: &dyn Fn(usize) -> Vector3<f64>| {
            VectorRates::from_columns(&std::array::from_fn::<_, PARAMETERS, _>(f))
        };
        out.p.push(by_column(&|c| all[c].shift));
        out.d.push(by_column(&|c| all[c].turn.cross(&z)));
        for i in 0..n {
            let node = &self.nodes[i + 1];
            let x = SMatrix::<f64, 5, PARAMETERS>::from_fn(|r, c| out.rhs[i][r][c]);
            let d: VectorRates = x.fixed_rows::<3>(2).into_owned();
            let p = node.e[0] * x.row(0) + node.e[1] * x.row(1) - node.n * (node.w.transpose() * d);
            let piece = &self.pieces[i];
            let l = piece.l_by[0].transpose() * (p - out.p[i])
                + piece.l_by[1].transpose() * out.d[i]
                + piece.l_by[2].transpose() * d;
            out.p.push(p);
            out.d.push(d);
            out.l.push(l);
        }
        out.l.push(Gradient::from_fn(|_, c| border[0][c]));
        for (c, direction) in all.iter().enumerate() {
            let change = TipChange {
                p: out.p[n].column(c).into_owned(),
                d: out.d[n].column(c).into_owned(),
                length: border[0][c],
                theta: border[1][c],
            };
            out.tip
                .set_column(c, &self.tip_twist_of(direction, &change));
            out.y.set_column(c, &self.y_change(direction, &change));
        }
        Ok(())
    }

    /// Derivatives of the tip's twist by each spring's rest point, into `out` (6x3 a spring), from
    /// one transposed solve.
    ///
    /// # Errors
    /// [`TangentError`] at a limit point.
    pub fn tip_by_rest_points(
        &mut self,
        out: &mut Vec<SMatrix<f64, 6, 3>>,
    ) -> Result<(), TangentError> {
        self.tangent()?;
        out.clear();
        let n = self.springs.len();
        if n == 0 {
            return Ok(());
        }
        let still = Direction::REST;
        let twist = |x: [f64; 5], border: [f64; 2]| {
            self.tip_twist_of(&still, &self.tip_change(&still, &x, border))
        };
        let mut adjoint: Vec<Block<6, WIDE>> = vec![[[0.0; WIDE]; 6]; n];
        let mut border = [[0.0; 2]; 6];
        for k in 0..5 {
            let column = twist(
                std::array::from_fn(|i| f64::from(u8::from(i == k))),
                [0.0; 2],
            );
            for r in 0..6 {
                adjoint[n - 1][r][k] = column[r];
            }
        }
        for k in 0..2 {
            let column = twist(
                [0.0; 5],
                std::array::from_fn(|i| f64::from(u8::from(i == k))),
            );
            for r in 0..6 {
                border[r][k] = column[r];
            }
        }
        self.system.solve_transposed(&mut adjoint, &mut border);
        let weigh = |i: usize, rows: [f64; 5]| {
            let matrix = SMatrix::<f64, 6, 5>::from_fn(|r, c| adjoint[i][r][c]);
            matrix * SVector::from(rows)
        };
        let globals = SMatrix::<f64, 6, 2>::from_fn(|r, c| border[r][c]);
        for i in 0..n {
            let (node, spring, own) = (&self.nodes[i + 1], &self.springs[i], &self.pieces[i]);
            let after = self.pieces.get(i + 1);
            let mut by_rest = SMatrix::<f64, 6, 3>::zeros();
            for c in 0..3 {
                // The plane follows its rest point: the node moves along the normal.
                let slide = node.n * node.n[c];
                let l = own.l_by[0].dot(&slide);
                let mut force = slide * own.alpha
                    + own.shear_l * l
                    + (slide - Vector3::ith(c, 1.0)) * spring.stiffness;
                let mut moment = slide * -own.beta + own.end_l * l;
                let mut change = globals * SVector::from([l, own.roll_by[0].dot(&slide)]);
                if i > 0 {
                    let before = &self.nodes[i];
                    let force = slide * -own.alpha - own.shear_l * l;
                    let moment = slide * -own.beta + own.start_l * l;
                    change += weigh(i - 1, before.project(&force, &moment));
                }
                if let Some(after) = after {
                    let l = -after.l_by[0].dot(&slide);
                    force += slide * after.alpha - after.shear_l * l;
                    moment += slide * after.beta + after.start_l * l;
                    let next = &self.nodes[i + 2];
                    let (force, moment) = (
                        slide * -after.alpha + after.shear_l * l,
                        slide * after.beta + after.end_l * l,
                    );
                    change += weigh(i + 1, next.project(&force, &moment));
                    change += globals * SVector::from([l, -after.roll_by[0].dot(&slide)]);
                }
                change += weigh(i, node.project(&force, &moment));
                let mut column = -change;
                if i + 1 == n {
                    column += twist_of_shift(&slide);
                }
                by_rest.set_column(c, &column);
            }
            out.push(by_rest);
        }
        Ok(())
    }
}

fn twist_of_shift(v: &Vector3<f64>) -> SVector<f64, 6> {
    SVector::from([v.x, v.y, v.z, 0.0, 0.0, 0.0])
}
