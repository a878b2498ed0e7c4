//! Inverse kinematics of three arms, two with a spherical wrist and one without, against their own
//! forward kinematics; and of arms that have no analytic solution.
#![expect(clippy::unwrap_used, reason = "a helper that fails fails its test")]

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use hal::Joints;
use nalgebra::{Isometry3, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use robots::arms::{FLANGE, VIPER_S650};
use robots::kinematics::{Chain, Turns};

/// What rounding leaves of a pose after six trigonometric inversions, with room to spare.
const TOLERANCE: f64 = 1e-10;

const KR6_R900: &str = include_str!("../urdf/kr6_r900.urdf");
const UR5E: &str = include_str!("../urdf/ur5e.urdf");

fn random_joints(chain: &Chain, rng: &mut impl Rng) -> Joints {
    let q: Vec<f64> = chain
        .limits()
        .iter()
        .map(|limit| rng.random_range(limit.lower..limit.upper))
        .collect();
    Joints::from_slice(&q).unwrap()
}

fn pose_error(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    let linear = (a.translation.vector - b.translation.vector).norm();
    let rotation = (a.to_homogeneous() - b.to_homogeneous()).norm();
    linear.max(rotation)
}

fn turn_distance(a: &Joints, b: &Joints) -> f64 {
    a.zip(b, |a, b| {
        let turn = a - b;
        turn - TAU * (turn / TAU).round()
    })
    .max_abs()
}

/// Solves for the pose of `q`; checks every solution; returns whether `q` is among them up to
/// full turns, and how many there are.
fn solve_and_check(chain: &Chain, q: &Joints, near: f64) -> (bool, usize) {
    let pose = chain.forward(q);
    let solutions = chain.inverse(&pose, Turns::One);
    for solution in &solutions {
        assert!(chain.within_limits(solution), "{solution:?}");
        let error = pose_error(&chain.forward(solution), &pose);
        assert!(error < TOLERANCE, "{q:?} -> {solution:?}: {error:e}");
    }
    for (i, a) in solutions.iter().enumerate() {
        for b in &solutions[..i] {
            assert!(turn_distance(a, b) > 1e-9, "{a:?} twice");
        }
    }
    let recovered = solutions.iter().any(|x| turn_distance(x, q) < near);
    (recovered, solutions.len())
}

#[test]
fn every_joint_vector_is_recovered() {
    for (urdf, seed) in [(VIPER_S650, 1), (KR6_R900, 2), (UR5E, 4)] {
        let chain = Chain::from_urdf(urdf, FLANGE).unwrap();
        assert_eq!(chain.opw().is_some(), urdf != UR5E);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        for _ in 0..10_000 {
            let q = random_joints(&chain, &mut rng);
            // Near the elbow's singularity an error of 1e-16 in the pose is 1e-8 in the joint.
            let (recovered, _) = solve_and_check(&chain, &q, 1e-6);
            assert!(recovered, "{q:?}");
        }
    }
}

#[test]
fn parameters_of_the_viper_are_the_published_ones() {
    let chain = Chain::from_urdf(VIPER_S650, FLANGE).unwrap();
    let p = chain.opw().unwrap();
    let lengths = [p.a1, p.a2, p.b, p.c1, p.c2, p.c3, p.c4];
    let published = [0.075, -0.090, 0.0, 0.335, 0.270, 0.295, 0.080];
    for (a, b) in lengths.iter().zip(published) {
        assert!((a - b).abs() < 1e-15, "{lengths:?}");
    }
    let offsets = [0.0, FRAC_PI_2, -FRAC_PI_2, 0.0, 0.0, 0.0];
    for (a, b) in p.offsets.iter().zip(offsets) {
        assert!((a - b).abs() < 1e-15, "{:?}", p.offsets);
    }
    assert!(p.signs.iter().all(|sign| (sign - 1.0).abs() < 1e-15));
}

#[test]
fn close_to_and_in_the_singularities_every_solution_is_exact() {
    for (urdf, elbow) in [
        (VIPER_S650, 106.966_f64.to_radians()),
        (KR6_R900, -(0.035_f64.atan2(0.420))),
    ] {
        let chain = Chain::from_urdf(urdf, FLANGE).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for exponent in 0..=17 {
            for _ in 0..200 {
                let small = 0.5_f64.to_radians() * 10.0_f64.powi(-exponent);
                let off = if exponent == 17 {
                    0.0
                } else {
                    small * rng.random_range(-1.0..1.0)
                };
                let mut q = random_joints(&chain, &mut rng);
                q[4] = off;
                assert!(solve_and_check(&chain, &q, 1.0).1 > 0, "wrist {q:?}");
                let mut q = random_joints(&chain, &mut rng);
                q[2] = elbow + off;
                assert!(solve_and_check(&chain, &q, 1.0).1 > 0, "elbow {q:?}");
            }
        }
    }
}

#[test]
fn the_wrist_on_the_first_axis_is_solved() {
    let chain = Chain::from_urdf(VIPER_S650, FLANGE).unwrap();
    // Wrist centre on axis 1: a1 + a2 sin + c3 cos of the folded arm vanish.
    let flange_at = |x: f64| Isometry3::translation(x, 0.0, 0.83);
    for x in [0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3] {
        let pose = flange_at(x);
        let solutions = chain.inverse(&pose, Turns::One);
        assert!(!solutions.is_empty(), "{x:e}");
        for q in &solutions {
            assert!(pose_error(&chain.forward(q), &pose) < TOLERANCE);
        }
    }
}

#[test]
fn all_turns_are_all_and_inside_the_limits() {
    let chain = Chain::from_urdf(VIPER_S650, FLANGE).unwrap();
    let q = Joints::from([0.2, -0.7, 2.0, 3.1, 0.9, 1.0]);
    let pose = chain.forward(&q);
    let (one, all) = (
        chain.inverse(&pose, Turns::One),
        chain.inverse(&pose, Turns::All),
    );
    // Joint 6 has two turns in every posture, joint 4 (3.1 rad of 3.3) in this one.
    assert!(all.len() > 2 * one.len());
    for x in &all {
        assert!(chain.within_limits(x));
        assert!(pose_error(&chain.forward(x), &pose) < TOLERANCE);
    }
    let nearest = chain.inverse_near(&pose, &q).unwrap();
    assert!(nearest.zip(&q, |a, b| a - b).max_abs() < 1e-10);
}

#[test]
fn joints_without_ends_to_speak_of_do_not_multiply_for_ever() {
    let chain = Chain::from_urdf(VIPER_S650, FLANGE).unwrap();
    let q = Joints::from([0.2, -0.7, 2.0, 0.4, 0.9, 1.0]);
    let pose = chain.forward(&q);
    for (lower, upper) in [(-1e9, 1e9), (1e9, 2e9), (f64::NEG_INFINITY, f64::INFINITY)] {
        let mut limits = chain.limits().to_vec();
        for limit in &mut limits[3..] {
            (limit.lower, limit.upper) = (lower, upper);
        }
        let endless = chain.clone().with_limits(limits).unwrap();
        assert!(endless.inverse(&pose, Turns::One).len() >= 2);
        let all = endless.inverse(&pose, Turns::All);
        assert!((1000..=8 * 65_536).contains(&all.len()), "{}", all.len());
        let far = q.map(|x| x + 700.0 * TAU);
        let near = endless.inverse_near(&pose, &far).unwrap();
        if lower < 0.0 {
            assert!((near[5] - far[5]).abs() < 1e-9, "{near:?}");
        }
    }
    // The nearest of all turns, as by trying all of them.
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for _ in 0..500 {
        let (q, near) = (
            random_joints(&chain, &mut rng),
            random_joints(&chain, &mut rng),
        );
        let pose = chain.forward(&q);
        let distance = |x: &Joints| x.zip(&near, |a, b| a - b).max_abs();
        let best = chain
            .inverse(&pose, Turns::All)
            .iter()
            .map(distance)
            .fold(f64::INFINITY, f64::min);
        let found = distance(&chain.inverse_near(&pose, &near).unwrap());
        assert!((found - best).abs() < 1e-9, "{found} {best}");
    }
}

/// The figure in the documentation of `Chain::inverse`:
/// `cargo test --release -p robots --test inverse completeness -- --ignored --nocapture`
#[test]
#[ignore = "a minute and more; run by hand"]
fn completeness_of_the_numerical_solution() {
    for (by, arms) in [(0.3, 10), (3e-3, 4)] {
        let (mut met, mut all) = (0, 0);
        for seed in 31..31 + arms {
            let (recovered, runs) = recovered(&spoiled(by, seed), 1000);
            (met, all) = (met + recovered, all + runs);
        }
        println!("off by {by}: {met} of {all}");
        assert!(met * 1000 >= all * 995, "off by {by}: {met} of {all}");
    }
}

/// The wrist's centre of the UR5e.
fn wrist_of_ur(chain: &Chain, q: &Joints) -> Vector3<f64> {
    let tip = chain.forward(q);
    tip.translation.vector - tip.rotation * Vector3::z() * 0.0996
}

#[test]
fn the_singularities_of_parallel_axes_are_solved() {
    let chain = Chain::from_urdf(UR5E, FLANGE).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for exponent in 0..=17 {
        for _ in 0..100 {
            let small = 0.5_f64.to_radians() * 10.0_f64.powi(-exponent);
            let off = if exponent == 17 {
                0.0
            } else {
                small * rng.random_range(-1.0..1.0)
            };
            for straight in [0.0, PI, -PI] {
                let mut q = random_joints(&chain, &mut rng);
                q[4] = straight + off;
                assert!(solve_and_check(&chain, &q, 1.0).1 > 0, "wrist {q:?}");
            }
            let mut q = random_joints(&chain, &mut rng);
            q[2] = off;
            assert!(solve_and_check(&chain, &q, 1.0).1 > 0, "elbow {q:?}");
            // The wrist's centre turns with joint 2 about axis 1: one angle brings it nearest.
            let mut q = random_joints(&chain, &mut rng);
            (q[0], q[1]) = (0.0, 0.0);
            let ahead = wrist_of_ur(&chain, &q).x;
            q[1] = FRAC_PI_2;
            let aside = wrist_of_ur(&chain, &q).x;
            q[0] = rng.random_range(-6.0..6.0);
            q[1] = (-ahead).atan2(aside) + off;
            assert!(solve_and_check(&chain, &q, 1.0).1 > 0, "shoulder {q:?}");
        }
    }
}

/// The UR5e with every length and angle off by up to this much \[m, rad\].
fn spoiled(by: f64, seed: u64) -> Chain {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut urdf = String::new();
    for (i, part) in UR5E.split('"').enumerate() {
        let is_value = i % 2 == 1 && urdf.ends_with("xyz=\"") && !urdf.ends_with("axis xyz=\"")
            || i % 2 == 1 && urdf.ends_with("rpy=\"");
        if is_value {
            let mut value = |x: &str| {
                let x: f64 = x.parse().unwrap();
                (x + by * rng.random_range(-1.0..1.0)).to_string()
            };
            let values: Vec<String> = part.split(' ').map(&mut value).collect();
            urdf += &values.join(" ");
        } else {
            urdf += part;
        }
        urdf.push('"');
    }
    Chain::from_urdf(urdf.trim_end_matches('"'), FLANGE).unwrap()
}

/// Share of random joint vectors, away from singularities, that come back.
fn recovered(chain: &Chain, poses: u32) -> (u32, u32) {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let (mut recovered, mut runs) = (0, 0);
    while runs < poses {
        let q = random_joints(chain, &mut rng);
        if chain.dexterity(&q, 0.1) < 0.01 {
            continue;
        }
        runs += 1;
        recovered += u32::from(solve_and_check(chain, &q, 1e-6).0);
    }
    (recovered, runs)
}

#[test]
fn a_calibrated_arm_recovers_every_joint_vector() {
    // From what a URDF's rounding of pi / 2 leaves to more than a calibration finds.
    for (by, seed) in [(1e-9, 11), (1e-6, 12), (1e-3, 13), (3e-3, 14)] {
        let chain = spoiled(by, seed);
        assert!(chain.opw().is_none());
        let (recovered, runs) = recovered(&chain, 100);
        println!("off by {by:e}: {recovered} of {runs}");
        assert_eq!(recovered, runs, "off by {by:e}");
    }
}

#[test]
fn an_arm_of_any_geometry_is_solved_numerically() {
    // No two axes of it meet, are parallel or at right angles.
    for seed in 21..24 {
        let chain = spoiled(0.3, seed);
        let (recovered, runs) = recovered(&chain, 100);
        println!("{recovered} of {runs}");
        // As documented; the solutions found are exact all the same.
        assert!(recovered * 100 >= runs * 99, "{recovered} of {runs}");
    }
}

#[test]
fn poses_out_of_reach_or_not_finite_have_no_solution() {
    for urdf in [VIPER_S650, UR5E] {
        let chain = Chain::from_urdf(urdf, FLANGE).unwrap();
        let far = Isometry3::translation(2.0, 0.0, 0.3);
        assert!(chain.inverse(&far, Turns::All).is_empty());
        let nan = Isometry3::translation(f64::NAN, 0.0, 0.3);
        assert!(chain.inverse(&nan, Turns::All).is_empty());
    }
}

#[test]
fn jacobians_are_the_derivatives_of_the_pose() {
    for urdf in [VIPER_S650, KR6_R900, UR5E] {
        let chain = Chain::from_urdf(urdf, FLANGE).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let h = 1e-6;
        for _ in 0..50 {
            let q = random_joints(&chain, &mut rng);
            let jacobian = chain.jacobian(&q);
            for i in 0..6 {
                let (mut below, mut above) = (q, q);
                below[i] -= h;
                above[i] += h;
                let (a, b) = (chain.forward(&below), chain.forward(&above));
                let linear = (b.translation.vector - a.translation.vector) / (2.0 * h);
                let angular = (b.rotation * a.rotation.inverse()).scaled_axis() / (2.0 * h);
                let column = jacobian.column(i);
                let (v, w): (Vector3<f64>, Vector3<f64>) = (
                    column.fixed_rows::<3>(0).into(),
                    column.fixed_rows::<3>(3).into(),
                );
                // Central difference: error of order h^2 plus rounding over h.
                assert!((linear - v).norm() < 1e-8 && (angular - w).norm() < 1e-8);
            }
        }
    }
}
