//! The pinhole camera with a distorting lens.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Point2, SMatrix, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::lens::{Distortion, INTRINSICS};
use super::{DistortedPx, UndistortedPx};

/// A calibrated camera: image size, camera matrix, distortion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image width \[px\].
    pub width: usize,
    /// Image height \[px\].
    pub height: usize,
    /// Focal length along the rows \[px\].
    pub fx: f64,
    /// Focal length along the columns \[px\].
    pub fy: f64,
    /// Column of the principal point \[px\].
    pub cx: f64,
    /// Row of the principal point \[px\].
    pub cy: f64,
    /// Distortion of the lens.
    pub distortion: Distortion,
}

/// A camera that cannot be.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum InvalidCamera {
    /// The image has no pixels.
    #[error("the image size {width} x {height} has no pixels")]
    NoPixels {
        /// Width \[px\].
        width: usize,
        /// Height \[px\].
        height: usize,
    },
    /// A focal length is not positive, or a parameter is not finite.
    #[error("focal lengths {fx_px} and {fy_px} px must be positive, all parameters finite")]
    Parameters {
        /// Focal length along the rows.
        fx_px: f64,
        /// Focal length along the columns.
        fy_px: f64,
    },
}

/// A projected point with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection {
    /// The pixel.
    pub px: DistortedPx,
    /// Derivative of the pixel by the point in the camera's frame \[px/m\].
    pub by_point: Matrix2x3<f64>,
    /// Derivative of the pixel by fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6; zero for coefficients
    /// that the lens model does not use.
    pub by_intrinsics: SMatrix<f64, 2, INTRINSICS>,
}

impl Camera {
    /// Checks that the camera can be one.
    ///
    /// # Errors
    /// No pixels, a focal length that is not positive, a parameter that is not finite.
    pub fn validated(self) -> Result<Self, InvalidCamera> {
        if self.width == 0 || self.height == 0 {
            return Err(InvalidCamera::NoPixels {
                width: self.width,
                height: self.height,
            });
        }
        let finite = self.intrinsics().iter().all(|x| x.is_finite());
        if finite && self.fx > 0.0 && self.fy > 0.0 {
            Ok(self)
        } else {
            Err(InvalidCamera::Parameters {
                fx_px: self.fx,
                fy_px: self.fy,
            })
        }
    }

    /// fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6, the order of all derivatives; which of them count
    /// is the lens model's [`used`](super::LensModel::used).
    pub fn intrinsics(&self) -> [f64; INTRINSICS] {
        let [k1, k2, p1, p2, k3, k4, k5, k6] = self.distortion.slots();
        [
            self.fx, self.fy, self.cx, self.cy, k1, k2, p1, p2, k3, k4, k5, k6,
        ]
    }

    /// The same image size and lens model with other parameters, in the order of
    /// [`Camera::intrinsics`].
    #[must_use]
    pub const fn with_intrinsics(&self, p: &[f64; INTRINSICS]) -> Self {
        let [fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6] = *p;
        Self {
            width: self.width,
            height: self.height,
            fx,
            fy,
            cx,
            cy,
            distortion: self.distortion.with_slots([k1, k2, p1, p2, k3, k4, k5, k6]),
        }
    }

