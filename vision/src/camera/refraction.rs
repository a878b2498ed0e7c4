//! A flat window between air and gel: rays into the gel, and points of the gel to rays.
//!
//! Snell's law at both faces of a plane wall [Glassner1989, Treibitz2012]. Everything is given
//! in the camera's frame, whose origin is the pinhole.

use nalgebra::{Matrix3, Unit, Vector3};
use serde::{Deserialize, Serialize};

/// A flat transparent wall in front of a camera, with gel behind it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlatWindow {
    /// Normal of the wall in the camera's frame, from the camera into the gel.
    pub normal: Unit<Vector3<f64>>,
    /// Distance of the wall's outer face from the pinhole along the normal \[m\].
    pub distance: f64,
    /// Thickness of the wall \[m\].
    pub thickness: f64,
    /// Refractive index of the wall.
    pub wall_index: f64,
    /// Refractive index of the gel.
    pub gel_index: f64,
}

/// A window that cannot be.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum InvalidWindow {
    /// The outer face must be in front of the camera, the thickness not negative.
    #[error("window at {distance_m} m with thickness {thickness_m} m: need > 0 and >= 0")]
    Geometry {
        /// Distance of the outer face from the pinhole.
        distance_m: f64,
        /// Thickness of the wall.
        thickness_m: f64,
    },
    /// Indices of refraction below that of air.
    #[error("refractive indices wall {wall}, gel {gel} must lie in 1..4")]
    Index {
        /// Index of the wall.
        wall: f64,
        /// Index of the gel.
        gel: f64,
    },
}

/// A half line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it begins \[m\].
    pub origin: Vector3<f64>,
    /// Unit direction.
    pub direction: Vector3<f64>,
}

/// The direction in air under which a camera sees a point of the gel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowRay {
    /// Direction at the pinhole, of unit length along the window's normal.
    pub direction: Vector3<f64>,
    /// Derivative of that direction by the point \[1/m\].
    pub by_point: Matrix3<f64>,
}

impl FlatWindow {
    /// Checks that the window can be one.
    ///
    /// # Errors
    /// It is behind the camera, has a negative thickness, or an impossible index.
    pub fn validated(self) -> Result<Self, InvalidWindow> {
        let normal_finite = self.normal.iter().all(|x| x.is_finite());
        let in_front = self.distance > 0.0 && self.distance.is_finite();
        let solid = self.thickness >= 0.0 && self.thickness.is_finite();
        if !(in_front && solid && normal_finite) {
            return Err(InvalidWindow::Geometry {
                distance_m: self.distance,
                thickness_m: self.thickness,
            });
        }
        let possible = |n: f64| (1.0..4.0).contains(&n);
        if possible(self.wall_index) && possible(self.gel_index) {
            Ok(self)
        } else {
            Err(InvalidWindow::Index {
                wall: self.wall_index,
                gel: self.gel_index,
            })
        }
    }

    /// Follows the ray that leaves the pinhole along `direction` (any length) to the gel: it
    /// begins at the wall's inner face. `None` if it does not meet the window.
    pub fn ray_in_gel(&self, direction: &Vector3<f64>) -> Option<Ray> {
        let n = self.normal.as_ref();
        let air = direction.normalize();
        let cos = air.dot(n);
        if cos.is_nan() || cos <= 1e-6 {
            return None;
        }
        let wall = refract(&air, n, cos, 1.0 / self.wall_index);
        let gel = refract(&air, n, cos, 1.0 / self.gel_index);
        let origin = air * (self.distance / cos) + wall * (self.thickness / wall.dot(n));
        Some(Ray {
            origin,
            direction: gel,
        })
    }

    /// The direction in air under which `point` of the gel is seen, with its derivative.
    /// A point in front of the inner face is seen as if it touched it, with zero depth in the
    /// gel; `None` for a point beside or behind the camera that no ray can reach.
    pub fn direction_to(&self, point: &Vector3<f64>) -> Option<WindowRay> {
        let n = self.normal.as_ref();
        let along = point.dot(n);
        let radial = point - n * along;
        let rho = radial.norm();
        let depth = (along - self.distance - self.thickness).max(0.0);
        if !(rho.is_finite() && along > 0.0) {
            return None;
        }
        let layers = [
            (self.distance, 1.0),
            (self.thickness, self.wall_index),
            (depth, self.gel_index),
        ];
        let slope = solve_slope(&layers, rho);
        let (_, by_slope) = reach(&layers, slope);
        // Implicit derivatives of reach(slope, depth) = rho.
        let by_rho = 1.0 / by_slope;
        let by_depth = -tangent_in(self.gel_index, slope) * by_rho;
        let e = if rho > 0.0 {
            radial / rho
        } else {
            any_orthogonal(n)
        };
        let sideways = if rho > 1e-12 { slope / rho } else { by_rho };
        let by_point = e * (e * by_rho + n * by_depth).transpose()
            + (Matrix3::identity() - n * n.transpose() - e * e.transpose()) * sideways;
        Some(WindowRay {
            direction: n + e * slope,
            by_point,
        })
    }
}

/// Snell's law; `ratio` is the index before over the index behind, `cos` the cosine of incidence.
fn refract(air: &Vector3<f64>, n: &Vector3<f64>, cos: f64, ratio: f64) -> Vector3<f64> {
    let cos_t = (1.0 - ratio * ratio * (1.0 - cos * cos)).sqrt();
    air * ratio + n * (cos_t - ratio * cos)
}

