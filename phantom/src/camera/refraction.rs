//! The exact path of light through a flat window: air, a slab of wall, and what is behind it.
//!
//! By Snell's law a path stays in the plane of the window's normal and the point seen. With q the
//! slope (tangent of the angle with the normal) in air, the slope in a medium of index n is
//! q / sqrt(n^2 + (n^2 - 1) q^2), and the lateral distance covered is an increasing, concave
//! function of q. Newton's method from the paraxial slope, which is never too large, therefore
//! converges monotonically and quadratically.

use nalgebra::Vector3;

/// A flat window as one camera sees it, in that camera's frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    /// Unit normal, away from the camera.
    pub(super) axis: Vector3<f64>,
    /// Distance from the camera's centre to the outer face \[m\].
    pub(super) air: f64,
    /// Thickness of the wall \[m\].
    pub(super) wall: f64,
    /// Refractive index of the wall.
    pub(super) wall_index: f64,
}

/// How a point is seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sight {
    /// Direction from the camera's centre in air, not normalised, of unit length along the axis.
    pub(super) in_air: Vector3<f64>,
    /// Where the light leaves the wall's inner face.
    pub(super) inner: Vector3<f64>,
    /// Direction behind the wall, away from the camera, of unit length along the axis.
    pub(super) behind: Vector3<f64>,
}

/// Slope in a medium of index `n` of a ray of slope `q` in air, and its derivative.
fn slope_in(n: f64, q: f64) -> (f64, f64) {
    let n2 = n * n;
    let inverse = 1.0 / (n2 + (n2 - 1.0) * q * q).sqrt();
    (q * inverse, n2 * inverse * inverse * inverse)
}

impl Window {
    /// Solves for the path from the camera's centre to `point` (camera frame) in a medium of
    /// index `index` behind the wall. Points inside the wall or before it are seen accordingly;
    /// none at or behind the plane of the camera's centre.
    pub(super) fn sight(&self, point: &Vector3<f64>, index: f64) -> Option<Sight> {
        let along = self.axis.dot(point);
        if along.is_nan() || along <= 0.0 {
            return None;
        }
        let lateral = point - along * self.axis;
        let rho = lateral.norm();
        let air = along.min(self.air);
        let wall = (along - self.air).clamp(0.0, self.wall);
        let depth = (along - self.air - self.wall).max(0.0);
        let mut q = rho / (air + wall / self.wall_index + depth / index);
        for _ in 0..30 {
            let (wall_slope, wall_d) = slope_in(self.wall_index, q);
            let (slope, d) = slope_in(index, q);
            let f = air * q + wall * wall_slope + depth * slope - rho;
            let step = f / (air + wall * wall_d + depth * d);
            q -= step;
            // What is left is of the order of the step squared.
            if step.abs() <= 1e-8 {
                break;
            }
        }
        let outward = if rho > 0.0 { lateral / rho } else { lateral };
        let (wall_slope, _) = slope_in(self.wall_index, q);
        let (slope, _) = slope_in(index, q);
        Some(Sight {
            in_air: self.axis + q * outward,
            inner: (self.air + self.wall) * self.axis
                + (self.air * q + self.wall * wall_slope) * outward,
            behind: self.axis + slope * outward,
        })
    }

    /// Follows a ray that leaves the camera's centre along `direction` (camera frame) to the
    /// inner face: origin and unit direction behind the wall. None if it never meets the wall.
    pub(super) fn follow(
        &self,
        direction: &Vector3<f64>,
        index: f64,
    ) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let along = self.axis.dot(direction);
        if along.is_nan() || along <= 0.0 {
            return None;
        }
        let lateral = direction / along - self.axis;
        let q = lateral.norm();
        let outward = if q > 0.0 { lateral / q } else { lateral };
        let (wall_slope, _) = slope_in(self.wall_index, q);
        let (slope, _) = slope_in(index, q);
        let inner =
            (self.air + self.wall) * self.axis + (self.air * q + self.wall * wall_slope) * outward;
        Some((inner, (self.axis + slope * outward).normalize()))
    }
}
