//! How the tip moves with the base: eq. (12), by implicit differentiation.
//!
//! The Newton tangent of the converged state, with the turning planes, the changing lengths and the
//! turning load, against the change of the equations with the base pose. Only the first and last
//! nodes' equations see the base, so one pass down the factored system is enough.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use thiserror::Error;

use crate::block::Block;
use crate::equilibrium::Equilibrium;
use crate::frame::spin_row;
use crate::tip_piece::TipLoad;

/// The tangent is singular: the needle is at a limit point and has no derivative there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("the needle is at a limit point: its tangent is singular")]
pub struct TangentError;

/// Explicit change of the equations with one parameter, nodes and lengths held.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Direction {
    /// Base displacement and rotation.
    pub shift: Vector3<f64>,
    pub turn: Vector3<f64>,
    /// Change of the tip load.
    pub load: TipLoad,
}

impl Direction {
    pub(crate) const REST: Self = Self {
        shift: Vector3::new(0.0, 0.0, 0.0),
        turn: Vector3::new(0.0, 0.0, 0.0),
        load: TipLoad {
            force: 0.0,
            bending: 0.0,
        },
    };

    /// The six base twists \[v; w\], then none (the springs' stiffness, which touches every node, is
    /// the caller's), then `load`.
    pub(crate) fn all(load: TipLoad) -> [Self; 8] {
        std::array::from_fn(|k| match k {
            0..3 => Self {
                shift: Vector3::ith(k, 1.0),
                ..Self::REST
            },
            3..6 => Self {
                turn: Vector3::ith(k - 3, 1.0),
                ..Self::REST
            },
            6 => Self::REST,
            _ => Self { load, ..Self::REST },
        })
    }
}

/// Change of the state at the last node and of the global unknowns.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TipChange {
    pub p: Vector3<f64>,
    pub d: Vector3<f64>,
    pub length: f64,
    pub theta: f64,
}

impl Equilibrium {
    /// Refreshes the tangent at the converged state.
    ///
    /// # Errors
    /// [`TangentError`] at a limit point.
    pub(crate) fn tangent(&mut self) -> Result<(), TangentError> {
        // The last step's tangent is that of a state within the tolerance of this one.
        if self.tangent_is_fresh() {
            return Ok(());
        }
        self.settle(false);
        self.linearize(false).map(|_| ()).map_err(|_| TangentError)
    }

    /// What a change of load adds to S' and S at O along `y_tip` (node held).
    fn curl(&self, load: TipLoad) -> (f64, f64) {
        let l = self.tip_length;
        let turn = load.bending * l + load.force * l * l / 2.0;
        let lift = load.bending * l * l / 2.0 + load.force * l * l * l / 3.0;
        (turn / self.stiffness, lift / self.stiffness)
    }

    /// Explicit change of `y_tip` (node held).
    fn y_explicit(&self, direction: &Direction) -> Vector3<f64> {
        let tip = &self.tip;
        let turned = direction.turn.cross(&tip.y)
            - tip.y_by_axis * direction.turn.cross(&tip.t) * tip.norm
            + tip.y_by_axis * tip.y * self.curl(direction.load).0;
        tip.follow * turned
    }

    /// Minus the explicit change of the equations: first node, last node, border. The stiffness
    /// parameter, which touches every node, is left to the caller.
    pub(crate) fn explicit(&self, direction: &Direction) -> ([f64; 5], [f64; 5], [f64; 2]) {
        let (n, tip) = (self.springs.len(), &self.tip);
        let z = self.nodes[0].d;
        let z_change = direction.turn.cross(&z);
        let y_change = self.y_explicit(direction);
        let mut length = tip.arc_y.dot(&y_change)
            + tip.arc_load[0] * direction.load.force
            + tip.arc_load[1] * direction.load.bending;
        let mut roll = tip.roll_y.dot(&y_change)
            + tip.roll_load[0] * direction.load.force
            + tip.roll_load[1] * direction.load.bending
            + tip.roll_z.dot(&z_change);
        if n == 0 {
            length += (tip.arc_d + tip.y_d.tr_mul(&tip.arc_y)).dot(&z_change);
            roll += (tip.roll_d + tip.y_d.tr_mul(&tip.roll_y)).dot(&z_change);
            return ([0.0; 5], [0.0; 5], [-length, -roll]);
        }
        let first = &self.pieces[0];
        let l = first.l_by[1].dot(&z_change) - first.l_by[0].dot(&direction.shift);
        length += l;
        roll += first.roll_by[1].dot(&z_change) - first.roll_by[0].dot(&direction.shift);
        roll += self
            .pieces
            .iter()
            .map(|piece| piece.roll_z.dot(&z_change))
            .sum::<f64>();
        let force = direction.shift * -first.alpha - z_change * first.beta + first.shear_l * l;
        let moment =
            direction.shift * first.beta + z_change * (first.gamma / 2.0) + first.end_l * l;
        let load = direction.load;
        let (l, y) = (self.tip_length, tip.y);
        (
            self.nodes[1].project(&-force, &-moment),
            self.nodes[n].project(
                &(y_change * self.load.force + y * load.force),
                &(y_change * tip.moment + y * (load.bending + l * load.force)),
            ),
            [-length, -roll],
        )
    }

