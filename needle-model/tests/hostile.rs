//! Extreme and hostile input: an error that says so or a needle that keeps its equations, never a
//! panic, a NaN or an endless search.

#![expect(clippy::unwrap_used, reason = "a failed set-up fails the test")]

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use needle_model::{
    Bevel, Case, Equilibrium, EquilibriumError, EstimationSettings, Estimator, Insertion,
    InsertionError, InsertionSettings, Needle, PathLaw, Prediction, RestPoint, Sensitivities,
    Spring, TipLoad, Tissue,
};
use proptest::prelude::*;

fn bevel() -> Bevel {
    Bevel::plane_cut(24_f64.to_radians(), 0.7e-3).unwrap()
}

fn tissue(k: f64) -> Tissue {
    Tissue::uniform(Vector3::zeros(), Vector3::z(), k).unwrap()
}

fn start(rest_point: RestPoint) -> Insertion {
    let settings = InsertionSettings {
        rest_point,
        ..InsertionSettings::default()
    };
    Insertion::new(
        Needle::biopsy(),
        bevel(),
        tissue(1e4),
        settings,
        &base_at(0.0),
    )
    .unwrap()
}

fn base_at(depth: f64) -> Isometry3<f64> {
    Isometry3::translation(0.0, 0.0, depth - Needle::biopsy().length())
}

/// The reference data's fields, every one of any size.
fn wild_case() -> impl Strategy<Value = Case> {
    let size = |low: f64, high: f64| (low..high).prop_map(|x| 10_f64.powf(x));
    let needle = (
        size(-2.0, 0.0),
        size(-4.0, -2.5),
        0.0..0.95,
        size(9.0, 12.0),
    );
    let pose = (-3.2..3.2, -1.6..1.6, -3.2..3.2, -0.02..0.02, -0.02..0.02);
    let springs = (
        0_usize..300,
        0.0..1.2,
        size(-3.0, 7.0),
        -20.0..20.0,
        0.0..2e-3,
    );
    let load = (-3.0..3.0, -1.0..1.0, size(-6.0, 1.0));
    (needle, pose, springs, load).prop_map(|(needle, pose, springs, load)| {
        let length = needle.0;
        let (count, share, stiffness, bend, noise) = springs;
        let depth = share * length;
        let pitch = depth / (count.max(1) as f64);
        let springs = (0..count)
            .map(|i| {
                let s = pitch * i as f64;
                let jitter = noise * (12.9 * i as f64).sin();
                let rest = [bend * s * s + jitter, -0.4 * bend * s * s, s];
                (rest, stiffness)
            })
            .collect();
        let tilt = if load.2 > 1.0 { 1.0 } else { 0.05 };
        let base = Isometry3::from_parts(
            Translation3::new(pose.3, pose.4, depth - 0.98 * length),
            UnitQuaternion::from_euler_angles(pose.0 * tilt, pose.1 * tilt, pose.2),
        );
        let m = base.to_homogeneous();
        Case {
            length_m: length,
            outer_diameter_m: needle.1,
            inner_diameter_m: needle.1 * needle.2,
            young_modulus_pa: needle.3,
            world_from_base: std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)])),
            tip_force_n: load.0 * load.2,
            tip_moment_nm: load.1 * load.2 * 1e-3,
            springs,
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, rng_seed: proptest::test_runner::RngSeed::Fixed(17), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn wild_cases_are_solved_or_refused(case in wild_case()) {
        if let Ok(shape) = case.solve() {
            let all = shape.tip_m.iter().chain(&shape.tip_direction)
                .chain(shape.spring_points_m.iter().flatten())
                .chain(shape.shape.iter().flatten())
                .chain(shape.j_tip_base.iter().flatten());
            for value in all {
                prop_assert!(value.is_finite(), "{case:?} {shape:?}");
            }
            // Chords of the samples, 2 mm apart, are no longer than the needle.
            let chords: f64 = shape.shape.windows(2).map(|w| {
                (1..4).map(|k| (w[1][k] - w[0][k]).powi(2)).sum::<f64>().sqrt()
            }).sum();
            prop_assert!(chords <= case.length_m + 2e-9, "{} of {}", chords, case.length_m);
        }
    }
}

