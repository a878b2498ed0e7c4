//! The bevelled tip: its geometry (fig. 1b), the cut angle and the load of eq. (3).
//!
//! The bevel faces `+y_tip`; its point and bottom edge are on the `-y_tip` side, so a fresh cut
//! pushes the tip towards `-y_tip` (the *bevel direction*).

use nalgebra::Vector3;
use thiserror::Error;

/// Geometry of the bevel (fig. 1b).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bevel {
    angle: f64,
    length: f64,
    bottom_edge: f64,
}

/// Why a bevel was refused.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum BevelError {
    /// Angle outside ]0, pi/2[.
    #[error("bevel angle must lie between 0 and pi/2 rad, got {angle_rad}")]
    Angle {
        /// Offending angle \[rad\].
        angle_rad: f64,
    },
    /// Bevel length not finite or not positive.
    #[error("bevel length_m must be finite and positive, got {length_m}")]
    Length {
        /// Offending length \[m\].
        length_m: f64,
    },
    /// Bottom edge not finite or not positive.
    #[error("bevel bottom_edge_m must be finite and positive, got {bottom_edge_m}")]
    BottomEdge {
        /// Offending length \[m\].
        bottom_edge_m: f64,
    },
}

/// Resultant of the tissue on the tip at O, in the signs of eq. (3).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BevelLoad {
    /// Force F_tip along `y_tip` \[N\]; negative on a fresh cut.
    pub force: f64,
    /// Moment M_tip \[N m\]; it bends the needle towards `-y_tip` when positive (eq. 11).
    pub moment: f64,
}

impl Bevel {
    /// A bevel of angle alpha \[rad\], length b and bottom edge a \[m\].
    ///
    /// # Errors
    /// [`BevelError`] names the first value out of its range.
    pub fn new(angle: f64, length: f64, bottom_edge: f64) -> Result<Self, BevelError> {
        if !(angle > 0.0 && angle < std::f64::consts::FRAC_PI_2) {
            return Err(BevelError::Angle { angle_rad: angle });
        }
        if !(length.is_finite() && length > 0.0) {
            return Err(BevelError::Length { length_m: length });
        }
        if !(bottom_edge.is_finite() && bottom_edge > 0.0) {
            return Err(BevelError::BottomEdge {
                bottom_edge_m: bottom_edge,
            });
        }
        Ok(Self {
            angle,
            length,
            bottom_edge,
        })
    }

    /// The bevel that a plane at `angle` \[rad\] cuts on a shaft of `diameter` \[m\]:
    /// b = d / sin(alpha), a = d / tan(alpha).
    ///
    /// # Errors
    /// [`BevelError`] when `angle` or the lengths that follow are out of range.
    pub fn plane_cut(angle: f64, diameter: f64) -> Result<Self, BevelError> {
        Self::new(angle, diameter / angle.sin(), diameter / angle.tan())
    }

    /// Bevel angle alpha \[rad\].
    pub const fn angle(&self) -> f64 {
        self.angle
    }

    /// Bevel length b \[m\].
    pub const fn length(&self) -> f64 {
        self.length
    }

    /// Length a of the bottom edge \[m\].
    pub const fn bottom_edge(&self) -> f64 {
        self.bottom_edge
    }

    /// Force \[N\] and moment \[N m\] of the tissue on the bevel, at O: Eq. (3).
    ///
    /// `k_t`: stiffness of the tissue per length \[N/m2\]; `beta`: cut angle \[rad\].
    ///
    /// # Deviation
    /// `beta` is clamped to \[0, alpha\]: outside, one of the two triangular loads would pull.
    pub fn load(&self, k_t: f64, beta: f64) -> BevelLoad {
        let (alpha, a, b) = (self.angle, self.bottom_edge, self.length);
        let beta = beta.clamp(0.0, alpha);
        let edge = k_t * a * a / 2.0 * beta.tan();
        let face = k_t * b * b / 2.0 * (alpha - beta).tan();
        BevelLoad {
            force: edge - face * alpha.cos(),
            moment: -edge * a / 3.0
                + face * (a / 3.0 * alpha.cos() - b / 6.0 * alpha.sin().powi(2)),
        }
    }
}

/// Signed cut angle beta \[rad\]: between the tip axis and the `chord` of the cut path that ends at
/// the tip, in the plane (`y_tip`, `tip_axis`), positive towards the bevel direction `-y_tip`.
///
/// Not clamped; 0 for a zero chord. The paper uses beta without defining it.
pub fn cut_angle(chord: &Vector3<f64>, tip_axis: &Vector3<f64>, y_tip: &Vector3<f64>) -> f64 {
    (-y_tip.dot(chord)).atan2(tip_axis.dot(chord))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The triangular loads of fig. 1b integrated numerically along edge and face.
    fn integrated(bevel: &Bevel, k_t: f64, beta: f64) -> BevelLoad {
        let (alpha, a, b) = (bevel.angle(), bevel.bottom_edge(), bevel.length());
        let n = 20_000;
        let (mut force, mut bending) = (0.0, 0.0);
        for i in 0..n {
            let u = (f64::from(i) + 0.5) / f64::from(n);
            // Edge: zero at the point, largest at O, pushing towards +y at u a from the point.
            let edge = k_t * beta.tan() * (u * a) * a / f64::from(n);
            force += edge;
            bending += edge * (a - u * a);
            // Face: zero at the point, growing along the face; normal to the face.
            let face = k_t * (alpha - beta).tan() * (u * b) * b / f64::from(n);
            force -= face * alpha.cos();
            let axial = a - u * b * alpha.cos();
            // The face starts on the -y side (the point) and climbs to +y; O is at mid height.
            let height = -b * alpha.sin() / 2.0 + u * b * alpha.sin();
            bending -= face * (alpha.cos() * axial - alpha.sin() * height);
        }
        BevelLoad {
            force,
            moment: -bending,
        }
    }

    #[test]
    fn load_is_the_integral_of_the_triangles() {
        let bevel = Bevel::plane_cut(24_f64.to_radians(), 0.7e-3).unwrap();
        for beta in [0.0, 0.1, 0.3, 24_f64.to_radians()] {
            let (formula, integral) = (bevel.load(1e4, beta), integrated(&bevel, 1e4, beta));
            assert!((formula.force - integral.force).abs() < 1e-9, "{beta}");
            assert!(
                (formula.moment - integral.moment).abs() < 1e-12,
                "{formula:?} {integral:?}"
            );
        }
    }

    #[test]
    fn cut_angle_is_clamped_in_the_load_only() {
        let bevel = Bevel::plane_cut(0.4, 0.7e-3).unwrap();
        assert_eq!(bevel.load(1e4, -0.3), bevel.load(1e4, 0.0));
        assert_eq!(bevel.load(1e4, 1.2), bevel.load(1e4, 0.4));
        let beta = cut_angle(&Vector3::new(0.0, -1.0, 1.0), &Vector3::z(), &Vector3::y());
        assert!((beta - std::f64::consts::FRAC_PI_4).abs() < 1e-15);
    }

    #[test]
    fn a_fresh_cut_pushes_in_the_bevel_direction() {
        let bevel = Bevel::plane_cut(0.4, 0.7e-3).unwrap();
        assert!(bevel.load(1e4, 0.0).force < 0.0);
    }
}
