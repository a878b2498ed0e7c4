//! The joint bundle: both cameras, their relative pose, one board pose per pair.

use nalgebra::{Isometry3, Matrix3, Matrix6, Point2, SMatrix, SVector, Vector3, Vector6};

use super::super::bundle::{Block, Bundle};
use super::super::monocular::moved;
use super::super::normal::{CameraNormal, INTRINSICS, Observed, accumulate, stepped};
use crate::camera::Camera;

/// Left intrinsics, right intrinsics, translation and rotation between the cameras.
pub(crate) const SHARED: usize = 2 * INTRINSICS + 6;
const RIGHT: usize = INTRINSICS;
const RIG: usize = 2 * INTRINSICS;

/// Both cameras at one value of the parameters.
#[derive(Clone, Debug)]
pub(super) struct Joint<'a> {
    pub left: Camera,
    pub right: Camera,
    pub right_from_left: Isometry3<f64>,
    pub left_from_board: Vec<Isometry3<f64>>,
    pub board: &'a [Point2<f64>],
    pub observed: [&'a [Observed]; 2],
    pub huber_px: f64,
}

impl Bundle<SHARED> for Joint<'_> {
    fn linearise(&self) -> Option<(Vec<Block<SHARED>>, f64)> {
        let mut blocks = Vec::with_capacity(self.left_from_board.len());
        let mut cost = 0.0;
        let views = self.observed[0].iter().zip(self.observed[1]);
        for (pose, (left, right)) in self.left_from_board.iter().zip(views) {
            let l = accumulate(&self.left, pose, self.board, left, self.huber_px)?;
            let pose_right = self.right_from_left * pose;
            let r = accumulate(&self.right, &pose_right, self.board, right, self.huber_px)?;
            cost += l.cost + r.cost;
            blocks.push(self.block(&l, &r, &pose.translation.vector));
        }
        Some((blocks, cost))
    }

    fn stepped(&self, shared: &SVector<f64, SHARED>, poses: &[Vector6<f64>]) -> Self {
        let step = shared.as_slice();
        Self {
            left: moved(&self.left, &step[..INTRINSICS]),
            right: moved(&self.right, &step[RIGHT..RIG]),
            right_from_left: stepped(
                &self.right_from_left,
                &shared.fixed_rows::<6>(RIG).into_owned(),
            ),
            left_from_board: self
                .left_from_board
                .iter()
                .zip(poses)
                .map(|(p, s)| stepped(p, s))
                .collect(),
            ..*self
        }
    }
}

impl Joint<'_> {
    /// Both cameras' normal equations as one view's, by the chain rule: the board's pose in the
    /// right camera moves with the rig's step and with the pose in the left camera.
    fn block(&self, l: &CameraNormal, r: &CameraNormal, origin: &Vector3<f64>) -> Block<SHARED> {
        let rotation: Matrix3<f64> = *self.right_from_left.rotation.to_rotation_matrix().matrix();
        let mut by_pose = Matrix6::zeros();
        by_pose.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        by_pose.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        let mut by_rig = Matrix6::identity();
        by_rig
            .fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&-(rotation * origin).cross_matrix());

        let mut u = SMatrix::<f64, SHARED, SHARED>::zeros();
        let mut w = SMatrix::<f64, SHARED, 6>::zeros();
        let mut gs = SVector::<f64, SHARED>::zeros();
        u.fixed_view_mut::<INTRINSICS, INTRINSICS>(0, 0)
            .copy_from(&l.ii);
        u.fixed_view_mut::<INTRINSICS, INTRINSICS>(RIGHT, RIGHT)
            .copy_from(&r.ii);
        let ip = r.ip * by_rig;
        u.fixed_view_mut::<INTRINSICS, 6>(RIGHT, RIG).copy_from(&ip);
        u.fixed_view_mut::<6, INTRINSICS>(RIG, RIGHT)
            .copy_from(&ip.transpose());
        let rig_pp = by_rig.transpose() * r.pp;
        u.fixed_view_mut::<6, 6>(RIG, RIG)
            .copy_from(&(rig_pp * by_rig));
        w.fixed_view_mut::<INTRINSICS, 6>(0, 0).copy_from(&l.ip);
        w.fixed_view_mut::<INTRINSICS, 6>(RIGHT, 0)
            .copy_from(&(r.ip * by_pose));
        w.fixed_view_mut::<6, 6>(RIG, 0)
            .copy_from(&(rig_pp * by_pose));
        gs.fixed_rows_mut::<INTRINSICS>(0).copy_from(&l.gi);
        gs.fixed_rows_mut::<INTRINSICS>(RIGHT).copy_from(&r.gi);
        gs.fixed_rows_mut::<6>(RIG)
            .copy_from(&(by_rig.transpose() * r.gp));
        Block {
            u,
            w,
            v: l.pp + by_pose.transpose() * r.pp * by_pose,
            gs,
            gv: l.gp + by_pose.transpose() * r.gp,
        }
    }
}
