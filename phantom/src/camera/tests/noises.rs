//! Statistics of the noise, and determinism.

use super::scene::{needle, rig};
use crate::camera::CameraSettings;

/// Mean and variance of the grey levels over some exposures of a flat screen.
fn moments(level: f64, gaussian: f64, poisson: f64) -> (f64, f64) {
    let mut settings = CameraSettings::ideal();
    settings.backlight.level_grey = level;
    settings.noise.gaussian_grey = gaussian;
    settings.noise.poisson_grey = poisson;
    let mut rig = rig(&settings, 7);
    let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for sequence in 0..5 {
        for image in rig.empty(sequence) {
            for p in image.pixels() {
                let d = f64::from(*p) - level;
                n += 1.0;
                sum += d;
                squares += d * d;
            }
        }
    }
    let mean = sum / n;
    (mean, squares / n - mean * mean)
}

#[test]
fn variance_is_gaussian_plus_poisson_plus_rounding() {
    // 3 million pixels: the variance is known to 0.1 %; rounding to whole greys adds 1/12.
    for (level, gaussian, poisson) in [
        (150.0, 2.0, 0.0),
        (150.0, 0.0, 0.02),
        (50.0, 0.0, 0.02),
        (100.0, 4.0, 0.05),
    ] {
        let (mean, variance) = moments(level, gaussian, poisson);
        let expected = gaussian * gaussian + poisson * level + 1.0 / 12.0;
        assert!(
            (variance / expected - 1.0).abs() < 0.01,
            "{variance} instead of {expected}"
        );
        // Products are rounded down in 1/64 grey: half of that is lost on average.
        assert!(mean.abs() < 0.015, "mean {mean}");
    }
}

#[test]
fn without_noise_a_screen_is_flat_and_the_needle_dark() {
    let mut rig = rig(&CameraSettings::ideal(), 1);
    for image in rig.empty(0) {
        assert!(image.pixels().iter().all(|p| *p == 200));
    }
    for image in rig.render(&needle(0.08, 0.5, 0.3, 0.0), 0) {
        assert_eq!(image.pixels().iter().min(), Some(&20));
        assert_eq!(image.pixels().iter().max(), Some(&200));
    }
    // Nothing of the needle stays behind.
    for image in rig.empty(1) {
        assert!(image.pixels().iter().all(|p| *p == 200));
    }
}

#[test]
fn exposures_and_cameras_have_independent_noise() {
    let mut settings = CameraSettings::ideal();
    settings.noise.gaussian_grey = 5.0;
    let mut rig = rig(&settings, 2);
    let [a, b] = rig.empty(0);
    let [c, _] = rig.empty(1);
    for (x, y) in [(&a, &b), (&a, &c), (&b, &c)] {
        let n = x.pixels().len() as f64;
        let sum: f64 = x
            .pixels()
            .iter()
            .zip(y.pixels())
            .map(|(p, q)| (f64::from(*p) - 200.0) * (f64::from(*q) - 200.0))
            .sum();
        // Independent samples leave 1/sqrt(n) = 0.0018; a shared strip could only add to it.
        assert!((sum / n / 25.0).abs() < 0.01, "{}", sum / n / 25.0);
    }
    let row = |y: usize| a.row(y).iter().map(|p| f64::from(*p) - 200.0);
    let along: f64 = (0..480)
        .map(|y| row(y).zip(row(y).skip(1)).map(|(p, q)| p * q).sum::<f64>())
        .sum();
    assert!((along / (480.0 * 639.0) / 25.0).abs() < 0.01);
}

#[test]
fn an_exposure_depends_on_seed_and_number_alone() {
    let settings = CameraSettings::paper();
    let shown = needle(0.06, 0.8, 1.0, 0.4);
    let other = needle(0.03, -0.4, 0.2, 2.0);
    let mut one = rig(&settings, 5);
    let mut two = rig(&settings, 5);
    let mut three = rig(&settings, 6);
    let first = one.render(&shown, 12);
    two.render(&other, 3);
    two.empty(12);
    assert_eq!(two.render(&shown, 12), first);
    assert_ne!(two.render(&shown, 13), first);
    assert_ne!(three.render(&shown, 12), first);
    assert_eq!(one.given(), two.given());
    assert_ne!(one.given(), three.given());
}
