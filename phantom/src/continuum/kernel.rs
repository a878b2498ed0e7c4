//! How far tissue yields at one place to a force at another: an elastic half-space.

use nalgebra::{DMatrix, Vector3};

/// A piece of shaft in the tissue, in the phantom frame at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Source {
    /// Its node \[m\]; z is the depth below the free surface.
    pub(crate) place: Vector3<f64>,
    /// Length of shaft that it stands for \[m\].
    pub(crate) length: f64,
}

/// Incompressible half-space with a free surface at z = 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HalfSpace {
    /// Shear modulus \[Pa\].
    pub(crate) shear: f64,
    /// Radius of the shaft, within which a force is spread \[m\].
    pub(crate) radius: f64,
}

impl HalfSpace {
    /// Mindlin's displacement along a lateral force of 1 N at depth `c`, seen at depth `z`, both on
    /// a line into the half-space `apart` from each other, for Poisson's ratio 1/2 \[m/N\]:
    /// `(1/R1 + 1/R2 + 2 c z / R2^3) / (8 pi G)`. The force is spread over the shaft's girth, so
    /// that R1 never falls below its radius.
    pub(crate) fn lateral(&self, apart: f64, c: f64, z: f64) -> f64 {
        let direct = apart.hypot(self.radius);
        self.scale() * (1.0 / direct + self.image(c, z))
    }

    /// The free surface's part.
    fn image(&self, c: f64, z: f64) -> f64 {
        let image = (z + c).hypot(self.radius);
        1.0 / image + 2.0 * c * z / image.powi(3)
    }

    /// The same at the middle of a piece of `length` over which the force is spread \[m/N\].
    fn own(&self, depth: f64, length: f64) -> f64 {
        let direct = 2.0 / length * (0.5 * length / self.radius).asinh();
        self.scale() * (direct + self.image(depth, depth))
    }

    fn scale(&self) -> f64 {
        1.0 / (8.0 * core::f64::consts::PI * self.shear)
    }

    /// Flexibility of all `sources` together \[m/N\]; `whole` is the length of a piece that lies all
    /// in the tissue: one that is still entering yields as much more as it is shorter.
    pub(crate) fn flexibility(&self, sources: &[Source], whole: f64) -> DMatrix<f64> {
        let n = sources.len();
        let mut out = DMatrix::zeros(n, n);
        for i in 0..n {
            let a = &sources[i];
            let depth = a.place.z.max(0.0);
            out[(i, i)] = self.own(depth, whole) * whole / a.length;
            for j in 0..i {
                let b = &sources[j];
                let apart = (a.place - b.place).norm();
                let value = self.lateral(apart, depth, b.place.z.max(0.0));
                out[(i, j)] = value;
                out[(j, i)] = value;
            }
        }
        out
    }

    /// Energy stored, per length that the whole shaft slides in at given displacements, while the
    /// lateral `forces` act on it \[N\]: deeper tissue is stiffer, and more shaft is held.
    pub(crate) fn entering(&self, sources: &[Source], whole: f64, forces: &[Vector3<f64>]) -> f64 {
        /// Slide of the difference quotient \[m\].
        const SLIDE: f64 = 1e-6;
        let mut energy = 0.0;
        for (i, (a, f)) in sources.iter().zip(forces).enumerate() {
            let depth = a.place.z.max(0.0);
            for (b, g) in sources[..i].iter().zip(forces) {
                let other = b.place.z.max(0.0);
                let change = self.image(depth + SLIDE, other + SLIDE) - self.image(depth, other);
                energy -= f.dot(g) * self.scale() * change / SLIDE;
            }
            let share = whole / a.length;
            let change = self.image(depth + SLIDE, depth + SLIDE) - self.image(depth, depth);
            energy -= 0.5 * f.norm_squared() * share * self.scale() * change / SLIDE;
            // The piece that enters grows.
            if i == 0 && a.length < whole {
                energy += 0.5 * f.norm_squared() * self.own(depth, whole) * share / a.length;
            }
        }
        energy
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GEL: HalfSpace = HalfSpace {
        shear: 4e3,
        radius: 0.35e-3,
    };

    /// A force on the surface is Cerruti's: u = Q / (4 pi G z) straight below it.
    #[test]
    fn on_the_surface_it_is_cerrutis_solution() {
        for z in [5e-3, 20e-3, 80e-3] {
            let exact = 1.0 / (4.0 * core::f64::consts::PI * 4e3 * z);
            let found = GEL.lateral(z, 0.0, z);
            assert!((found / exact - 1.0).abs() < 5e-3, "{found} {exact}");
        }
    }

    /// Deep inside it is Kelvin's: u = Q / (8 pi G r) along the line across the force.
    #[test]
    fn deep_inside_it_is_kelvins_solution() {
        let exact = 1.0 / (8.0 * core::f64::consts::PI * 4e3 * 5e-3);
        let found = GEL.lateral(5e-3, 10.0, 10.005);
        assert!((found / exact - 1.0).abs() < 5e-3, "{found} {exact}");
    }

    fn shaft(first: f64, start: f64) -> Vec<Source> {
        (0..60)
            .map(|i| Source {
                place: Vector3::new(0.0, 0.0, start + 2e-3 * f64::from(i)),
                length: if i == 0 { first } else { 2e-3 },
            })
            .collect()
    }

    /// Tissue gives back no more than was put in: every flexibility is positive definite, also
    /// with a piece that has hardly entered.
    #[test]
    fn it_stores_energy() {
        for first in [1e-9, 0.3e-3, 2e-3] {
            let sources = shaft(first, 0.5 * first);
            assert!(GEL.flexibility(&sources, 2e-3).cholesky().is_some());
        }
    }

    /// The force that resists entering is the slope of the stored energy.
    #[test]
    fn entering_takes_the_energy_that_is_stored() {
        let displaced = |i: u16| Vector3::new(1e-3 - 2e-5 * f64::from(i), 5e-4, 0.0);
        let solve = |slid: f64| {
            let sources = shaft(0.8e-3 + slid, slid);
            let stiffness = GEL
                .flexibility(&sources, 2e-3)
                .cholesky()
                .unwrap()
                .inverse();
            let forces: Vec<Vector3<f64>> = (0..60_u16)
                .map(|i| {
                    (0..60_u16)
                        .map(|j| displaced(j) * stiffness[(usize::from(i), usize::from(j))])
                        .sum()
                })
                .collect();
            let energy: f64 = (0..60_u16)
                .map(|i| 0.5 * displaced(i).dot(&forces[usize::from(i)]))
                .sum();
            (energy, GEL.entering(&sources, 2e-3, &forces))
        };
        let step = 1e-5;
        let slope = (solve(step).0 - solve(0.0).0) / step;
        let said = solve(0.5 * step).1;
        assert!((said / slope - 1.0).abs() < 1e-3, "{said} {slope}");
    }
}
