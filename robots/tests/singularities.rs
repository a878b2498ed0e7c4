//! Joint rates from twists, away from, near and in the three singularities of the Viper.
#![expect(clippy::unwrap_used, reason = "a helper that fails fails its test")]

use hal::telemetry::Limit;
use hal::{Joints, Twist};
use nalgebra::{Matrix6, Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use robots::arms::{FLANGE, NEEDLE_BASE, VIPER_S650};
use robots::kinematics::{Chain, RateSettings};

const PERIOD: f64 = 0.016;

fn weighted(chain: &Chain, q: &Joints, length: f64) -> Matrix6<f64> {
    let mut jacobian: Matrix6<f64> = chain.jacobian(q).fixed_columns::<6>(0).into_owned();
    jacobian.fixed_rows_mut::<3>(0).scale_mut(1.0 / length);
    jacobian
}

#[test]
fn away_from_singularities_the_twist_is_realised_exactly() {
    let chain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
    let settings = RateSettings::default();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut exact = 0;
    for _ in 0..2000 {
        let q: Vec<f64> = chain
            .limits()
            .iter()
            .map(|limit| rng.random_range(limit.lower..limit.upper))
            .collect();
        let q = Joints::from_slice(&q).unwrap();
        let v =
            Vector6::from_fn(|k, _| rng.random_range(-1.0..1.0) * if k < 3 { 0.005 } else { 0.05 });
        let twist = Twist::from_vector(&v);
        let out = chain.rates(&q, &twist, &settings);
        let svd = weighted(&chain, &q, settings.length).singular_values();
        assert!((out.dexterity - svd.min()).abs() < 1e-6);
        assert_eq!(
            out.limits.contains(&Limit::Singularity),
            out.dexterity < settings.threshold
        );
        if out.limits.is_empty() {
            exact += 1;
            // The normal equations square the condition number, here up to (15 / 0.05)^2.
            assert!((out.realised.to_vector() - v).norm() < 1e-10 * v.norm());
        }
    }
    assert!(exact > 1000, "{exact}");
}

#[test]
fn a_twist_too_fast_for_the_joints_is_slowed_in_its_direction() {
    let chain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
    let q = Joints::from([0.1, -1.2, 2.4, 0.2, 0.9, -0.3]);
    let wanted = Vector6::new(3.0, -2.0, 1.0, 5.0, 30.0, -20.0);
    let out = chain.rates(&q, &Twist::from_vector(&wanted), &RateSettings::default());
    let realised = out.realised.to_vector();
    let scale = realised.norm() / wanted.norm();
    assert!(scale < 0.9 && (realised - wanted * scale).norm() < 1e-9 * realised.norm());
    let [Limit::JointVelocity(joint)] = out.limits[..] else {
        panic!("{:?}", out.limits);
    };
    let joint = usize::from(joint);
    assert!((out.rates[joint].abs() - chain.limits()[joint].velocity).abs() < 1e-9);
    for (rate, limit) in out.rates.iter().zip(chain.limits()) {
        assert!(rate.abs() <= limit.velocity * (1.0 + 1e-12));
    }
}

#[test]
fn what_is_not_finite_gives_standstill() {
    let chain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
    let q = Joints::from([0.1, -1.2, 2.4, 0.2, 0.9, -0.3]);
    let mut twist = Twist::zero();
    twist.linear.x = f64::NAN;
    let settings = RateSettings::default();
    assert!(chain.rates(&q, &twist, &settings).rates.max_abs() == 0.0);
    let lost = q.map(|_| f64::INFINITY);
    assert!(
        chain
            .rates(&lost, &Twist::zero(), &settings)
            .rates
            .max_abs()
            == 0.0
    );
}

#[test]
fn twists_of_any_size_and_settings_of_any_kind_give_numbers() {
    let chain = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
    let away = Joints::from([0.1, -1.2, 2.4, 0.2, 0.9, -0.3]);
    let wrist = Joints::from([0.1, -1.2, 2.4, 0.2, 0.0, -0.3]);
    for q in [away, wrist, away.map(|x| x * 1e300)] {
        for size in [1e-300, 1.0, 1e150, f64::MAX] {
            let twist =
                Twist::from_vector(&Vector6::new(0.3, -0.2, 1.0, 0.5, 0.1, -0.7).map(|x| x * size));
            for length in [0.1, 1e-9, 0.0, -1.0, f64::NAN, f64::INFINITY] {
                for threshold in [0.05, 0.0, -1.0, f64::NAN, f64::INFINITY] {
                    let out = chain.rates(&q, &twist, &RateSettings { length, threshold });
                    assert!(out.rates.is_finite() && out.realised.is_finite(), "{out:?}");
                    for (rate, limit) in out.rates.iter().zip(chain.limits()) {
                        assert!(rate.abs() <= limit.velocity * (1.0 + 1e-12), "{out:?}");
                    }
                }
                assert!(chain.dexterity(&q, length).is_finite());
            }
        }
    }
}

/// A posture just before a singularity and the joint that leads through it.
fn approaches() -> [(&'static str, Joints, usize, f64); 3] {
    let chain = Chain::from_urdf(VIPER_S650, FLANGE).unwrap();
    let wrist_x = |q: &Joints| {
        let pose = chain.forward(q);
        (pose * nalgebra::Point3::from(Vector3::new(0.0, 0.0, -0.080))).x
    };
    // Lean back until the wrist is above axis 1.
    let mut shoulder = Joints::from([0.0, 0.0, 2.0, 0.3, 0.9, 0.0]);
    let (mut front, mut behind) = (-0.8, -3.0);
    for _ in 0..60 {
        shoulder[1] = 0.5 * (front + behind);
        if wrist_x(&shoulder) > 0.0 {
            front = shoulder[1];
        } else {
            behind = shoulder[1];
        }
    }
    shoulder[1] += 0.3;
    [
        (
            "wrist",
            Joints::from([0.1, -1.2, 2.4, 0.2, 0.3, -0.3]),
            4,
            -1.0,
        ),
        (
            "elbow",
            Joints::from([0.1, -1.2, 106.966_f64.to_radians() + 0.3, 0.2, 0.9, 0.0]),
            2,
            -1.0,
        ),
        ("shoulder", shoulder, 1, -1.0),
    ]
}

#[test]
fn rates_stay_bounded_through_the_three_singularities() {
    let chain = Chain::from_urdf(VIPER_S650, FLANGE).unwrap();
    let settings = RateSettings::default();
    // Needle speed: 5 mm/s or its equal in rotation, with as much again in the direction that
    // the singularity takes away.
    let speed = 0.005 / settings.length;
    let bound = 2.0 * speed / settings.threshold;
    for (name, start, joint, sense) in approaches() {
        let mut q = start;
        let (mut least, mut said, mut fastest) = (f64::INFINITY, 0, 0.0_f64);
        for step in 0.. {
            assert!(step < 20_000, "{name}: stuck at {q:?}");
            let jacobian = weighted(&chain, &q, settings.length);
            let svd = jacobian.svd(true, false);
            let lost = svd.u.unwrap().column(5).into_owned();
            let mut through = jacobian.column(joint) * sense;
            through *= speed / through.norm();
            let mut wanted: Vector6<f64> = through + lost * speed;
            wanted.fixed_rows_mut::<3>(0).scale_mut(settings.length);
            let out = chain.rates(&q, &Twist::from_vector(&wanted), &settings);
            least = least.min(out.dexterity);
            fastest = fastest.max(out.rates.max_abs());
            assert!(out.rates.max_abs() <= bound, "{name}: {:?}", out.rates);
            assert_eq!(
                out.limits.contains(&Limit::Singularity),
                out.dexterity < settings.threshold
            );
            said += u32::from(out.limits.contains(&Limit::Singularity));
            q = q.zip(&out.rates, |q, rate| q + rate * PERIOD);
            if sense * (q[joint] - start[joint]) > 0.6 {
                break;
            }
        }
        println!("{name}: least dexterity {least:.1e}, fastest joint {fastest:.3} rad/s");
        assert!(
            least < 5e-3 && said > 10,
            "{name}: only {least:e}, said {said} times"
        );
    }
}
