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
pub(crate) const GAUSS_10: [(f64, f64); 10] = [
    (0.013_046_735_741_414_14, 0.033_335_672_154_344_07),
    (0.067_468_316_655_507_75, 0.074_725_674_575_290_3),
    (0.160_295_215_850_487_8, 0.109_543_181_257_991_02),
    (0.283_302_302_935_376_4, 0.134_633_359_654_998_17),
    (0.425_562_830_509_184_4, 0.147_762_112_357_376_44),
    (0.574_437_169_490_815_6, 0.147_762_112_357_376_44),
    (0.716_697_697_064_623_6, 0.134_633_359_654_998_17),
    (0.839_704_784_149_512_2, 0.109_543_181_257_991_02),
    (0.932_531_683_344_492_2, 0.074_725_674_575_290_3),
    (0.986_953_264_258_585_9, 0.033_335_672_154_344_07),
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
        for k in 0..20 {
            assert!((sum(&GAUSS_10, k) - 1.0 / f64::from(k + 1)).abs() < 1e-15);
        }
    }
}
