//! Stiffness and tip load recovered from shapes of known needles.

use nalgebra::{Isometry3, Vector3};
use needle_model::{Equilibrium, EstimationSettings, Estimator, Needle, Spring, TipLoad, Unknowns};

const PITCH: f64 = 2.5e-3;

/// A needle 60 mm in tissue of stiffness `k_t`, its base moved aside by `shift` since.
fn needle(k_t: f64, load: f64, shift: f64) -> Equilibrium {
    let base = Isometry3::translation(shift, 0.4 * shift, -0.066);
    let springs: Vec<_> = (0..24)
        .map(|i| {
            let z = PITCH * f64::from(i);
            Spring {
                rest: Vector3::new(0.0, -0.7 * z * z, z),
                stiffness: k_t * PITCH,
            }
        })
        .collect();
    let mut needle = Equilibrium::new(Needle::biopsy(), base);
    let force = -k_t * load;
    needle
        .solve(
            &base,
            &springs,
            TipLoad {
                force,
                bending: force * 3e-4,
            },
        )
        .unwrap();
    needle
}

/// Points every 3 mm of the inserted part, with deterministic noise of `sigma` per axis.
fn points(needle: &Equilibrium, sigma: f64) -> Vec<Vector3<f64>> {
    let mut seed = 11_u64;
    let mut uniform = || {
        seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (seed >> 11) as f64 / (1_u64 << 53) as f64
    };
    // Sum of twelve uniforms: nearly normal, variance 1.
    let mut normal = || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
    let free = needle.free_length();
    (0..20)
        .map(|i| {
            let noise = Vector3::from_fn(|_, _| normal()) * sigma;
            needle.point(free + 3e-3 * f64::from(i)) + noise
        })
        .collect()
}

#[test]
fn a_start_twenty_times_wrong_recovers() {
    let truth = needle(1e4, 2e-6, 5e-3);
    let seen = points(&truth, 0.0);
    for wrong in [20.0, 5.0, 1.0, 0.2, 0.05] {
        let start = needle(1e4 * wrong, 2e-6, 5e-3);
        let mut estimator = Estimator::new(EstimationSettings::paper(), &start).unwrap();
        let fit = estimator.fit(&start, 1e4 * wrong, &seen).unwrap();
        println!(
            "start x{wrong}: factor {:.6} {fit:?}",
            fit.stiffness_factor * wrong
        );
        assert!((fit.stiffness_factor * wrong - 1.0).abs() < 1e-3);
        assert!(fit.rms < 1e-7 && fit.identified[0]);
    }
}

#[test]
fn stiffness_and_load_are_told_apart() {
    let truth = needle(1e4, 8e-6, 5e-3);
    let start = needle(3e4, 2e-6, 5e-3);
    let free = EstimationSettings {
        prior_sigma: [f64::INFINITY; 2],
        point_sigma: 0.05e-3,
        ..EstimationSettings::joint()
    };
    let mut estimator = Estimator::new(free, &start).unwrap();
    let fit = estimator.fit(&start, 3e4, &points(&truth, 0.0)).unwrap();
    println!("{fit:?}");
    assert!((fit.stiffness_factor * 3.0 - 1.0).abs() < 1e-3);
    assert!((fit.load_factor / 4.0 - 1.0).abs() < 1e-3);
    // K_T alone absorbs the error of the tip law.
    let alone = EstimationSettings {
        unknowns: Unknowns::Stiffness,
        ..free
    };
    let mut estimator = Estimator::new(alone, &start).unwrap();
    let fit = estimator.fit(&start, 3e4, &points(&truth, 0.0)).unwrap();
    assert!((fit.stiffness_factor * 3.0 - 1.0).abs() > 0.02, "{fit:?}");
}

#[test]
fn the_covariance_is_that_of_the_errors() {
    // Errors over noise scaled to a tenth and to a hundredth: linear, and within 3 sigma.
    let truth = needle(1e4, 8e-6, 5e-3);
    let mut errors = vec![];
    for sigma in [0.05e-3, 0.005e-3] {
        let settings = EstimationSettings {
            prior_sigma: [f64::INFINITY; 2],
            point_sigma: sigma,
            ..EstimationSettings::joint()
        };
        let mut estimator = Estimator::new(settings, &truth).unwrap();
        let fit = estimator.fit(&truth, 1e4, &points(&truth, sigma)).unwrap();
        let logs = [fit.stiffness_factor.ln(), fit.load_factor.ln()];
        for k in 0..2 {
            assert!(
                logs[k].abs() < 3.0 * fit.covariance[(k, k)].sqrt(),
                "{fit:?}"
            );
        }
        assert!(fit.rms > 0.7 * sigma && fit.rms < 1.3 * sigma, "{fit:?}");
        errors.push(logs[0]);
    }
    assert!(
        (errors[0] / errors[1] / 10.0 - 1.0).abs() < 0.2,
        "{errors:?}"
    );
}

#[test]
fn data_that_do_not_identify_are_reported() {
    // A straight needle on its path says nothing about stiffness.
    let base = Isometry3::translation(0.0, 0.0, -0.066);
    let springs: Vec<_> = (0..24)
        .map(|i| Spring {
            rest: Vector3::z() * (PITCH * f64::from(i)),
            stiffness: 25.0,
        })
        .collect();
    let mut straight = Equilibrium::new(Needle::biopsy(), base);
    straight.solve(&base, &springs, TipLoad::default()).unwrap();
    for settings in [EstimationSettings::paper(), EstimationSettings::joint()] {
        let mut estimator = Estimator::new(settings, &straight).unwrap();
        let fit = estimator
            .fit(&straight, 1e4, &points(&straight, 0.25e-3))
            .unwrap();
        println!("{fit:?}");
        assert_eq!(fit.identified, [false; 2]);
        assert!(fit.observability[0] < 0.01);
        assert!(fit.stiffness_factor.is_finite());
    }
}

#[test]
fn bad_input_is_refused() {
    let truth = needle(1e4, 8e-6, 5e-3);
    let bad = EstimationSettings {
        point_sigma: 0.0,
        ..EstimationSettings::paper()
    };
    assert!(Estimator::new(bad, &truth).is_err());
    let mut estimator = Estimator::new(EstimationSettings::joint(), &truth).unwrap();
    assert!(estimator.fit(&truth, 1e4, &[]).is_err());
    assert!(
        estimator
            .fit(&truth, 1e4, &[Vector3::new(f64::NAN, 0.0, 0.0); 5])
            .is_err()
    );
    assert!(estimator.fit(&truth, -1.0, &points(&truth, 0.0)).is_err());
}