fn solved(k: f64, count: u32, base: &Isometry3<f64>) -> Result<Equilibrium, EquilibriumError> {
    let pitch = 0.06 / f64::from(count);
    let springs: Vec<_> = (0..count)
        .map(|i| {
            let z = pitch * (f64::from(i) + 0.5);
            Spring {
                rest: Vector3::new(0.5 * z * z, -0.7 * z * z, z),
                stiffness: k * pitch,
            }
        })
        .collect();
    let mut needle = Equilibrium::new(Needle::biopsy(), *base);
    needle.solve(
        base,
        &springs,
        TipLoad {
            force: -5e-3,
            bending: -1e-6,
        },
    )?;
    Ok(needle)
}

#[test]
fn one_to_three_hundred_springs_of_any_stiffness_balance() {
    for count in [1, 2, 3, 300] {
        for k in [1e-3, 1.0, 1e4, 1e7, 1e9] {
            let mut needle = solved(k, count, &base_at(0.0605)).unwrap();
            let r = needle.residuals();
            assert!(
                r.arc < 1e-9 && r.length < 1e-9,
                "{count} springs, K {k:e}: {r:?}"
            );
            let j = needle.tip_jacobian().unwrap();
            assert!(j.iter().all(|x| x.is_finite()));
            let mut all = Sensitivities::default();
            needle.sensitivities(&mut all).unwrap();
            assert!(all.tip().iter().all(|x| x.is_finite()));
        }
    }
}

#[test]
fn a_base_turned_away_is_refused_or_solved() {
    for degrees in [5.0_f64, 20.0, 45.0, 80.0, 90.0, 120.0, 180.0] {
        let turn = UnitQuaternion::from_euler_angles(degrees.to_radians(), 0.0, 0.0);
        match solved(1e4, 24, &(base_at(0.0605) * turn)) {
            Ok(needle) => {
                let r = needle.residuals();
                assert!(r.length < 1e-9 && r.arc < 1e-9, "{degrees}: {r:?}");
                assert!(degrees < 40.0, "{degrees}");
            }
            Err(EquilibriumError::TooShort { .. }) => assert!((40.0..100.0).contains(&degrees)),
            Err(error) => assert!(
                degrees > 100.0 && matches!(error, EquilibriumError::BehindBase { index: 0, .. }),
                "{degrees}: {error}"
            ),
        }
    }
}

#[test]
fn a_needle_pushed_in_to_its_holder_keeps_its_length_and_is_refused_beyond() {
    for rest_point in [RestPoint::ModelCentre, RestPoint::CuttingEdge] {
        let mut insertion = start(rest_point);
        for mm in 1..=140 {
            let result = insertion.insert(&base_at(1e-3 * f64::from(mm)), None);
            let needle = insertion.equilibrium();
            let r = needle.residuals();
            assert!(r.length < 1e-9 && r.arc < 1e-9, "{mm} mm: {r:?}");
            assert!(needle.free_length() > 0.0);
            match result {
                Ok(()) => assert!(mm <= 126, "{mm}"),
                Err(InsertionError::Equilibrium(EquilibriumError::BehindBase { .. })) => {
                    assert!(mm >= 126, "{mm}");
                }
                Err(error) => panic!("{mm} mm: {error}"),
            }
        }
    }
}

#[test]
fn steps_of_any_length_and_turn_end() {
    let mut insertion = start(RestPoint::Measured);
    for i in 1..=30 {
        insertion
            .insert(&base_at(1e-3 * f64::from(i)), None)
            .unwrap();
    }
    let tip = insertion.equilibrium().tip_position();
    for far in [1.0, 1e3, 1e9, 1e300] {
        for axis in 0..6 {
            let sign = if axis < 3 { 1.0 } else { -1.0 };
            let base = Isometry3::from(Vector3::ith(axis % 3, sign * far));
            let mut other = insertion.clone();
            let result = other.insert(&base, None);
            let needle = other.equilibrium();
            match result {
                Ok(()) => assert!(far < 2.0 && needle.springs().is_empty(), "{far:e} {axis}"),
                Err(error) => {
                    let too_long = matches!(error, InsertionError::Step { .. });
                    assert_eq!(too_long, far > 2.0, "{error}");
                    assert!((needle.tip_position() - tip).norm() < 1e-7);
                }
            }
        }
    }
    for (degrees, most) in [(30.0_f64, 1e-9), (60.0, 1e-9), (90.0, 1e-8), (170.0, 1e-9)] {
        let turn = UnitQuaternion::from_euler_angles(degrees.to_radians(), 0.0, 0.0);
        let mut other = insertion.clone();
        let _ = other.insert(&(base_at(0.03) * turn), None);
        let r = other.equilibrium().residuals();
        assert!(r.length < most && r.shear < 1e-6, "{degrees}: {r:?}");
    }
    let fine = InsertionSettings {
        pitch: 1e-9,
        ..InsertionSettings::default()
    };
    let refused = Insertion::new(Needle::biopsy(), bevel(), tissue(1e4), fine, &base_at(0.0));
    assert!(matches!(
        refused,
        Err(InsertionError::Setting { name: "pitch", .. })
    ));
}