    /// Change of `y_tip`.
    pub(crate) fn y_change(&self, direction: &Direction, change: &TipChange) -> Vector3<f64> {
        let tip = &self.tip;
        self.y_explicit(direction)
            + tip.y_d * change.d
            + tip.y_l * change.length
            + tip.y_theta * change.theta
    }

    /// Twist \[v; w\] of the tip frame from the change of the last node and the globals.
    pub(crate) fn tip_twist_of(&self, direction: &Direction, change: &TipChange) -> Vector6<f64> {
        let tip = &self.tip;
        let d = self.nodes[self.springs.len()].d;
        let y = self.y_change(direction, change);
        let l = self.tip_length;
        let (turn, lift) = self.curl(direction.load);
        let velocity = change.p
            + change.d * l
            + (d + tip.y * tip.lift_l) * change.length
            + y * tip.lift
            + tip.y * lift;
        let end = change.d + y * tip.turn + tip.y * (tip.turn_l * change.length + turn);
        let axis = (end - tip.t * tip.t.dot(&end)) / tip.norm - direction.turn.cross(&tip.t);
        let spin = spin_row(&self.nodes[0].d, &tip.t).dot(&axis) + change.theta;
        let omega = direction.turn + tip.t.cross(&axis) + tip.t * spin;
        Vector6::new(
            velocity.x, velocity.y, velocity.z, omega.x, omega.y, omega.z,
        )
    }

    /// Change of the last node (the base's own, without springs) and of the globals.
    pub(crate) fn tip_change(
        &self,
        direction: &Direction,
        last: &[f64; 5],
        border: [f64; 2],
    ) -> TipChange {
        let n = self.springs.len();
        let (p, d) = if n == 0 {
            (direction.shift, direction.turn.cross(&self.nodes[0].d))
        } else {
            self.nodes[n].expand(last)
        };
        TipChange {
            p,
            d,
            length: border[0],
            theta: border[1],
        }
    }

    /// Twist of the tip for a change of load, with the tangent as last factored.
    pub(crate) fn tip_response(&self, load: TipLoad) -> Vector6<f64> {
        let direction = Direction {
            load,
            ..Direction::REST
        };
        let (first, last, border) = self.explicit(&direction);
        let column = |v: [f64; 5]| v.map(|v| [v]);
        let (x, border) =
            self.system
                .solve_ends(&column(first), &column(last), &border.map(|v| [v]));
        let change = self.tip_change(&direction, &x.map(|v| v[0]), [border[0][0], border[1][0]]);
        self.tip_twist_of(&direction, &change)
    }

    /// Jacobian from the twist of the base to the twist of the tip: Eq. (12).
    ///
    /// Both \[linear; angular\] of their frame's origin and in World.
    ///
    /// Rest points, stiffnesses, the set of springs and the magnitude of the tip load are held; the
    /// load turns with the tip.
    ///
    /// # Deviation
    /// Analytic, where the paper differentiates numerically.
    ///
    /// # Errors
    /// [`TangentError`] at a limit point.
    pub fn tip_jacobian(&mut self) -> Result<Matrix6<f64>, TangentError> {
        self.tangent()?;
        let all = Direction::all(self.load);
        let (mut first, mut last): (Block<5, 6>, Block<5, 6>) = ([[0.0; 6]; 5], [[0.0; 6]; 5]);
        let mut border = [[0.0; 6]; 2];
        for c in 0..6 {
            let (one, other, globals) = self.explicit(&all[c]);
            for r in 0..5 {
                first[r][c] = one[r];
                last[r][c] = other[r];
            }
            for r in 0..2 {
                border[r][c] = globals[r];
            }
        }
        let (node, border) = self.system.solve_ends(&first, &last, &border);
        let mut jacobian = Matrix6::zeros();
        for c in 0..6 {
            let x = std::array::from_fn(|k| node[k][c]);
            let change = self.tip_change(&all[c], &x, [border[0][c], border[1][c]]);
            jacobian.set_column(c, &self.tip_twist_of(&all[c], &change));
        }
        Ok(jacobian)
    }
}

/// A Jacobian in World turned into one from a twist in frame `a` axes to a twist in frame `b` axes.
pub fn jacobian_in_frames(
    jacobian: &Matrix6<f64>,
    world_from_a: &Matrix3<f64>,
    world_from_b: &Matrix3<f64>,
) -> Matrix6<f64> {
    let block = |m: &Matrix3<f64>| {
        let mut blocks = Matrix6::zeros();
        blocks.fixed_view_mut::<3, 3>(0, 0).copy_from(m);
        blocks.fixed_view_mut::<3, 3>(3, 3).copy_from(m);
        blocks
    };
    block(world_from_b).transpose() * jacobian * block(world_from_a)
}
