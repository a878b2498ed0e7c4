//! One cubic piece of the needle and the equations that hold between pieces (section II.C).

use nalgebra::Vector3;

/// A cubic of curvilinear coordinate l in \[0, `length`\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Columns of the coefficient matrix M_i: factors of 1, l, l^2, l^3.
    pub coefficients: [Vector3<f64>; 4],
    /// Parametric length L_i \[m\].
    pub length: f64,
}

impl Segment {
    /// The cubic through both ends (`a` at l = 0, `b` at l = `length`) with their derivatives.
    pub fn hermite(
        a: &Vector3<f64>,
        derivative_a: &Vector3<f64>,
        b: &Vector3<f64>,
        derivative_b: &Vector3<f64>,
        length: f64,
    ) -> Self {
        let chord = (b - a) / length;
        let quadratic = (3.0 * chord - 2.0 * derivative_a - derivative_b) / length;
        let cubic = (derivative_a + derivative_b - 2.0 * chord) / (length * length);
        Self {
            coefficients: [*a, *derivative_a, quadratic, cubic],
            length,
        }
    }

    /// Position \[m\] at the coordinate `l` \[m\]: Eq. (4).
    pub fn position(&self, l: f64) -> Vector3<f64> {
        let [c0, c1, c2, c3] = self.coefficients;
        c0 + (c1 + (c2 + c3 * l) * l) * l
    }

    /// First derivative at `l`.
    pub fn derivative(&self, l: f64) -> Vector3<f64> {
        let [_, c1, c2, c3] = self.coefficients;
        c1 + (2.0 * c2 + 3.0 * c3 * l) * l
    }

    /// Second derivative at `l` \[1/m\].
    pub fn second_derivative(&self, l: f64) -> Vector3<f64> {
        let [_, _, c2, c3] = self.coefficients;
        2.0 * c2 + 6.0 * c3 * l
    }

    /// Third derivative, constant along the segment \[1/m2\].
    pub fn third_derivative(&self) -> Vector3<f64> {
        6.0 * self.coefficients[3]
    }

    /// True arc length from l = 0 to `l` \[m\].
    pub fn arc_length(&self, l: f64) -> f64 {
        // Eight panels: exact to rounding for any shape the model accepts.
        let panels = 8.0;
        let mut sum = 0.0;
        for panel in 0..8 {
            for (u, w) in GAUSS_3 {
                sum += w * self.derivative(l * (f64::from(panel) + u) / panels).norm();
            }
        }
        sum * l / panels
    }
}

/// Gap \[m\] between the end of a segment and the start of the next, 0 on a needle: Eq. (5).
pub fn position_gap(before: &Segment, after: &Segment) -> Vector3<f64> {
    before.position(before.length) - after.position(0.0)
}

/// Kink between the end of a segment and the start of the next, 0 on a needle: Eq. (6).
pub fn derivative_gap(before: &Segment, after: &Segment) -> Vector3<f64> {
    before.derivative(before.length) - after.derivative(0.0)
}

/// Jump of curvature \[1/m\] between a segment and the next, 0 on a needle: Eq. (7).
pub fn curvature_gap(before: &Segment, after: &Segment) -> Vector3<f64> {
    before.second_derivative(before.length) - after.second_derivative(0.0)
}

/// Gauss-Legendre on \[0, 1\]: (abscissa, weight).
pub(crate) const GAUSS_3: [(f64, f64); 3] = [
    (0.112_701_665_379_258_31, 0.277_777_777_777_777_8),
    (0.5, 0.444_444_444_444_444_4),
    (0.887_298_334_620_741_7, 0.277_777_777_777_777_8),
];

/// As [`GAUSS_3`], for the long segments.
pub(crate) const GAUSS_7: [(f64, f64); 7] = [
    (0.025_446_043_828_620_757, 0.064_742_483_084_434_85),
    (0.129_234_407_200_302_8, 0.139_852_695_744_638_3),
    (0.297_077_424_311_301_4, 0.190_915_025_252_559_5),
    (0.5, 0.208_979_591_836_734_7),
    (0.702_922_575_688_698_6, 0.190_915_025_252_559_5),
    (0.870_765_592_799_697_2, 0.139_852_695_744_638_3),
    (0.974_553_956_171_379_2, 0.064_742_483_084_434_85),
];

#[cfg(test)]
mod tests {
    use super::*;

    fn cubic() -> Segment {
        let (a, b) = (Vector3::new(0.0, 0.1, 0.2), Vector3::new(0.3, 0.0, 1.0));
        Segment::hermite(&a, &Vector3::z(), &b, &Vector3::new(0.2, 0.3, 0.9), 0.8)
    }

    #[test]
    fn hermite_meets_its_ends() {
        let s = cubic();
        assert!((s.position(0.8) - Vector3::new(0.3, 0.0, 1.0)).norm() < 1e-15);
        assert!((s.derivative(0.8) - Vector3::new(0.2, 0.3, 0.9)).norm() < 1e-14);
        assert!((s.derivative(0.0) - Vector3::z()).norm() < 1e-15);
    }

    #[test]
    fn derivatives_match_differences() {
        let (s, l, h) = (cubic(), 0.3, 1e-5);
        let slope = (s.position(l + h) - s.position(l - h)) / (2.0 * h);
        let bend = (s.derivative(l + h) - s.derivative(l - h)) / (2.0 * h);
        let third = (s.second_derivative(l + h) - s.second_derivative(l - h)) / (2.0 * h);
        // Central differences of a cubic: truncation h^2 |S'''| = 1e-9, rounding 1e-11.
        assert!((slope - s.derivative(l)).norm() < 1e-8);
        assert!((bend - s.second_derivative(l)).norm() < 1e-8);
        assert!((third - s.third_derivative()).norm() < 1e-8);
    }

    #[test]
    fn gaps_vanish_on_a_split_cubic() {
        let s = cubic();
        let rest = |l: f64| s.position(0.3 + l);
        let d = |l: f64| s.derivative(0.3 + l);
        let head = Segment { length: 0.3, ..s };
        let tail = Segment::hermite(&rest(0.0), &d(0.0), &rest(0.5), &d(0.5), 0.5);
        assert!(position_gap(&head, &tail).norm() < 1e-15);
        assert!(derivative_gap(&head, &tail).norm() < 1e-14);
        assert!(curvature_gap(&head, &tail).norm() < 1e-13);
        // And do not on another one.
        assert!(curvature_gap(&head, &cubic()).norm() > 0.1);
    }

    #[test]
    fn arc_length_of_a_parabola() {
        // (l, l^2 / 2) from 0 to 1: (sqrt 2 + asinh 1) / 2.
        let z = Vector3::zeros();
        let coefficients = [z, Vector3::x(), Vector3::y() / 2.0, z];
        let exact = f64::midpoint(2_f64.sqrt(), 1_f64.asinh());
        let arc = Segment {
            coefficients,
            length: 1.0,
        }
        .arc_length(1.0);
        assert!((arc - exact).abs() < 1e-9, "{:e}", arc - exact);
    }

    #[test]
    fn gauss_weights_sum_to_one() {
        let sum =
            |rule: &[(f64, f64)], k: i32| rule.iter().map(|(u, w)| w * u.powi(k)).sum::<f64>();
        for k in 0..6 {
            assert!((sum(&GAUSS_3, k) - 1.0 / f64::from(k + 1)).abs() < 1e-15);
        }
        for k in 0..14 {
            assert!((sum(&GAUSS_7, k) - 1.0 / f64::from(k + 1)).abs() < 1e-15);
        }
    }
}