#[test]
fn predictions_are_numbers_or_errors() {
    let base = base_at(0.02);
    let path: Vec<_> = (0..=8)
        .map(|i| Vector3::z() * (2.5e-3 * f64::from(i)))
        .collect();
    for k in [1e-3, 1.0, 1e4, 1e7, 1e12] {
        for compliance in [0.0, 0.17, 1e3, 1e9, -1e3] {
            for axial_load in [0.0, 0.4, 3.0, 1e6] {
                for bias in [0.0, 1.0, 1e200] {
                    let law = PathLaw {
                        tip_compliance: compliance,
                        axial_load,
                        bias: Vector2::new(bias, 0.0),
                        ..PathLaw::default()
                    };
                    let frame = Isometry3::identity();
                    let Ok(p) = Prediction::new(
                        &Needle::biopsy(),
                        &tissue(k),
                        law,
                        &frame,
                        &base,
                        path.iter().copied(),
                    ) else {
                        continue;
                    };
                    if let Ok(r) = p.roll_out(0.08, 1.25e-3) {
                        let all = [
                            r.free.x,
                            r.free.y,
                            r.a_pivot,
                            r.a_shift,
                            r.bevel,
                            r.slope.x,
                            r.reaction.x,
                        ];
                        assert!(
                            all.iter().all(|x| x.is_finite()),
                            "K {k:e} C {compliance:e} P {axial_load} b {bias:e}: {r:?}"
                        );
                    }
                    if let Ok(a) = p.authority() {
                        assert!(
                            [a.shift, a.tilt, a.pivot].iter().all(|x| x.is_finite()),
                            "K {k:e} P {axial_load}: {a:?}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn estimates_of_nonsense_are_numbers_or_errors() {
    let line = |x: f64| {
        (0..10)
            .map(|i| Vector3::new(x, 0.0, 5e-3 * f64::from(i)))
            .collect()
    };
    let nonsense: [Vec<_>; 3] = [
        vec![Vector3::new(0.0, 0.0, 0.03); 10],
        line(5.0),
        line(1e200),
    ];
    for k in [1e-3, 1e4, 1e7] {
        let needle = solved(k, 24, &base_at(0.0605)).unwrap();
        for settings in [EstimationSettings::paper(), EstimationSettings::joint()] {
            for points in &nonsense {
                let mut estimator = Estimator::new(settings, &needle).unwrap();
                if let Ok(fit) = estimator.fit(&needle, k, points) {
                    let all = [fit.stiffness_factor, fit.load_factor, fit.rms];
                    assert!(all.iter().all(|x| x.is_finite()), "{fit:?}");
                    assert!(!fit.identified[0], "{fit:?}");
                }
            }
        }
    }
}

#[test]
fn a_fit_with_the_tip_on_a_spring_does_not_panic() {
    let mut insertion = start(RestPoint::CuttingEdge);
    for i in 1..=400 {
        insertion
            .insert(&base_at(0.1e-3 * f64::from(i)), None)
            .unwrap();
    }
    // Draw the needle back until its tip is on a spring, to rounding on either side.
    let (mut low, mut high, mut negative) = (0.035, 0.04, 0);
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        let mut drawn = insertion.clone();
        drawn.move_base(&base_at(middle)).unwrap();
        if drawn.springs_ahead() > 1 {
            low = middle;
        } else {
            high = middle;
        }
        let needle = drawn.equilibrium();
        let free = needle.free_length();
        let mut points: Vec<_> = (0..20)
            .map(|k| needle.point(free + 2e-3 * f64::from(k)))
            .collect();
        points.push(needle.tip_position());
        points.push(needle.tip_position() + needle.tip_axis() * 1e-6);
        let mut estimator = Estimator::new(EstimationSettings::joint(), needle).unwrap();
        let fit = estimator.fit(needle, 1e4, &points).unwrap();
        assert!(fit.rms < 1e-8, "{fit:?}");
        negative += u32::from(needle.segments().any(|segment| segment.length < 0.0));
    }
    assert!(
        negative > 0,
        "the last segment was never shorter than nothing"
    );
}
