//! The picture's flaws one by one, each against its setting.

use nalgebra::{Matrix3, Vector3};

use super::scene::{needle, rig};
use crate::camera::{CameraSettings, Side, Through, calibration_boards};

/// The left and right image without needle, as deviations from the flat screen.
fn screen(change: impl FnOnce(&mut CameraSettings)) -> [Vec<f64>; 2] {
    let mut settings = CameraSettings::ideal();
    change(&mut settings);
    rig(&settings, 4).empty(0).map(|image| {
        let pixels = image.pixels().iter();
        pixels.map(|p| f64::from(*p) / 200.0 - 1.0).collect()
    })
}

fn at(values: &[f64], x: usize, y: usize) -> f64 {
    values[y * 640 + x]
}

fn deviation(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt()
}

#[test]
fn brightness_varies_as_set() {
    for image in screen(|s| s.backlight.gradient = 0.15) {
        let along = at(&image, 639, 240) - at(&image, 0, 240);
        let down = at(&image, 320, 479) - at(&image, 320, 0);
        // Over one width, in whatever direction; pixels are whole greys of 200.
        let change = along.hypot(down * 640.0 / 480.0);
        assert!((change - 0.15).abs() < 0.01, "{change}");
    }
    for image in screen(|s| s.backlight.vignetting = 0.2) {
        for (x, y) in [(0, 0), (639, 0), (0, 479), (639, 479)] {
            assert!((at(&image, x, y) + 0.2).abs() < 4e-3);
        }
        assert_eq!(at(&image, 320, 240), 0.0);
    }
    for image in screen(|s| s.backlight.moire = 0.05) {
        // Two sines of half the amplitude each: their variances add to a quarter of its square.
        let sigma = deviation(&image);
        assert!((sigma / 0.025 - 1.0).abs() < 0.05, "{sigma}");
    }
    for image in screen(|s| s.backlight.clouds = 0.03) {
        // Between the nodes, interpolation has less variance: (26 / 35)^2 of it, for 70 nodes.
        let sigma = deviation(&image);
        assert!((sigma / (0.03 * 26.0 / 35.0) - 1.0).abs() < 0.3, "{sigma}");
    }
}

#[test]
fn haze_and_glitter_lighten_the_needle_as_set() {
    let shown = needle(0.08, 0.5, 0.3, 0.0);
    let draw = |haze, specular| {
        let mut settings = CameraSettings::ideal();
        settings.optics.haze = haze;
        settings.optics.specular_grey = specular;
        rig(&settings, 4).render(&shown, 0)
    };
    let plain = draw(0.0, 0.0);
    for (clear, hazy) in plain.iter().zip(&draw(0.5, 0.0)) {
        assert_eq!(clear.pixels().iter().min(), Some(&20));
        // Half of the contrast of 180 is left.
        assert_eq!(hazy.pixels().iter().min(), Some(&110));
    }
    for (dull, shiny) in plain.iter().zip(&draw(0.0, 60.0)) {
        let pairs = dull.pixels().iter().zip(shiny.pixels());
        let added = pairs.map(|(a, b)| i32::from(*b) - i32::from(*a));
        let (least, most) = added.fold((0, 0), |(l, m), d| (d.min(l), d.max(m)));
        assert_eq!(least, 0);
        // At the brightest place of the strip, which is half a pixel wide.
        assert!((20..=60).contains(&most), "{most}");
    }
}

#[test]
fn a_bubble_is_one_place_in_both_images() {
    let mut seen = 0;
    for seed in 0..12 {
        let mut settings = CameraSettings::ideal();
        settings.bubbles.count = 1;
        settings.bubbles.radius_min_mm = 0.6;
        settings.bubbles.radius_max_mm = 0.6;
        let mut rig = rig(&settings, seed);
        let images = rig.empty(0);
        let (mut a, mut b, mut rays) = (Matrix3::zeros(), Vector3::zeros(), Vec::new());
        for (side, image) in Side::BOTH.iter().zip(&images) {
            let (mut sum, mut x_sum, mut y_sum, mut at_rim) = (0.0, 0.0, 0.0, false);
            for y in 0..480usize {
                for (x, p) in image.row(y).iter().enumerate() {
                    let dark = 200.0 - f64::from(*p);
                    if dark > 2.0 {
                        sum += dark;
                        x_sum += dark * x as f64;
                        y_sum += dark * y as f64;
                        at_rim |= x < 2 || y < 2 || x > 637 || y > 477;
                    }
                }
            }
            if sum > 0.0 && !at_rim {
                let view = rig.truth().view(*side);
                let ray = view.ray([x_sum / sum, y_sum / sum], Through::Gel).unwrap();
                let across = Matrix3::identity() - ray.direction * ray.direction.transpose();
                a += across;
                b += across * ray.origin.coords;
                rays.push((ray, across));
            }
        }
        if rays.len() == 2 {
            seen += 1;
            let place = a.try_inverse().unwrap() * b;
            for (ray, across) in rays {
                let off = (across * (place - ray.origin.coords)).norm();
                // A fifth of a pixel.
                assert!(off < 0.05e-3, "{off}");
            }
        }
    }
    assert!(seen >= 4, "{seen}");
}

#[test]
fn a_large_image_with_every_flaw_shows_needle_and_boards() {
    let mut rig = rig(&CameraSettings::harsh().at_1280(), 9);
    let empty = rig.empty(0);
    for (sequence, depth) in [(1, 0.03), (2, 0.06), (3, 0.09)] {
        let pair = rig.render(&needle(depth, 0.8, 1.0, 0.4), sequence);
        for (image, empty) in pair.iter().zip(&empty) {
            assert_eq!((image.width(), image.height()), (1280, 960));
            let rows = |image: &hal::GrayImage| -> f64 {
                image.pixels().iter().map(|p| f64::from(*p)).sum()
            };
            // The needle takes light away; noise of 4 greys averages to 5000 of the sum.
            assert!(rows(image) < rows(empty) - 3e4, "{depth}");
        }
    }
    for board in calibration_boards(rig.truth(), 4, 2) {
        for image in rig.board_pair(&board, 0).unwrap() {
            let (dark, bright) = image.pixels().iter().fold((0, 0), |(d, b), p| {
                (d + u32::from(*p < 60), b + u32::from(*p > 180))
            });
            assert!(dark > 10_000 && bright > 10_000, "{dark} {bright}");
        }
    }
}
