//! Lens distortion: Brown-Conrady \[Brown1971\], its rational form, and the equidistant fisheye
//! \[Kannala2006\], each with OpenCV's coefficients.

use core::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

/// Number of intrinsic parameters of the largest model: fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6.
pub const INTRINSICS: usize = 12;

/// Which formula the coefficients belong to. The names are ROS's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LensModel {
    /// Brown-Conrady: k1 k2 p1 p2 k3.
    #[default]
    PlumbBob,
    /// Brown-Conrady without its third radial coefficient, Kalibr's: k1 k2 p1 p2.
    #[serde(rename = "radtan")]
    RadTan,
    /// Brown-Conrady over a polynomial: k1 k2 p1 p2 k3 k4 k5 k6.
    RationalPolynomial,
    /// Fisheye: the angle to the axis times a polynomial, k1 k2 k3 k4.
    Equidistant,
}

impl LensModel {
    /// ROS's name of the model; Kalibr's of [`Self::RadTan`], for which ROS has none.
    pub const fn name(self) -> &'static str {
        match self {
            Self::PlumbBob => "plumb_bob",
            Self::RadTan => "radtan",
            Self::RationalPolynomial => "rational_polynomial",
            Self::Equidistant => "equidistant",
        }
    }

    /// Which of the twelve places of [`super::Camera::intrinsics`] the model uses.
    pub const fn used(self) -> &'static [usize] {
        match self {
            Self::PlumbBob => &[0, 1, 2, 3, 4, 5, 6, 7, 8],
            Self::RadTan => &[0, 1, 2, 3, 4, 5, 6, 7],
            Self::RationalPolynomial => &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
            Self::Equidistant => &[0, 1, 2, 3, 4, 5, 8, 9],
        }
    }
}

/// Distortion of a lens, of normalised image coordinates. Coefficients that the model does not
/// use are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Distortion {
    /// The formula.
    #[serde(default)]
    pub model: LensModel,
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
    /// Rational: second order of the denominator. Equidistant: eighth order.
    #[serde(default)]
    pub k4: f64,
    /// Rational: fourth order of the denominator.
    #[serde(default)]
    pub k5: f64,
    /// Rational: sixth order of the denominator.
    #[serde(default)]
    pub k6: f64,
}

/// Below this squared radius the fisheye's ratios are taken from their series.
const CENTRE: f64 = 1e-8;

impl Distortion {
    /// The Brown-Conrady part in OpenCV's order: k1 k2 p1 p2 k3.
    pub const fn to_array(&self) -> [f64; 5] {
        [self.k1, self.k2, self.p1, self.p2, self.k3]
    }

    /// Brown-Conrady, from OpenCV's order: k1 k2 p1 p2 k3.
    pub const fn from_array([k1, k2, p1, p2, k3]: [f64; 5]) -> Self {
        Self {
            model: LensModel::PlumbBob,
            k1,
            k2,
            p1,
            p2,
            k3,
            k4: 0.0,
            k5: 0.0,
            k6: 0.0,
        }
    }

    /// Brown-Conrady without k3, from OpenCV's order: k1 k2 p1 p2.
    pub const fn radtan([k1, k2, p1, p2]: [f64; 4]) -> Self {
        let mut lens = Self::from_array([k1, k2, p1, p2, 0.0]);
        lens.model = LensModel::RadTan;
        lens
    }

    /// The rational model, from OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6.
    pub const fn rational([k1, k2, p1, p2, k3, k4, k5, k6]: [f64; 8]) -> Self {
        Self {
            model: LensModel::RationalPolynomial,
            k1,
            k2,
            p1,
            p2,
            k3,
            k4,
            k5,
            k6,
        }
    }

    /// The equidistant fisheye, from OpenCV's order: k1 k2 k3 k4.
    pub const fn equidistant([k1, k2, k3, k4]: [f64; 4]) -> Self {
        Self {
            model: LensModel::Equidistant,
            k1,
            k2,
            p1: 0.0,
            p2: 0.0,
            k3,
            k4,
            k5: 0.0,
            k6: 0.0,
        }
    }

    /// ROS's name of the model, and the coefficients that ROS expects with it: of
    /// [`LensModel::RadTan`] the five of `plumb_bob`, which it is with k3 = 0.
    pub fn ros(&self) -> (&'static str, Vec<f64>) {
        match self.model {
            LensModel::RadTan => (LensModel::PlumbBob.name(), self.to_array().to_vec()),
            model => (model.name(), self.coefficients()),
        }
    }

    /// The model's own coefficients, in OpenCV's order: five, four, eight or four.
    pub fn coefficients(&self) -> Vec<f64> {
        let all = self.slots();
        let used = self.model.used().iter().skip(4);
        used.map(|&k| all[k - 4]).collect()
    }

    /// k1 k2 p1 p2 k3 k4 k5 k6, whatever the model.
    pub(super) const fn slots(&self) -> [f64; 8] {
        [
            self.k1, self.k2, self.p1, self.p2, self.k3, self.k4, self.k5, self.k6,
        ]
    }