    /// The 3x3 camera matrix.
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0)
    }

    /// Projects a point of the camera's frame; `None` behind the camera.
    #[inline]
    pub fn project(&self, point: &Vector3<f64>) -> Option<DistortedPx> {
        (point.z > 0.0).then(|| {
            let d = self.distortion.apply(&(point.xy() / point.z));
            DistortedPx(self.pixel(&d))
        })
    }

    /// Projects a point of the camera's frame, with the derivative by it \[px/m\]; `None`
    /// behind the camera.
    #[inline]
    pub fn project_with_derivative(
        &self,
        point: &Vector3<f64>,
    ) -> Option<(DistortedPx, Matrix2x3<f64>)> {
        if point.z.is_nan() || point.z <= 0.0 {
            return None;
        }
        let z = 1.0 / point.z;
        let n = point.xy() * z;
        let (d, j) = self.distortion.apply_with_derivative(&n);
        Some((DistortedPx(self.pixel(&d)), self.chain(&n, &j, z)))
    }

    /// Projects a point of the camera's frame, with all derivatives; `None` behind the camera.
    #[inline]
    pub fn project_with_all_derivatives(&self, point: &Vector3<f64>) -> Option<Projection> {
        if point.z.is_nan() || point.z <= 0.0 {
            return None;
        }
        let z = 1.0 / point.z;
        let n = point.xy() * z;
        let (d, j) = self.distortion.apply_with_derivative(&n);
        let mut by_intrinsics = SMatrix::<f64, 2, INTRINSICS>::zeros();
        (by_intrinsics[(0, 0)], by_intrinsics[(1, 1)]) = (d.x, d.y);
        (by_intrinsics[(0, 2)], by_intrinsics[(1, 3)]) = (1.0, 1.0);
        for (k, by) in self.distortion.by_coefficients(&n).iter().enumerate() {
            by_intrinsics[(0, 4 + k)] = self.fx * by.x;
            by_intrinsics[(1, 4 + k)] = self.fy * by.y;
        }
        Some(Projection {
            px: DistortedPx(self.pixel(&d)),
            by_point: self.chain(&n, &j, z),
            by_intrinsics,
        })
    }

    /// Removes the distortion of the lens; `None` where the model cannot be inverted.
    #[inline]
    pub fn undistort(&self, px: DistortedPx) -> Option<UndistortedPx> {
        let n = self.distortion.invert(&self.normalised(&px.0))?;
        Some(UndistortedPx(self.pixel(&n)))
    }

    /// Adds the distortion of the lens.
    #[inline]
    pub fn distort(&self, px: UndistortedPx) -> DistortedPx {
        DistortedPx(self.pixel(&self.distortion.apply(&self.normalised(&px.0))))
    }

    /// Direction (z = 1) in the camera's frame of what a pixel shows; `None` where the
    /// distortion cannot be inverted.
    #[inline]
    pub fn direction(&self, px: DistortedPx) -> Option<Vector3<f64>> {
        let n = self.distortion.invert(&self.normalised(&px.0))?;
        Some(Vector3::new(n.x, n.y, 1.0))
    }

    /// Direction (z = 1) in the camera's frame of an undistorted pixel.
    #[inline]
    pub fn direction_undistorted(&self, px: UndistortedPx) -> Vector3<f64> {
        let n = self.normalised(&px.0);
        Vector3::new(n.x, n.y, 1.0)
    }

    /// Whether a pixel lies inside the image, borders of pixels included.
    pub fn contains(&self, px: DistortedPx) -> bool {
        let inside = |v: f64, size: usize| v >= -0.5 && v <= size as f64 - 0.5;
        inside(px.0.x, self.width) && inside(px.0.y, self.height)
    }

    fn normalised(&self, px: &Point2<f64>) -> Vector2<f64> {
        Vector2::new((px.x - self.cx) / self.fx, (px.y - self.cy) / self.fy)
    }

    fn pixel(&self, n: &Vector2<f64>) -> Point2<f64> {
        Point2::new(self.fx * n.x + self.cx, self.fy * n.y + self.cy)
    }

    fn chain(&self, n: &Vector2<f64>, j: &Matrix2<f64>, inverse_depth: f64) -> Matrix2x3<f64> {
        let row = |f: f64, a: f64, b: f64| {
            let s = f * inverse_depth;
            [s * a, s * b, -s * (a * n.x + b * n.y)]
        };
        let r0 = row(self.fx, j[(0, 0)], j[(0, 1)]);
        let r1 = row(self.fy, j[(1, 0)], j[(1, 1)]);
        Matrix2x3::new(r0[0], r0[1], r0[2], r1[0], r1[1], r1[2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn opencv_left() -> Camera {
        Camera {
            width: 640,
            height: 480,
            fx: 533.7,
            fy: 533.9,
            cx: 341.8,
            cy: 236.1,
            distortion: Distortion::from_array([-0.29, 0.12, 0.0013, -0.0002, -0.04]),
        }
    }

    #[test]
    fn undistort_undoes_distort_over_the_image() {
        let camera = opencv_left();
        for y in (0..480).step_by(40) {
            for x in (0..640).step_by(40) {
                let px = DistortedPx::new(f64::from(x), f64::from(y));
                let back = camera.distort(camera.undistort(px).unwrap());
                assert!((back.0 - px.0).norm() < 1e-9, "{px:?} -> {back:?}");
            }
        }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let camera = opencv_left();
        let point = Vector3::new(0.11, -0.07, 0.42);
        let p = camera.project_with_all_derivatives(&point).unwrap();
        let h = 1e-6;
        for k in 0..3 {
            let mut step = Vector3::zeros();
            step[k] = h;
            let d = (camera.project(&(point + step)).unwrap().0
                - camera.project(&(point - step)).unwrap().0)
                / (2.0 * h);
            // Central differences: truncation h^2, rounding 1e-13/h.
            assert!((d - p.by_point.column(k)).norm() < 1e-5 * d.norm().max(1.0));
        }
        for k in 0..9 {
            let shifted = |s: f64| {
                let mut q = camera.intrinsics();
                q[k] += s;
                camera.with_intrinsics(&q).project(&point).unwrap().0
            };
            let d = (shifted(h) - shifted(-h)) / (2.0 * h);
            assert!((d - p.by_intrinsics.column(k)).norm() < 1e-6 * d.norm().max(1.0));
        }
        let (px, by_point) = camera.project_with_derivative(&point).unwrap();
        assert_eq!((px, by_point), (p.px, p.by_point));
    }

    #[test]
    fn a_folded_model_is_not_inverted() {
        let mut camera = opencv_left();
        camera.distortion = Distortion::from_array([-3.0, 0.0, 0.0, 0.0, 0.0]);
        assert!(camera.undistort(DistortedPx::new(0.0, 0.0)).is_none());
        assert!(camera.undistort(DistortedPx::new(f64::NAN, 0.0)).is_none());
        assert!(camera.project(&Vector3::new(0.0, 0.0, -1.0)).is_none());
        camera.fx = f64::NAN;
        assert!(matches!(
            camera.validated(),
            Err(InvalidCamera::Parameters { .. })
        ));
    }
}
