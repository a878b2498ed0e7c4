//! Distortion against Brown's formulae written in polar form, and its inverse.

use crate::camera::Lens;

const LENS: Lens = Lens {
    fx: 533.416_719,
    fy: 533.441_920,
    cx: 342.535_154,
    cy: 234.725_251,
    distortion: [
        -0.281_972_504,
        0.038_866_760,
        0.001_209_136,
        -0.000_126_321,
        0.119_070_352,
    ],
};

#[test]
fn distortion_is_brown_conrady() {
    let [k1, k2, p1, p2, k3] = LENS.distortion;
    for i in 0..200 {
        let (r, phi) = (0.004 * f64::from(i), 2.4 * f64::from(i));
        let (s, c) = phi.sin_cos();
        let radial = r + k1 * r.powi(3) + k2 * r.powi(5) + k3 * r.powi(7);
        // Decentring: along r by 3 (p1 s + p2 c) r^2, across it by (p1 c - p2 s) r^2.
        let along = radial + 3.0 * r * r * (p1 * s + p2 * c);
        let across = r * r * (p1 * c - p2 * s);
        let expected = [along * c - across * s, along * s + across * c];
        let got = LENS.distort([r * c, r * s]);
        assert!((got[0] - expected[0]).abs() < 1e-15 && (got[1] - expected[1]).abs() < 1e-15);
    }
}

#[test]
fn normalising_undoes_projection() {
    for y in (0..480).step_by(40) {
        for x in (0..640).step_by(40) {
            let pixel = [f64::from(x), f64::from(y)];
            let back = LENS.project(LENS.normalise(pixel));
            assert!((back[0] - pixel[0]).hypot(back[1] - pixel[1]) < 1e-11);
        }
    }
}

#[test]
fn jacobian_is_the_derivative() {
    let n = [0.31, -0.22];
    let h = 1e-6;
    let j = LENS.distort_jacobian(n);
    for axis in 0..2 {
        let mut plus = n;
        let mut minus = n;
        plus[axis] += h;
        minus[axis] -= h;
        let (p, m) = (LENS.distort(plus), LENS.distort(minus));
        for row in 0..2 {
            assert!((j[row][axis] - (p[row] - m[row]) / (2.0 * h)).abs() < 1e-9);
        }
    }
}