    /// The same model with other k1 k2 p1 p2 k3 k4 k5 k6.
    pub(super) const fn with_slots(&self, s: [f64; 8]) -> Self {
        let [k1, k2, p1, p2, k3, k4, k5, k6] = s;
        Self {
            model: self.model,
            k1,
            k2,
            p1,
            p2,
            k3,
            k4,
            k5,
            k6,
        }
    }

    /// Numerator and denominator of the radial factor.
    #[inline]
    fn radial(&self, r2: f64) -> (f64, f64) {
        (
            1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3)),
            1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6)),
        )
    }

    /// The radial factor and the tangential coefficients' shift.
    #[inline]
    fn moved(&self, n: &Vector2<f64>, r2: f64, radial: f64) -> Vector2<f64> {
        let (x, y) = (n.x, n.y);
        Vector2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Distorts normalised coordinates.
    #[inline]
    pub fn apply(&self, n: &Vector2<f64>) -> Vector2<f64> {
        let r2 = n.x * n.x + n.y * n.y;
        let radial = match self.model {
            LensModel::PlumbBob | LensModel::RadTan => self.radial(r2).0,
            LensModel::RationalPolynomial => {
                let (over, under) = self.radial(r2);
                over / under
            }
            LensModel::Equidistant => self.fisheye(r2).0,
        };
        self.moved(n, r2, radial)
    }

    /// Distorts normalised coordinates, with the derivative by them.
    #[inline]
    pub fn apply_with_derivative(&self, n: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        // The radial factor and twice its derivative by r2.
        let (radial, slope) = match self.model {
            LensModel::Equidistant => self.fisheye(r2),
            LensModel::PlumbBob | LensModel::RadTan => {
                let slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3));
                (self.radial(r2).0, slope)
            }
            LensModel::RationalPolynomial => {
                let (over, under) = self.radial(r2);
                let radial = over / under;
                let by_over = self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3);
                let by_under = self.k4 + r2 * (2.0 * self.k5 + 3.0 * r2 * self.k6);
                (radial, 2.0 * (by_over - radial * by_under) / under)
            }
        };
        let (p1, p2) = (self.p1, self.p2);
        let cross = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y;
        (
            self.moved(n, r2, radial),
            Matrix2::new(
                radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
                cross,
                cross,
                radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
            ),
        )
    }

    /// Derivatives of the distorted coordinates by k1 k2 p1 p2 k3 k4 k5 k6 at `n`; zero for
    /// coefficients that the model does not use.
    #[inline]
    pub(super) fn by_coefficients(&self, n: &Vector2<f64>) -> [Vector2<f64>; 8] {
        let (x, y) = (n.x, n.y);
        let r2 = x * x + y * y;
        let none = Vector2::zeros();
        if self.model == LensModel::Equidistant {
            let r = r2.sqrt();
            let angle = r.atan();
            let a2 = angle * angle;
            let one = if r2 < CENTRE { r2 } else { a2 * angle / r };
            let by = |power: f64| n * (one * power);
            return [
                by(1.0),
                by(a2),
                none,
                none,
                by(a2 * a2),
                by(a2 * a2 * a2),
                none,
                none,
            ];
        }
        let (over, under) = self.radial(r2);
        let by = |power: f64| n * (power / under);
        let (r4, r6) = (r2 * r2, r2 * r2 * r2);
        let below = |power: f64| {
            if self.model == LensModel::RationalPolynomial {
                n * (-over * power / (under * under))
            } else {
                none
            }
        };
        [
            by(r2),
            by(r4),
            Vector2::new(2.0 * x * y, r2 + 2.0 * y * y),
            Vector2::new(r2 + 2.0 * x * x, 2.0 * x * y),
            if self.model == LensModel::RadTan {
                none
            } else {
                by(r6)
            },
            below(r2),
            below(r4),
            below(r6),
        ]
    }

    /// The fisheye's factor at a squared radius, and twice its derivative by that square.
    #[inline]
    fn fisheye(&self, r2: f64) -> (f64, f64) {
        if r2 < CENTRE {
            let first = self.k1 - 1.0 / 3.0;
            return (1.0 + first * r2, 2.0 * first);
        }
        let r = r2.sqrt();
        let (bent, by_angle) = self.bent(r.atan());
        let by_r = by_angle / (1.0 + r2);
        (bent / r, (by_r - bent / r) / r2)
    }

    /// The fisheye's radius at an angle to the axis, and its derivative by the angle.
    #[inline]
    fn bent(&self, angle: f64) -> (f64, f64) {
        let a = angle * angle;
        let (k1, k2, k3, k4) = (self.k1, self.k2, self.k3, self.k4);
        (
            angle * (1.0 + a * (k1 + a * (k2 + a * (k3 + a * k4)))),
            1.0 + a * (3.0 * k1 + a * (5.0 * k2 + a * (7.0 * k3 + a * 9.0 * k4))),
        )
    }

    /// The normalised coordinates that distort to `distorted`, by Newton's method from there.
    /// `None` where the model folds over, the iteration does not settle, or a fisheye's ray
    /// stands at a right angle to the axis or beyond.
    #[inline]
    pub fn invert(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        // 1e-13 of a focal length: below a billionth of a pixel.
        const SETTLED: f64 = 1e-26;
        if self.model == LensModel::Equidistant {
            return self.unbend(distorted);
        }
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

    /// Inverts the fisheye along its radius.
    fn unbend(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        const SETTLED: f64 = 1e-15;
        let radius = distorted.norm();
        if radius * radius < CENTRE {
            // The factor's series, twice: its next term is below 1e-17.
            let first = self.k1 - 1.0 / 3.0;
            return Some(distorted * (1.0 - first * radius * radius));
        }
        let mut angle = radius.min(1.5);
        for _ in 0..60 {
            let (bent, by_angle) = self.bent(angle);
            if by_angle.is_nan() || by_angle <= 1e-6 {
                // Beyond the fold: back towards the axis.
                angle *= 0.5;
                continue;
            }
            let step = ((radius - bent) / by_angle).clamp(-0.5, 0.5);
            angle = (angle + step).clamp(0.0, FRAC_PI_2);
            if step.abs() < SETTLED * angle.max(0.1) {
                let inside = angle < FRAC_PI_2 - 1e-6;
                return inside.then(|| distorted * (angle.tan() / radius));
            }
        }
        None
    }

    /// Undistorts by five fixed-point steps, as OpenCV's rectification does; `None` where the
    /// radial factor is not positive, and for a fisheye beyond a right angle.
    pub(crate) fn invert_roughly(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        if self.model == LensModel::Equidistant {
            return self.unbend(distorted);
        }
        let mut n = *distorted;
        for _ in 0..5 {
            let r2 = n.norm_squared();
            let (over, under) = self.radial(r2);
            let radial = over / under;
            if radial.is_nan() || radial <= 0.0 {
                return None;
            }
            n = (distorted - self.moved(&n, r2, 0.0)) / radial;
        }
        Some(n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lenses() -> [Distortion; 4] {
        [
            Distortion::radtan([-0.29, 0.12, 0.0013, -0.0002]),
            Distortion::from_array([-0.29, 0.12, 0.0013, -0.0002, -0.04]),
            Distortion::rational([0.4, -0.3, 0.001, -0.0005, 0.05, 0.7, -0.1, 0.02]),
            Distortion::equidistant([-0.02, 0.015, -0.008, 0.001]),
        ]
    }

    #[test]
    fn every_model_is_inverted_to_rounding() {
        for lens in lenses() {
            for (x, y) in [
                (0.0, 0.0),
                (1e-6, 2e-6),
                (0.3, -0.2),
                (-0.5, 0.45),
                (0.01, 0.0),
            ] {
                let n = Vector2::new(x, y);
                let back = lens.invert(&lens.apply(&n)).unwrap();
                assert!((back - n).norm() < 1e-12, "{lens:?} {n:?} {back:?}");
            }
        }
    }

    #[test]
    fn derivatives_of_every_model_agree_with_differences() {
        let h = 1e-6;
        for lens in lenses() {
            for n in [Vector2::new(0.4, -0.3), Vector2::new(2e-5, 1e-5)] {
                let (value, j) = lens.apply_with_derivative(&n);
                assert!((value - lens.apply(&n)).norm() < 1e-15);
                for k in 0..2 {
                    let mut step = Vector2::zeros();
                    step[k] = h;
                    let d = (lens.apply(&(n + step)) - lens.apply(&(n - step))) / (2.0 * h);
                    assert!((d - j.column(k)).norm() < 1e-8, "{lens:?} by {k}");
                }
                for (k, by) in lens.by_coefficients(&n).iter().enumerate() {
                    let shifted = |s: f64| {
                        let mut slots = lens.slots();
                        slots[k] += s;
                        lens.with_slots(slots).apply(&n)
                    };
                    let used = lens.model.used().contains(&(k + 4));
                    let d = (shifted(h) - shifted(-h)) / (2.0 * h);
                    let expected = if used { d } else { Vector2::zeros() };
                    assert!((expected - by).norm() < 1e-9, "{lens:?} by coefficient {k}");
                }
            }
        }
    }

    #[test]
    fn a_fisheye_sees_far_to_the_side_and_no_further_than_a_right_angle() {
        let lens = Distortion::equidistant([0.0; 4]);
        let wide = lens.invert(&Vector2::new(1.48, 0.0)).unwrap();
        assert!((wide.x - 1.48_f64.tan()).abs() < 1e-9);
        assert_eq!(lens.invert(&Vector2::new(1.6, 0.0)), None);
    }
}
