//! Strict priority between the paper's tasks: eqs. (17)-(20).

use nalgebra::{Matrix3x6, Matrix4x6, Matrix6, Matrix6x3, RowVector6, SMatrix, Vector3, Vector6};

/// Singular values below this fraction of the largest count as zero: far above rounding
/// (1e-16), far below what still moves the tip.
const RANK_TOLERANCE: f64 = 1e-9;

/// Sweeps of the Jacobi rotations; three to six are usual for six unknowns.
const SWEEPS: usize = 30;

/// The undamped pseudo-inverse of a matrix with six columns, by a rank-revealing singular value
/// decomposition (one-sided Jacobi, which keeps small singular values accurate). A matrix of
/// zeros, or one with a number that is not finite, gives zeros.
pub fn pseudo_inverse<const R: usize>(matrix: &SMatrix<f64, R, 6>) -> SMatrix<f64, 6, R> {
    let mut inverse = SMatrix::<f64, 6, R>::zeros();
    if !matrix.iter().all(|x| x.is_finite()) {
        return inverse;
    }
    // a = matrix' * v with v orthogonal: rotated until a's columns are orthogonal.
    let mut a: SMatrix<f64, 6, R> = matrix.transpose();
    let mut v = SMatrix::<f64, R, R>::identity();
    for _ in 0..SWEEPS {
        let mut rotated = false;
        for p in 0..R {
            for q in p + 1..R {
                rotated |= orthogonalise(&mut a, &mut v, p, q);
            }
        }
        if !rotated {
            break;
        }
    }
    let largest = a.column_iter().map(|c| c.norm()).fold(0.0, f64::max);
    for k in 0..R {
        let value = a.column(k).norm();
        if value > largest * RANK_TOLERANCE && value > 0.0 {
            inverse += a.column(k) * v.column(k).transpose() / (value * value);
        }
    }
    inverse
}

/// One Jacobi rotation of columns `p` and `q`; `false` where they are orthogonal already.
fn orthogonalise<const R: usize>(
    a: &mut SMatrix<f64, 6, R>,
    v: &mut SMatrix<f64, R, R>,
    p: usize,
    q: usize,
) -> bool {
    let (pp, qq) = (a.column(p).norm_squared(), a.column(q).norm_squared());
    let pq = a.column(p).dot(&a.column(q));
    if pq == 0.0 || pq.abs() <= 1e-15 * (pp * qq).sqrt() {
        return false;
    }
    let zeta = (qq - pp) / (2.0 * pq);
    let t = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
    let c = 1.0 / (1.0 + t * t).sqrt();
    let s = c * t;
    for i in 0..6 {
        let (x, y) = (a[(i, p)], a[(i, q)]);
        a[(i, p)] = c * x - s * y;
        a[(i, q)] = s * x + c * y;
    }
    for i in 0..R {
        let (x, y) = (v[(i, p)], v[(i, q)]);
        v[(i, p)] = c * x - s * y;
        v[(i, q)] = s * x + c * y;
    }
    true
}

/// Jacobian of the first two tasks together: Eq. (18).
pub fn augmented_jacobian(j_v: &Matrix3x6<f64>, j_omega_z: &RowVector6<f64>) -> Matrix4x6<f64> {
    let mut j = Matrix4x6::zeros();
    j.fixed_rows_mut::<3>(0).copy_from(j_v);
    j.fixed_rows_mut::<1>(3).copy_from(j_omega_z);
    j
}

/// Orthogonal projector onto the base motions that leave the tip's velocity alone: Eq. (19).
pub fn first_projector(j_v: &Matrix3x6<f64>) -> Matrix6<f64> {
    Matrix6::identity() - pseudo_inverse(j_v) * j_v
}

/// Orthogonal projector onto the base motions that leave the tip's velocity and its spin
/// alone: Eq. (20).
pub fn second_projector(j_12: &Matrix4x6<f64>) -> Matrix6<f64> {
    Matrix6::identity() - pseudo_inverse(j_12) * j_12
}

/// What the three tasks ask for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tasks {
    /// Translation part of the manipulation Jacobian, tip axes.
    pub j_v: Matrix3x6<f64>,
    /// Its sixth row: spin about the tip axis.
    pub j_omega_z: RowVector6<f64>,
    /// Derivative of the mean tissue displacement.
    pub j_stretch: RowVector6<f64>,
    /// Desired tip velocity, tip axes \[m/s\].
    pub tip_velocity: Vector3<f64>,
    /// Desired spin \[rad/s\].
    pub spin: f64,
    /// Mean tissue displacement d_m \[m\].
    pub stretch: f64,
    /// Gain of its reduction \[1/s\].
    pub stretch_gain: f64,
}

impl Tasks {
    /// The same tasks for a base twist whose angular part is counted in metres, omega times
    /// `length` \[m\]: what makes a minimum norm of metres and radians meaningful.
    #[must_use]
    pub fn scaled(&self, length: f64) -> Self {
        let mut s = *self;
        s.j_v.fixed_columns_mut::<3>(3).unscale_mut(length);
        s.j_omega_z.fixed_columns_mut::<3>(3).unscale_mut(length);
        s.j_stretch.fixed_columns_mut::<3>(3).unscale_mut(length);
        s
    }

    /// Tip velocity and spin that a base twist gives.
    pub fn achieved(&self, base_twist: &Vector6<f64>) -> (Vector3<f64>, f64) {
        (
            self.j_v * base_twist,
            (self.j_omega_z * base_twist).to_scalar(),
        )
    }
}

