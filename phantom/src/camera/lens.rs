//! Pinhole with Brown-Conrady distortion, in OpenCV's convention and order of coefficients.

use serde::{Deserialize, Serialize};

/// Image coordinates `[x, y]` \[px\]; pixel centres are integers, x to the right, y down.
pub type Pixel = [f64; 2];

/// A camera's intrinsic parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lens {
    /// Focal length along x \[px\].
    pub fx: f64,
    /// Focal length along y \[px\].
    pub fy: f64,
    /// Principal point, x \[px\].
    pub cx: f64,
    /// Principal point, y \[px\].
    pub cy: f64,
    /// Coefficients k1, k2, p1, p2, k3.
    pub distortion: [f64; 5],
}

impl Lens {
    /// Distorts normalised coordinates (x/z, y/z).
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    }

    /// Derivative of [`Self::distort`]: `[[dx/dx, dx/dy], [dy/dx, dy/dy]]`.
    pub(super) fn distort_jacobian(&self, [x, y]: [f64; 2]) -> [[f64; 2]; 2] {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3));
        let mixed = x * y * slope + 2.0 * (p1 * x + p2 * y);
        [
            [radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x, mixed],
            [mixed, radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x],
        ]
    }

    /// Pixel of a direction given by its normalised coordinates.
    pub fn project(&self, normalised: [f64; 2]) -> Pixel {
        let [x, y] = self.distort(normalised);
        [self.fx * x + self.cx, self.fy * y + self.cy]
    }

    /// Normalised coordinates of a pixel: the inverse of [`Self::project`], by Newton's method
    /// (1e-14 wherever the distortion does not fold).
    pub fn normalise(&self, [u, v]: Pixel) -> [f64; 2] {
        let target = [(u - self.cx) / self.fx, (v - self.cy) / self.fy];
        let mut n = target;
        for _ in 0..20 {
            let d = self.distort(n);
            let e = [d[0] - target[0], d[1] - target[1]];
            let [[a, b], [c, d]] = self.distort_jacobian(n);
            let det = a * d - b * c;
            let step = [(d * e[0] - b * e[1]) / det, (a * e[1] - c * e[0]) / det];
            if !(step[0].is_finite() && step[1].is_finite()) {
                break;
            }
            n = [n[0] - step[0], n[1] - step[1]];
            if step[0].abs() + step[1].abs() < 1e-16 {
                break;
            }
        }
        n
    }

    /// Whether the distortion is one-to-one over an image of `width` x `height` pixels, with a
    /// margin of 5 % (sampled on a 17 x 17 grid).
    pub(super) fn unfolded(&self, width: usize, height: usize) -> bool {
        (0..17).all(|i| {
            (0..17).all(|j| {
                let x = (1.05 * (f64::from(i) / 8.0 - 1.0) * 0.5 + 0.5) * width as f64;
                let y = (1.05 * (f64::from(j) / 8.0 - 1.0) * 0.5 + 0.5) * height as f64;
                let n = [(x - self.cx) / self.fx, (y - self.cy) / self.fy];
                let [[a, b], [c, d]] = self.distort_jacobian(n);
                a > 0.2 && d > 0.2 && a * d - b * c > 0.1
            })
        })
    }
}
