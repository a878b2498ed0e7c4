//! The needle's own geometry and stiffness.

use thiserror::Error;

/// A uniform hollow circular needle: the part that can bend, from the holder to the tip centre O.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Needle {
    length: f64,
    outer_diameter: f64,
    inner_diameter: f64,
    young_modulus: f64,
}

/// Why a needle was refused.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum NeedleError {
    /// Length not finite or not positive.
    #[error("needle length_m must be finite and positive, got {length_m}")]
    Length {
        /// Offending length \[m\].
        length_m: f64,
    },
    /// Outer diameter not finite or not positive.
    #[error("needle outer_diameter_m must be finite and positive, got {outer_diameter_m}")]
    OuterDiameter {
        /// Offending diameter \[m\].
        outer_diameter_m: f64,
    },
    /// Inner diameter not finite, negative, or not below the outer one.
    #[error(
        "needle inner_diameter_m must be finite, at least 0 and below outer_diameter_m \
         {outer_diameter_m}, got {inner_diameter_m}"
    )]
    InnerDiameter {
        /// Offending diameter \[m\].
        inner_diameter_m: f64,
        /// Outer diameter \[m\].
        outer_diameter_m: f64,
    },
    /// Young's modulus not finite or not positive.
    #[error("needle young_modulus_pa must be finite and positive, got {young_modulus_pa}")]
    YoungModulus {
        /// Offending modulus \[Pa\].
        young_modulus_pa: f64,
    },
    /// Values each in its range that together give no bending stiffness, or an infinite one.
    #[error(
        "needle outer_diameter_m, inner_diameter_m and young_modulus_pa give a bending stiffness of \
         {stiffness_nm2} N m2; it must be finite and positive"
    )]
    Stiffness {
        /// Bending stiffness \[N m2\].
        stiffness_nm2: f64,
    },
}

impl Needle {
    /// A needle of `length` \[m\], `outer_diameter` and `inner_diameter` \[m\] (0: a full wire) and
    /// `young_modulus` \[Pa\].
    ///
    /// # Errors
    /// [`NeedleError`] names the first value that is not finite or out of its range.
    pub fn new(
        length: f64,
        outer_diameter: f64,
        inner_diameter: f64,
        young_modulus: f64,
    ) -> Result<Self, NeedleError> {
        let positive = |v: f64| v.is_finite() && v > 0.0;
        if !positive(length) {
            return Err(NeedleError::Length { length_m: length });
        }
        if !positive(outer_diameter) {
            return Err(NeedleError::OuterDiameter {
                outer_diameter_m: outer_diameter,
            });
        }
        if !(inner_diameter >= 0.0 && inner_diameter < outer_diameter) {
            return Err(NeedleError::InnerDiameter {
                inner_diameter_m: inner_diameter,
                outer_diameter_m: outer_diameter,
            });
        }
        if !positive(young_modulus) {
            return Err(NeedleError::YoungModulus {
                young_modulus_pa: young_modulus,
            });
        }
        let needle = Self {
            length,
            outer_diameter,
            inner_diameter,
            young_modulus,
        };
        let stiffness_nm2 = needle.bending_stiffness();
        if positive(stiffness_nm2) && stiffness_nm2.is_normal() {
            Ok(needle)
        } else {
            Err(NeedleError::Stiffness { stiffness_nm2 })
        }
    }

    /// The same needle with another length \[m\].
    ///
    /// # Errors
    /// [`NeedleError`] for a length that is not finite or not positive.
    pub fn with_length(&self, length: f64) -> Result<Self, NeedleError> {
        Self::new(
            length,
            self.outer_diameter,
            self.inner_diameter,
            self.young_modulus,
        )
    }

    /// The steel biopsy needle of \[Chevrie2016\], section IV.A: 126 mm free, 0.70 / 0.48 mm, 200 GPa.
    pub const fn biopsy() -> Self {
        Self {
            length: 0.126,
            outer_diameter: 0.7e-3,
            inner_diameter: 0.48e-3,
            young_modulus: 200e9,
        }
    }

    /// Arc length from the holder to O \[m\].
    pub const fn length(&self) -> f64 {
        self.length
    }

    /// Outer diameter \[m\].
    pub const fn outer_diameter(&self) -> f64 {
        self.outer_diameter
    }

    /// Inner diameter \[m\].
    pub const fn inner_diameter(&self) -> f64 {
        self.inner_diameter
    }

    /// Young's modulus \[Pa\].
    pub const fn young_modulus(&self) -> f64 {
        self.young_modulus
    }

    /// Bending stiffness E I \[N m2\].
    pub fn bending_stiffness(&self) -> f64 {
        self.young_modulus * second_moment_of_area(self.outer_diameter, self.inner_diameter)
    }
}

/// Second moment of area \[m4\] of a hollow circle of diameters `outer`, `inner` \[m\]: Eq. (10).
pub fn second_moment_of_area(outer: f64, inner: f64) -> f64 {
    std::f64::consts::PI / 64.0 * (outer.powi(4) - inner.powi(4))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_moment_matches_thin_ring_and_full_disc() {
        let full = second_moment_of_area(2.0, 0.0);
        assert!((full - std::f64::consts::FRAC_PI_4).abs() < 1e-15);
        // A ring of radius r and wall w tends to pi r^3 w; the remainder is (w/r)^2 / 4.
        let (r, w) = (1.0, 1e-4);
        let ring = second_moment_of_area(2.0 * r + w, 2.0 * r - w);
        assert!((ring / (std::f64::consts::PI * r.powi(3) * w) - 1.0).abs() < 1e-8);
    }

    #[test]
    fn biopsy_needle_has_the_published_stiffness() {
        // E I = 1.836e-3 N m2 for 0.70 / 0.48 mm steel, four digits.
        assert!((Needle::biopsy().bending_stiffness() - 1.836e-3).abs() < 0.5e-6);
    }

    #[test]
    fn bad_values_are_named() {
        assert!(matches!(
            Needle::new(0.0, 1.0, 0.5, 1.0),
            Err(NeedleError::Length { .. })
        ));
        assert!(matches!(
            Needle::new(f64::NAN, 1.0, 0.5, 1.0),
            Err(NeedleError::Length { .. })
        ));
        assert!(matches!(
            Needle::new(1.0, -1.0, 0.5, 1.0),
            Err(NeedleError::OuterDiameter { .. })
        ));
        assert!(matches!(
            Needle::new(1.0, 1.0, 1.0, 1.0),
            Err(NeedleError::InnerDiameter { .. })
        ));
        for (outer, young) in [(1e-90, 1e11), (1e80, 1e11)] {
            assert!(matches!(
                Needle::new(1.0, outer, 0.0, young),
                Err(NeedleError::Stiffness { .. })
            ));
        }
        let error = Needle::new(1.0, 1.0, 0.5, f64::INFINITY).unwrap_err();
        assert!(
            error.to_string().contains("young_modulus_pa") && error.to_string().contains("inf")
        );
    }
}
