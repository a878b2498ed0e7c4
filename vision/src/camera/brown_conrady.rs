//! The pinhole camera with Brown-Conrady distortion (OpenCV's five coefficients) \[Brown1971\].

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Point2, SMatrix, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::{DistortedPx, UndistortedPx};

/// Brown-Conrady coefficients, of normalised image coordinates; OpenCV's order is
/// k1 k2 p1 p2 k3.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Distortion {
    /// Radial, second order.
    pub k1: f64,
    /// Radial, fourth order.
    pub k2: f64,
    /// Tangential.
    pub p1: f64,
    /// Tangential.
    pub p2: f64,
    /// Radial, sixth order.
    pub k3: f64,
}

impl Distortion {
    /// In OpenCV's order: k1 k2 p1 p2 k3.
    pub const fn to_array(&self) -> [f64; 5] {
        [self.k1, self.k2, self.p1, self.p2, self.k3]
    }

    /// From OpenCV's order: k1 k2 p1 p2 k3.
    pub const fn from_array([k1, k2, p1, p2, k3]: [f64; 5]) -> Self {
        Self { k1, k2, p1, p2, k3 }
    }

    /// Distorts normalised coordinates.
    #[inline]
    pub fn apply(&self, n: &Vector2<f64>) -> Vector2<f64> {
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        Vector2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Distorts normalised coordinates, with the derivative by them.
    #[inline]
    pub fn apply_with_derivative(&self, n: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3));
        let (p1, p2) = (self.p1, self.p2);
        let cross = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y;
        (
            Vector2::new(
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ),
            Matrix2::new(
                radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
                cross,
                cross,
                radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
            ),
        )
    }

    /// The normalised coordinates that distort to `distorted`, by Newton's method from there.
    /// `None` where the model folds over or the iteration does not settle.
    #[inline]
    pub fn invert(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        // 1e-13 of a focal length: below a billionth of a pixel.
        const SETTLED: f64 = 1e-26;
        let mut n = *distorted;
        let mut step = Vector2::zeros();
        let mut missed = f64::INFINITY;
        for _ in 0..40 {
            let (value, j) = self.apply_with_derivative(&n);
            let e = distorted - value;
            let det = j[(0, 0)] * j[(1, 1)] - j[(0, 1)] * j[(1, 0)];
            let miss = e.norm_squared();
            // On the branch that begins at the centre the map keeps its orientation: a step
            // that leaves it, or that does not come nearer, was too long. (Rounding may miss.)
            if det.is_nan() || det <= 1e-6 || (miss > missed && miss > SETTLED) {
                if step.norm_squared() < SETTLED {
                    return None;
                }
                step *= 0.5;
                n -= step;
                continue;
            }
            missed = miss;
            step = Vector2::new(
                j[(1, 1)] * e.x - j[(0, 1)] * e.y,
                j[(0, 0)] * e.y - j[(1, 0)] * e.x,
            ) / det;
            n += step;
            if step.norm_squared() < SETTLED {
                return Some(n);
            }
        }
        None
    }
}

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
    /// Derivative of the pixel by fx fy cx cy k1 k2 p1 p2 k3.
    pub by_intrinsics: SMatrix<f64, 2, 9>,
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

    /// fx fy cx cy k1 k2 p1 p2 k3, the order of all derivatives.
    pub fn intrinsics(&self) -> [f64; 9] {
        let d = &self.distortion;
        [
            self.fx, self.fy, self.cx, self.cy, d.k1, d.k2, d.p1, d.p2, d.k3,
        ]
    }

    /// The same image size with other fx fy cx cy k1 k2 p1 p2 k3.
    #[must_use]
    pub fn with_intrinsics(&self, p: &[f64; 9]) -> Self {
        Self {
            width: self.width,
            height: self.height,
            fx: p[0],
            fy: p[1],
            cx: p[2],
            cy: p[3],
            distortion: Distortion::from_array([p[4], p[5], p[6], p[7], p[8]]),
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
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        let (r4, r6) = (r2 * r2, r2 * r2 * r2);
        let (fx, fy) = (self.fx, self.fy);
        #[rustfmt::skip]
        let by_intrinsics = SMatrix::<f64, 2, 9>::from_row_slice(&[
            d.x, 0.0, 1.0, 0.0, fx * x * r2, fx * x * r4,
            fx * 2.0 * x * y, fx * (r2 + 2.0 * x * x), fx * x * r6,
            0.0, d.y, 0.0, 1.0, fy * y * r2, fy * y * r4,
            fy * (r2 + 2.0 * y * y), fy * 2.0 * x * y, fy * y * r6,
        ]);
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
