//! Kinematics of the Viper beside two public crates, over the same 64 joint vectors.
//!
//! `k` and `rs-opw-kinematics` are peers to compare with, not parts of the program. `k` solves
//! inverse kinematics by iteration, from a start 0.1 rad away in every joint, to one solution.
#![expect(clippy::expect_used, reason = "the inputs are in the repository")]

use std::f64::consts::FRAC_PI_2;
use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use hal::{Joints, Twist};
use k::InverseKinematicsSolver;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use robots::arms::{FLANGE, VIPER_S650};
use robots::kinematics::{Chain, RateSettings, Turns};
use rs_opw_kinematics::kinematic_traits::Kinematics;
use rs_opw_kinematics::kinematics_impl::OPWKinematics;
use rs_opw_kinematics::parameters::opw_kinematics::Parameters;

const URDF_PATH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/urdf/viper_s650.urdf");

fn viper() -> Chain {
    Chain::from_urdf(VIPER_S650, FLANGE).expect("the URDF is valid")
}

fn rs_opw() -> OPWKinematics {
    OPWKinematics::new(Parameters {
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
    })
}

fn peer_chain() -> k::SerialChain<f64> {
    let chain = k::Chain::<f64>::from_urdf_file(URDF_PATH).expect("the URDF is valid");
    k::SerialChain::from_end(chain.find("joint_6").expect("the URDF has six joints"))
}

fn samples(chain: &Chain) -> Vec<[f64; 6]> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    (0..64)
        .map(|_| {
            core::array::from_fn(|i| {
                let limit = &chain.limits()[i];
                rng.random_range(0.8 * limit.lower..0.8 * limit.upper)
            })
        })
        .collect()
}

/// Calls `f` with one sample after the other.
fn cycle<S, T>(samples: &[S], mut f: impl FnMut(&S) -> T) -> impl FnMut() -> T {
    let mut next = 0;
    move || {
        next = (next + 1) % samples.len();
        f(black_box(&samples[next]))
    }
}

fn fk_jacobian(c: &mut Criterion) {
    let chain = viper();
    let joints = samples(&chain);
    let mut group = c.benchmark_group("fk_jacobian");
    let ours: Vec<Joints> = joints.iter().map(|q| Joints::from(*q)).collect();
    group.bench_function(BenchmarkId::from_parameter("viper"), |b| {
        b.iter(cycle(&ours, |q| chain.forward_jacobian(q)));
    });
    let peer = peer_chain();
    group.bench_function(BenchmarkId::from_parameter("k"), |b| {
        b.iter(cycle(&joints, |q| {
            peer.set_joint_positions_unchecked(q);
            (peer.end_transform(), k::jacobian(&peer))
        }));
    });
    let peer = rs_opw();
    group.bench_function(
        BenchmarkId::from_parameter("rs-opw-kinematics_fk_only"),
        |b| {
            b.iter(cycle(&joints, |q| peer.try_forward(q)));
        },
    );
    group.finish();
}

fn ik(c: &mut Criterion) {
    let chain = viper();
    let joints = samples(&chain);
    let mut group = c.benchmark_group("ik");
    let poses: Vec<_> = joints
        .iter()
        .map(|q| chain.forward(&Joints::from(*q)))
        .collect();
    group.bench_function(BenchmarkId::from_parameter("viper"), |b| {
        b.iter(cycle(&poses, |pose| chain.inverse(pose, Turns::One)));
    });
    let peer = rs_opw();
    let poses: Vec<_> = joints.iter().map(|q| peer.forward(q)).collect();
    group.bench_function(BenchmarkId::from_parameter("rs-opw-kinematics"), |b| {
        b.iter(cycle(&poses, |pose| peer.inverse(pose)));
    });
    let peer = peer_chain();
    let solver = k::JacobianIkSolver::default();
    let targets: Vec<_> = joints
        .iter()
        .map(|q| {
            peer.set_joint_positions_unchecked(q);
            (q.map(|x| x + 0.1), peer.end_transform())
        })
        .collect();
    group.bench_function(BenchmarkId::from_parameter("k"), |b| {
        b.iter(cycle(&targets, |(start, pose)| {
            peer.set_joint_positions_unchecked(start);
            solver.solve(&peer, pose)
        }));
    });
    group.finish();
}

fn rates(c: &mut Criterion) {
    let chain = viper();
    let settings = RateSettings::default();
    let twist = Twist {
        linear: Vector3::new(0.001, -0.002, 0.004),
        angular: Vector3::new(0.01, 0.02, -0.01),
    };
    let joints: Vec<Joints> = samples(&chain).into_iter().map(Joints::from).collect();
    let mut group = c.benchmark_group("rates");
    group.bench_function(BenchmarkId::from_parameter("viper"), |b| {
        b.iter(cycle(&joints, |q| chain.rates(q, &twist, &settings)));
    });
    group.finish();
}

criterion_group!(benches, fk_jacobian, ik, rates);
criterion_main!(benches);
