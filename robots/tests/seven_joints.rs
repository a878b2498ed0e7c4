//! Arms of seven joints: poses they can reach are solved, and only the last joint spins the needle.
#![expect(clippy::unwrap_used, reason = "a helper that fails fails its test")]

use hal::{Joints, Twist};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use robots::kinematics::{Chain, JointKind, RateSettings, Turns};

fn arms() -> [Chain; 6] {
    [
        include_str!("data/arms/franka_panda.urdf"),
        include_str!("data/arms/franka_fr3.urdf"),
        include_str!("data/arms/kuka_iiwa7.urdf"),
        include_str!("data/arms/rethink_sawyer.urdf"),
        include_str!("data/arms/kinova_gen3.urdf"),
        include_str!("data/arms/motoman_sia10.urdf"),
    ]
    .map(|urdf| Chain::from_urdf(urdf, "tool0").unwrap())
}

/// Joints within `share` of their ranges, anywhere in the circle where there are no ends.
fn random(chain: &Chain, rng: &mut ChaCha8Rng, share: f64) -> Joints {
    let mut q = Joints::zeros(chain.len()).unwrap();
    let joints = chain.limits().iter().zip(chain.kinds());
    for (q, (limit, kind)) in q.iter_mut().zip(joints) {
        let (middle, half) = if *kind == JointKind::Continuous {
            (0.0, 3.1)
        } else {
            (
                0.5 * (limit.lower + limit.upper),
                0.5 * (limit.upper - limit.lower),
            )
        };
        *q = middle + share * half * rng.random_range(-1.0..1.0);
    }
    q
}

#[test]
fn poses_that_seven_joints_reach_are_solved() {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    for chain in arms() {
        assert!(!chain.is_exhaustive());
        for _ in 0..20 {
            let q = random(&chain, &mut rng, 0.98);
            let pose = chain.forward(&q);
            let solutions = chain.inverse(&pose, Turns::One);
            assert!(!solutions.is_empty(), "{q:?}");
            for solution in solutions {
                let apart = chain.forward(&solution).to_homogeneous() - pose.to_homogeneous();
                assert!(chain.within_limits(&solution) && apart.norm() < 1e-9);
            }
        }
    }
}

#[test]
fn a_spin_moves_the_last_of_seven_joints_alone() {
    let mut rng = ChaCha8Rng::seed_from_u64(22);
    let settings = RateSettings::default();
    for chain in arms() {
        let sense = chain.spin().unwrap().sense;
        for _ in 0..50 {
            let q = random(&chain, &mut rng, 0.8);
            let axis = chain.forward(&q).rotation * Vector3::z();
            let spin = Twist {
                linear: Vector3::zeros(),
                angular: axis * 0.7,
            };
            let rates = chain.rates(&q, &spin, &settings).rates;
            assert!((rates[6] - 0.7 * sense).abs() < 1e-9, "{rates:?}");
            assert!(rates[..6].iter().all(|rate| rate.abs() < 1e-9), "{rates:?}");
            let rest = chain.rates(&q, &Twist::zero(), &settings).rates;
            assert!(rest.max_abs() < 1e-15, "{rest:?}");
        }
    }
}

#[test]
fn any_twist_is_realised_and_spare_joints_drift_to_their_middles() {
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    let settings = RateSettings::default();
    for chain in arms() {
        let (mut realised, mut nearer) = (0, 0);
        for _ in 0..60 {
            let q = random(&chain, &mut rng, 0.8);
            let mut draw = |size: f64| Vector3::from_fn(|_, _| rng.random_range(-size..size));
            let twist = Twist {
                linear: draw(2e-3),
                angular: draw(0.05),
            };
            let out = chain.rates(&q, &twist, &settings);
            if out.dexterity < settings.threshold {
                continue;
            }
            let apart = (out.realised.to_vector() - twist.to_vector()).norm();
            assert!(apart < 1e-12, "{apart:e}");
            realised += 1;
            // To and fro at once: what is left is the drift.
            let back = Twist {
                linear: -twist.linear,
                angular: -twist.angular,
            };
            let drift = out
                .rates
                .zip(&chain.rates(&q, &back, &settings).rates, |a, b| {
                    0.5 * (a + b)
                });
            let towards: f64 = (0..6)
                .filter(|i| chain.kinds()[*i] == JointKind::Revolute)
                .map(|i| {
                    let limit = chain.limits()[i];
                    drift[i] * (0.5 * (limit.lower + limit.upper) - q[i])
                })
                .sum();
            // The last joint keeps the needle from turning meanwhile.
            let fastest = drift[..6].iter().fold(0.0_f64, |most, x| most.max(x.abs()));
            assert!(fastest < 0.021, "{drift:?}");
            nearer += usize::from(towards > 0.0);
        }
        assert!(realised > 30, "{realised}");
        assert!(nearer * 10 > realised * 9, "{nearer} of {realised}");
    }
}