/// Base twist of the three prioritised tasks: Eq. (17).
///
/// # Deviation
/// As printed, the second task enters with the pseudo-inverse of its own row projected
/// afterwards, so that it is disturbed by, but does not disturb, the first; kept as printed.
pub fn prioritised_twist(tasks: &Tasks) -> Vector6<f64> {
    let j_v_inverse: Matrix6x3<f64> = pseudo_inverse(&tasks.j_v);
    let p_1 = first_projector(&tasks.j_v);
    let p_12 = second_projector(&augmented_jacobian(&tasks.j_v, &tasks.j_omega_z));
    j_v_inverse * tasks.tip_velocity + p_1 * pseudo_inverse(&tasks.j_omega_z) * tasks.spin
        - tasks.stretch_gain * p_12 * pseudo_inverse(&tasks.j_stretch) * tasks.stretch
}

/// The stretch reduction alone, solved inside the null space of the first two tasks and bounded
/// by `epsilon`: `-gain P J^T (J P J^T + epsilon)^-1 d_m`. Unlike the third term of eq. (17) it
/// stays bounded where d_m has its minimum.
pub fn damped_stretch_reduction(tasks: &Tasks, epsilon: f64) -> Vector6<f64> {
    let p_12 = second_projector(&augmented_jacobian(&tasks.j_v, &tasks.j_omega_z));
    let direction = p_12 * tasks.j_stretch.transpose();
    let gain = (tasks.j_stretch * direction).to_scalar() + epsilon;
    direction * (-tasks.stretch_gain * tasks.stretch / gain)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tasks_from(x: &[f64]) -> Tasks {
        Tasks {
            j_v: Matrix3x6::from_iterator(x[..18].iter().copied()),
            j_omega_z: RowVector6::from_iterator(x[18..24].iter().copied()),
            j_stretch: RowVector6::from_iterator(x[24..30].iter().copied()),
            tip_velocity: Vector3::new(x[30], x[31], x[32]),
            spin: x[33],
            stretch: x[34].abs(),
            stretch_gain: 1.0,
        }
    }

    /// Random tasks; `rank` below 3 makes rows of the first task dependent.
    fn any_tasks() -> impl Strategy<Value = Tasks> {
        (prop::collection::vec(-1.0_f64..1.0, 35), 1..=3_usize).prop_map(|(x, rank)| {
            let mut tasks = tasks_from(&x);
            for row in rank..3 {
                let copy = tasks.j_v.row(0) * (row as f64 + 0.5);
                tasks.j_v.set_row(row, &copy);
            }
            tasks
        })
    }

    proptest! {
        #![proptest_config(crate::seeded())]

        #[test]
        fn pseudo_inverse_has_the_four_penrose_properties(tasks in any_tasks()) {
            let (a, x) = (tasks.j_v, pseudo_inverse(&tasks.j_v));
            let scale = 1.0 + x.norm();
            prop_assert!((a * x * a - a).norm() < 1e-9 * scale);
            prop_assert!((x * a * x - x).norm() < 1e-9 * scale * scale);
            prop_assert!(((a * x).transpose() - a * x).norm() < 1e-9 * scale);
            prop_assert!(((x * a).transpose() - x * a).norm() < 1e-9 * scale);
        }

        #[test]
        fn projectors_are_orthogonal_and_annihilated(tasks in any_tasks()) {
            let p_1 = first_projector(&tasks.j_v);
            let j_12 = augmented_jacobian(&tasks.j_v, &tasks.j_omega_z);
            let p_12 = second_projector(&j_12);
            for (p, size) in [(p_1, (tasks.j_v * p_1).norm()), (p_12, (j_12 * p_12).norm())] {
                prop_assert!((p * p - p).norm() < 1e-9);
                prop_assert!((p - p.transpose()).norm() < 1e-9);
                prop_assert!(size < 1e-9);
            }
        }

        /// Strict priority: switching lower tasks on does not move what higher ones get.
        #[test]
        fn lower_tasks_never_disturb_higher_ones(tasks in any_tasks(), scale in 0.05_f64..1.0) {
            let tasks = tasks.scaled(scale);
            let first = Tasks { spin: 0.0, stretch: 0.0, ..tasks };
            let second = Tasks { stretch: 0.0, ..tasks };
            let size = 1.0 + prioritised_twist(&tasks).norm();
            let (v_alone, _) = tasks.achieved(&prioritised_twist(&first));
            let (v_two, spin_two) = tasks.achieved(&prioritised_twist(&second));
            let (v_all, spin_all) = tasks.achieved(&prioritised_twist(&tasks));
            prop_assert!((v_two - v_alone).norm() < 1e-8 * size);
            prop_assert!((v_all - v_alone).norm() < 1e-8 * size);
            prop_assert!((spin_all - spin_two).abs() < 1e-8 * size);
            let damped = damped_stretch_reduction(&tasks, 1e-2);
            let (v, spin) = tasks.achieved(&damped);
            prop_assert!(v.norm() < 1e-8 * size && spin.abs() < 1e-8 * size);
            prop_assert!((tasks.j_stretch * damped).to_scalar() <= 1e-12);
        }

        /// A feasible first task is met exactly.
        #[test]
        fn a_task_of_full_rank_is_met(x in prop::collection::vec(-1.0_f64..1.0, 35)) {
            let tasks = tasks_from(&x);
            let inverse = pseudo_inverse(&tasks.j_v);
            prop_assume!(inverse.norm() < 1e3);
            let (v, _) = tasks.achieved(&prioritised_twist(&tasks));
            prop_assert!((v - tasks.tip_velocity).norm() < 1e-8 * (1.0 + inverse.norm()));
        }
    }

    #[test]
    fn zeros_and_non_finite_matrices_give_zeros() {
        assert_eq!(pseudo_inverse(&Matrix3x6::zeros()), Matrix6x3::zeros());
        let bad = Matrix3x6::from_element(f64::NAN);
        assert_eq!(pseudo_inverse(&bad), Matrix6x3::zeros());
    }
}