/// Tangent of the refracted angle in a medium, for the tangent in air.
fn tangent_in(index: f64, slope: f64) -> f64 {
    slope / (index * index + (index * index - 1.0) * slope * slope).sqrt()
}

/// Radius reached through the layers for a slope in air, and its derivative.
fn reach(layers: &[(f64, f64); 3], slope: f64) -> (f64, f64) {
    let (mut rho, mut by_slope) = (0.0, 0.0);
    for &(depth, index) in layers {
        let n2 = index * index;
        let q = n2 + (n2 - 1.0) * slope * slope;
        let root = q.sqrt();
        rho += depth * slope / root;
        by_slope += depth * n2 / (q * root);
    }
    (rho, by_slope)
}

/// The slope in air that reaches radius `rho`. `reach` is concave and grows with the slope, so
/// that Newton's method from the unrefracted slope (too small) rises to the root monotonically.
fn solve_slope(layers: &[(f64, f64); 3], rho: f64) -> f64 {
    let total: f64 = layers.iter().map(|l| l.0).sum();
    let mut slope = rho / total;
    for _ in 0..30 {
        let (reached, by_slope) = reach(layers, slope);
        let step = (rho - reached) / by_slope;
        slope += step;
        if step.abs() <= 1e-14 * (1.0 + slope) {
            break;
        }
    }
    slope
}

fn any_orthogonal(n: &Vector3<f64>) -> Vector3<f64> {
    let axis = if n.x.abs() < 0.8 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    (axis - n * n.dot(&axis)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window() -> FlatWindow {
        FlatWindow {
            normal: Unit::new_normalize(Vector3::new(0.05, -0.08, 1.0)),
            distance: 0.44,
            thickness: 0.003,
            wall_index: 1.49,
            gel_index: 1.34,
        }
    }

    #[test]
    fn points_on_the_ray_are_seen_along_it() {
        let w = window();
        for direction in [
            Vector3::new(0.0, 0.0, 1.0),
            Vector3::new(0.15, -0.1, 1.0),
            w.normal.into_inner(),
            Vector3::new(-0.9, 0.4, 1.0),
        ] {
            let ray = w.ray_in_gel(&direction).unwrap();
            assert!((ray.direction.norm() - 1.0).abs() < 1e-14);
            let point = ray.origin + ray.direction * 0.07;
            let seen = w.direction_to(&point).unwrap().direction;
            let error = seen.normalize().cross(&direction.normalize()).norm();
            assert!(error < 1e-13, "{error}");
        }
    }

    #[test]
    fn the_path_is_the_shortest_in_time() {
        // Fermat: an independent statement of Snell's law.
        let w = window();
        let n = w.normal.into_inner();
        let ray = w.ray_in_gel(&Vector3::new(0.3, 0.2, 1.0)).unwrap();
        let air_point = {
            let d = Vector3::new(0.3, 0.2, 1.0);
            d * (w.distance / d.dot(&n))
        };
        let end = ray.origin + ray.direction * 0.08;
        let time = |a: &Vector3<f64>, b: &Vector3<f64>| {
            a.norm() + w.wall_index * (b - a).norm() + w.gel_index * (end - b).norm()
        };
        let best = time(&air_point, &ray.origin);
        let e = any_orthogonal(&n);
        let f = n.cross(&e);
        for (u, v) in [(1e-4, 0.0), (-1e-4, 0.0), (0.0, 1e-4), (0.0, -1e-4)] {
            let shift = e * u + f * v;
            assert!(time(&(air_point + shift), &ray.origin) > best);
            assert!(time(&air_point, &(ray.origin + shift)) > best);
        }
    }

    #[test]
    fn derivative_agrees_with_differences() {
        let w = window();
        let h = 1e-6;
        for point in [
            Vector3::new(0.03, -0.05, 0.5),
            w.normal.into_inner() * 0.52,
            Vector3::new(0.2, 0.1, 0.46),
        ] {
            let seen = w.direction_to(&point).unwrap();
            for k in 0..3 {
                let mut s = Vector3::zeros();
                s[k] = h;
                let d = (w.direction_to(&(point + s)).unwrap().direction
                    - w.direction_to(&(point - s)).unwrap().direction)
                    / (2.0 * h);
                assert!((d - seen.by_point.column(k)).norm() < 1e-6, "{point} {k}");
            }
        }
    }

    #[test]
    fn equal_indices_do_not_bend() {
        let w = FlatWindow {
            wall_index: 1.0,
            gel_index: 1.0,
            ..window()
        };
        let point = Vector3::new(0.03, -0.05, 0.5);
        let seen = w.direction_to(&point).unwrap().direction;
        assert!(seen.cross(&point).norm() < 1e-14);
    }

    #[test]
    fn impossible_windows_are_refused() {
        let bad = FlatWindow {
            distance: -0.1,
            ..window()
        };
        assert!(matches!(
            bad.validated(),
            Err(InvalidWindow::Geometry { .. })
        ));
        let bad = FlatWindow {
            gel_index: f64::NAN,
            ..window()
        };
        assert!(matches!(bad.validated(), Err(InvalidWindow::Index { .. })));
        assert!(window().ray_in_gel(&Vector3::new(0.0, 0.0, -1.0)).is_none());
    }
}
