//! Kinematics against independent implementations: the crate rs-opw-kinematics on arms with a
//! spherical wrist, products of Denavit-Hartenberg transforms on all three.
#![expect(clippy::unwrap_used, reason = "a helper that fails fails its test")]

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use hal::Joints;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use robots::arms::{FLANGE, VIPER_S650};
use robots::kinematics::{Chain, Turns};
use rs_opw_kinematics::kinematic_traits::Kinematics;
use rs_opw_kinematics::kinematics_impl::OPWKinematics;
use rs_opw_kinematics::parameters::opw_kinematics::Parameters;
use rs_opw_kinematics::pose::Pose;

const KR6_R900: &str = include_str!("../urdf/kr6_r900.urdf");
const UR5E: &str = include_str!("../urdf/ur5e.urdf");

/// Rounding of two different orders of six rotations.
const TOLERANCE: f64 = 1e-12;
const POSES: usize = 10_000;

fn random_joints(chain: &Chain, rng: &mut ChaCha8Rng) -> [f64; 6] {
    core::array::from_fn(|i| {
        let limit = &chain.limits()[i];
        rng.random_range(limit.lower..limit.upper)
    })
}

fn from_peer(pose: &Pose) -> Isometry3<f64> {
    let (t, r) = (pose.translation, pose.rotation);
    Isometry3::from_parts(
        Translation3::new(t.x, t.y, t.z),
        UnitQuaternion::from_quaternion(Quaternion::new(r.w, r.x, r.y, r.z)),
    )
}

fn assert_same(a: &Isometry3<f64>, b: &Isometry3<f64>, tolerance: f64) {
    let error = (a.to_homogeneous() - b.to_homogeneous()).abs().max();
    assert!(error < tolerance, "{error:e}");
}

/// A chain, and the peer with the maker's lengths, joint zeros and senses.
struct Peer {
    chain: Chain,
    opw: OPWKinematics,
}

fn viper() -> Peer {
    Peer {
        chain: Chain::from_urdf(VIPER_S650, FLANGE).unwrap(),
        opw: OPWKinematics::new(Parameters {
            a1: 0.075,
            a2: -0.090,
            b: 0.0,
            c1: 0.335,
            c2: 0.270,
            c3: 0.295,
            c4: 0.080,
            offsets: [0.0, -FRAC_PI_2, FRAC_PI_2, 0.0, 0.0, 0.0],
            sign_corrections: [1; 6],
            dof: 6,
        }),
    }
}

/// The peer's usual model of the KR 6: axes 1, 4 and 6 turned round against the URDF's.
fn kr6() -> Peer {
    Peer {
        chain: Chain::from_urdf(KR6_R900, FLANGE).unwrap(),
        opw: OPWKinematics::new(Parameters {
            a1: 0.025,
            a2: -0.035,
            b: 0.0,
            c1: 0.400,
            c2: 0.455,
            c3: 0.420,
            c4: 0.080,
            offsets: [0.0, -FRAC_PI_2, 0.0, 0.0, 0.0, 0.0],
            sign_corrections: [-1, 1, 1, -1, 1, -1],
            dof: 6,
        }),
    }
}

#[test]
fn forward_kinematics_equals_rs_opw_kinematics() {
    for (peer, seed) in [(viper(), 1), (kr6(), 2)] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        for _ in 0..POSES {
            let q = random_joints(&peer.chain, &mut rng);
            let theirs = from_peer(&peer.opw.try_forward(&q).unwrap());
            assert_same(&peer.chain.forward(&Joints::from(q)), &theirs, TOLERANCE);
        }
    }
}

#[test]
fn inverse_kinematics_has_every_solution_of_rs_opw_kinematics() {
    for (peer, seed) in [(viper(), 3), (kr6(), 4)] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut compared = 0;
        for _ in 0..POSES {
            let q = random_joints(&peer.chain, &mut rng);
            let pose = peer.chain.forward(&Joints::from(q));
            let ours = peer.chain.inverse(&pose, Turns::One);
            for theirs in peer.opw.inverse(&peer.opw.try_forward(&q).unwrap()) {
                let fits = theirs.iter().zip(peer.chain.limits()).all(|(x, limit)| {
                    [-TAU, 0.0, TAU]
                        .iter()
                        .any(|turn| (limit.lower + 1e-6..limit.upper - 1e-6).contains(&(x + turn)))
                });
                // In the wrist's singularity the split between joints 4 and 6 is a choice, and
                // at full stretch both elbows meet.
                let singular = peer.chain.dexterity(&Joints::from(theirs), 0.1) < 1e-4;
                if !fits || singular {
                    continue;
                }
                compared += 1;
                let met = ours.iter().any(|x| {
                    x.iter().zip(theirs).all(|(a, b)| {
                        let turn = a - b;
                        (turn - TAU * (turn / TAU).round()).abs() < 1e-6
                    })
                });
                assert!(met, "{theirs:?} of {q:?} is missing in {ours:?}");
            }
        }
        assert!(compared > 2 * POSES, "{compared}");
    }
}

fn dh(theta: f64, d: f64, a: f64, alpha: f64) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(0.0, 0.0, d),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), theta),
    ) * Isometry3::from_parts(
        Translation3::new(a, 0.0, 0.0),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), alpha),
    )
}

#[test]
fn forward_kinematics_equals_denavit_and_hartenberg() {
    let half = FRAC_PI_2;
    let viper = [
        (0.0, 0.335, 0.075, -half),
        (0.0, 0.0, 0.270, 0.0),
        (-PI, 0.0, 0.090, -half),
        (0.0, 0.295, 0.0, half),
        (0.0, 0.0, 0.0, -half),
        (-PI, 0.080, 0.0, 0.0),
    ];
    let ur5e = [
        (0.0, 0.1625, 0.0, half),
        (0.0, 0.0, -0.425, 0.0),
        (0.0, 0.0, -0.3922, 0.0),
        (0.0, 0.1333, 0.0, half),
        (0.0, 0.0997, 0.0, -half),
        (0.0, 0.0996, 0.0, 0.0),
    ];
    for (urdf, table) in [(VIPER_S650, viper), (UR5E, ur5e)] {
        let chain = Chain::from_urdf(urdf, FLANGE).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        for _ in 0..1000 {
            let q = random_joints(&chain, &mut rng);
            let product = table
                .iter()
                .zip(q)
                .fold(Isometry3::identity(), |pose, ((offset, d, a, alpha), q)| {
                    pose * dh(q + offset, *d, *a, *alpha)
                });
            assert_same(&chain.forward(&Joints::from(q)), &product, TOLERANCE);
        }
    }
}
