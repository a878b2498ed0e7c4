//! The paper's tasks: tip velocity, bevel orientation, and the way of insertion.

use core::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use nalgebra::{Matrix6, Vector3, Vector6};

use crate::priority::pseudo_inverse;

/// Translational velocity of the tip \[m/s\] by a base twist: Eq. (13).
///
/// `j_tip_base` is the manipulation Jacobian of eq. (12), tip twist in the axes of the tip.
pub fn tip_velocity(j_tip_base: &Matrix6<f64>, base_twist: &Vector6<f64>) -> Vector3<f64> {
    j_tip_base.fixed_rows::<3>(0) * base_twist
}

/// Angle sigma from the desired to the present bevel orientation \[rad\], not wrapped: Eq. (14).
///
/// `desired` is the desired tip velocity in the tip frame; the bevel direction is -y.
pub fn bevel_angle(desired: &Vector3<f64>) -> f64 {
    -FRAC_PI_2 - desired.y.atan2(desired.x)
}

/// Smoothed sliding mode: the spin \[rad/s\] that takes sigma to zero: Eq. (15).
pub fn sliding_mode(sigma: f64, omega_z_max: f64) -> f64 {
    if sigma.abs() >= FRAC_PI_4 {
        -sigma.signum() * omega_z_max
    } else {
        -4.0 / PI * sigma * omega_z_max
    }
}

/// Desired tip velocity towards a target \[m/s\], in the tip frame: Eq. (25).
///
/// `target` is the target in the tip frame \[m\]; zero when the tip is on it.
///
/// # Deviation
/// The paper's 1 mm/s is the argument `speed`.
pub fn target_velocity(target: &Vector3<f64>, speed: f64) -> Vector3<f64> {
    let distance = target.norm();
    if distance > 0.0 {
        target * (speed / distance)
    } else {
        Vector3::zeros()
    }
}

/// Base twist that inserts the tip axially by one metre a second with the least motion: the
/// pseudo-inverse of the third row of the manipulation Jacobian (section III.B).
pub fn insertion_direction(j_tip_base: &Matrix6<f64>) -> Vector6<f64> {
    pseudo_inverse(&j_tip_base.fixed_rows::<1>(2).into_owned())
}

/// An angle wrapped into (-pi, pi\] \[rad\].
pub fn wrap(angle: f64) -> f64 {
    let turns = (angle + PI).rem_euclid(2.0 * PI) - PI;
    if turns <= -PI { PI } else { turns }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    #[test]
    fn bevel_facing_the_desired_direction_is_zero() {
        // The bevel direction is -y.
        assert!(bevel_angle(&Vector3::new(0.0, -1.0, 5.0)).abs() < 1e-15);
        assert!((wrap(bevel_angle(&Vector3::new(0.0, 1.0, 5.0))).abs() - PI).abs() < 1e-15);
    }

    #[test]
    fn target_velocity_points_at_the_target() {
        let v = target_velocity(&Vector3::new(3e-3, 0.0, 4e-3), 1e-3);
        assert!((v - Vector3::new(0.6e-3, 0.0, 0.8e-3)).norm() < 1e-18);
        assert_eq!(target_velocity(&Vector3::zeros(), 1e-3), Vector3::zeros());
    }

    #[test]
    fn insertion_of_a_rigid_needle_is_along_its_axis() {
        let v = insertion_direction(&Matrix6::identity());
        assert!((v - Vector6::new(0.0, 0.0, 1.0, 0.0, 0.0, 0.0)).norm() < 1e-15);
    }

    proptest! {
        #![proptest_config(crate::seeded())]

        /// Turning the tip by the sliding mode's sense reduces |sigma|.
        #[test]
        fn sliding_mode_reduces_the_bevel_error(angle in -3.1_f64..3.1, step in 1e-3_f64..0.02) {
            let desired = Vector3::new(angle.cos(), angle.sin(), 3.0);
            let sigma = wrap(bevel_angle(&desired));
            prop_assume!(sigma.abs() > step && sigma.abs() < PI - step);
            let turn = sliding_mode(sigma, 1.0).signum() * step;
            let seen = Rotation3::from_axis_angle(&Vector3::z_axis(), turn).inverse() * desired;
            prop_assert!(wrap(bevel_angle(&seen)).abs() < sigma.abs());
            prop_assert!(sliding_mode(sigma, 1.0).abs() <= 1.0);
        }

        #[test]
        fn tip_velocity_is_the_upper_half(entries in prop::collection::vec(-1.0_f64..1.0, 42)) {
            let j = Matrix6::from_iterator(entries[..36].iter().copied());
            let v = Vector6::from_iterator(entries[36..].iter().copied());
            prop_assert!((tip_velocity(&j, &v) - (j * v).fixed_rows::<3>(0)).norm() < 1e-14);
        }
    }
}
