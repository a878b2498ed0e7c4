//! What a device can do with the needle's base.
//!
//! An arm of six joints gives every twist; a stage shifts, inserts and spins, and nothing else.
//! Laws ask here for what there is and leave out the rest. A twist that a device cannot give is not
//! commanded in part: what a stage makes of a pivot is a shift, which steers the other way.

use hal::Twist;
use nalgebra::{Matrix6, SMatrix, SymmetricEigen, Vector6};

/// Length by which linear velocities are divided to compare with angular ones \[m\].
const LENGTH: f64 = 0.1;
/// Size of a motion for unit joint rates, so scaled, below which a device does not give it.
const GIVEN_FROM: f64 = 0.05;
/// Share of a twist that a device may fail to give and that counts as given: a needle held a degree
/// and a half off an axis.
const MISSED: f64 = 0.03;

/// The twists of the needle's base (origin, World) that a device can give where it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Freedom {
    /// Projector onto what it cannot give, linear velocities divided by [`LENGTH`].
    lost: Matrix6<f64>,
}

impl Freedom {
    /// Every twist.
    pub fn full() -> Self {
        Self {
            lost: Matrix6::zeros(),
        }
    }

    /// The combinations of `twists`, one of each joint at 1 rad/s or 0.1 m/s.
    pub fn of(twists: impl IntoIterator<Item = Twist>) -> Self {
        let gram = twists.into_iter().fold(Matrix6::zeros(), |sum, twist| {
            let column = scaled(&twist);
            sum + column * column.transpose()
        });
        let modes = SymmetricEigen::new(gram);
        let mut lost = Matrix6::zeros();
        for (squared, mode) in modes
            .eigenvalues
            .iter()
            .zip(modes.eigenvectors.column_iter())
        {
            if *squared < GIVEN_FROM * GIVEN_FROM {
                lost += mode * mode.transpose();
            }
        }
        Self { lost }
    }

    /// Whether every twist is given.
    pub fn is_full(&self) -> bool {
        self.lost == Matrix6::zeros()
    }

    /// Whether the device gives `twist`.
    pub fn gives(&self, twist: &Twist) -> bool {
        let twist = scaled(twist);
        (self.lost * twist).norm() <= MISSED * twist.norm()
    }

    /// Orthogonal projector onto those combinations of `twists` that the device gives.
    pub fn within<const M: usize>(&self, twists: &[Twist; M]) -> SMatrix<f64, M, M> {
        let mut lost = SMatrix::<f64, 6, M>::zeros();
        let mut size = 0.0_f64;
        for (i, twist) in twists.iter().enumerate() {
            let column = scaled(twist);
            size = size.max(column.norm());
            lost.set_column(i, &(self.lost * column));
        }
        let mut free = SMatrix::<f64, M, M>::identity();
        // The direction that is lost most is taken out first; at most M times.
        for _ in 0..M {
            let rows = lost * free;
            let row = (0..6)
                .map(|i| rows.row(i).transpose())
                .max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()));
            let Some(direction) = row.filter(|row| row.norm() > MISSED * size) else {
                break;
            };
            let unit = direction.normalize();
            free -= unit * unit.transpose();
        }
        free
    }
}

/// \[linear over [`LENGTH`]; angular\].
fn scaled(twist: &Twist) -> Vector6<f64> {
    let mut vector = twist.to_vector();
    vector.fixed_rows_mut::<3>(0).unscale_mut(LENGTH);
    vector
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn slide(axis: Vector3<f64>) -> Twist {
        Twist {
            linear: axis * LENGTH,
            angular: Vector3::zeros(),
        }
    }

    fn turn(axis: Vector3<f64>, arm: Vector3<f64>) -> Twist {
        Twist {
            linear: axis.cross(&arm),
            angular: axis,
        }
    }

    #[test]
    fn a_stage_shifts_inserts_and_spins_and_does_not_pivot() {
        let spin = turn(Vector3::z(), Vector3::zeros());
        let slides = [Vector3::x(), Vector3::y(), Vector3::z()].map(slide);
        let stage = Freedom::of(slides.into_iter().chain([spin]));
        let pivot = turn(Vector3::x(), Vector3::new(0.0, 0.0, -0.12));
        assert!(!stage.is_full() && !stage.gives(&pivot));
        assert!(stage.gives(&slides[0]) && stage.gives(&spin));
        let free = stage.within(&[pivot, slides[0], slides[1]]);
        let expected = nalgebra::Matrix3::from_diagonal(&Vector3::new(0.0, 1.0, 1.0));
        assert!((free - expected).norm() < 1e-12, "{free}");
    }

    #[test]
    fn a_joint_beside_the_entry_gives_a_pivot_with_its_shift() {
        // It turns about x, 20 mm above the entry; the base is 120 mm above the entry.
        let joint = turn(Vector3::x(), Vector3::new(0.0, 0.0, -0.10));
        let device = Freedom::of([joint, slide(Vector3::z())]);
        let pivot = turn(Vector3::x(), Vector3::new(0.0, 0.0, -0.12));
        let shift = slide(Vector3::y());
        let free = device.within(&[pivot, shift]);
        // pivot - 0.2 shift is what there is: 0.12 - 0.10 m of 0.1 m.
        let there = nalgebra::Vector2::new(1.0, -0.2).normalize();
        assert!(
            (free - there * there.transpose()).norm() < 1e-9,
            "{free} {there}"
        );
        assert!(!device.gives(&pivot) && device.gives(&joint));
    }

    #[test]
    fn six_joints_give_everything() {
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        let turns = axes.map(|axis| turn(axis, Vector3::new(0.1, 0.2, 0.0)));
        assert!(Freedom::of(axes.map(slide).into_iter().chain(turns)).is_full());
        assert!(Freedom::full().is_full());
    }
}
