//! Rotations and translations as files hold them.

use nalgebra::{DMatrix, Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

/// A rotation matrix further from orthonormal than this is none: four printed decimals are off
/// by 1e-4, and a typing error by more than a hundred times that.
const NO_ROTATION: f64 = 1e-2;
/// Up to here a matrix is orthonormal but for rounding, which is not worth a word.
pub(super) const ROUNDING: f64 = 1e-6;

/// The nearest rotation to a matrix of 3 x 3, or that of a vector of three (axis times angle),
/// and how far the matrix was from it (greatest entry of R R^T - 1). `None` if it is no rotation.
pub(super) fn rotation(m: &DMatrix<f64>) -> Option<(UnitQuaternion<f64>, f64)> {
    if m.len() == 3 {
        let turn = Vector3::from_column_slice(m.as_slice());
        return Some((UnitQuaternion::from_scaled_axis(turn), 0.0));
    }
    let m = three(m)?;
    let off = (m * m.transpose() - Matrix3::identity()).amax();
    if !(off < NO_ROTATION && m.determinant() > 0.0) {
        return None;
    }
    // One already orthonormal stays as it is, to the last digit.
    let nearest = if off < 1e-14 {
        m
    } else {
        let svd = m.svd(true, true);
        svd.u? * svd.v_t?
    };
    let rotation = Rotation3::from_matrix_unchecked(nearest);
    Some((UnitQuaternion::from_rotation_matrix(&rotation), off))
}

/// A matrix of 3 x 3, also as a list of nine.
pub(super) fn three(m: &DMatrix<f64>) -> Option<Matrix3<f64>> {
    match m.shape() {
        (3, 3) => Some(Matrix3::from_column_slice(m.as_slice())),
        (9, 1) => Some(Matrix3::from_row_slice(m.as_slice())),
        _ => None,
    }
}

/// A rigid transform of 4 x 4 or 3 x 4, also as a list, and how far its rotation was from one.
pub(super) fn transform(m: &DMatrix<f64>) -> Option<(Isometry3<f64>, f64)> {
    let m = match m.shape() {
        (4 | 3, 4) => m.clone(),
        (16 | 12, 1) => DMatrix::from_row_slice(m.len() / 4, 4, m.as_slice()),
        _ => return None,
    };
    let (turn, off) = rotation(&m.view((0, 0), (3, 3)).into_owned())?;
    let shift = Vector3::new(m[(0, 3)], m[(1, 3)], m[(2, 3)]);
    Some((Isometry3::from_parts(shift.into(), turn), off))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_decimals_make_a_rotation_and_a_wrong_sign_does_not() {
        let mut m = DMatrix::from_row_slice(
            3,
            3,
            &[0.9553, 0.0, 0.2955, 0.0, 1.0, 0.0, -0.2955, 0.0, 0.9553],
        );
        let (turn, off) = rotation(&m).unwrap();
        assert!((turn.angle() - 0.3).abs() < 1e-4 && off > 1e-6 && off < 1e-3);
        m[(2, 0)] = 0.2955;
        assert!(rotation(&m).is_none());
    }
}
