//! Stated covariances against the spread of repeated synthetic calibrations.
#![expect(clippy::unwrap_used, reason = "a test")]

mod synthetic;

use hal::Transform;
use nalgebra::{Isometry3, SMatrix, SVector, Vector6};
use synthetic::{BOARD, gauss, pairs, poses, rig, rng};
use vision::calibrate::{StereoOptions, calibrate_stereo};
use vision::camera::StereoRig;
use vision::register::{RecordedPose, RegistrationOptions, Target, register};

fn pose_error(found: &Isometry3<f64>, truth: &Isometry3<f64>) -> Vector6<f64> {
    let t = found.translation.vector - truth.translation.vector;
    let r = (found.rotation * truth.rotation.inverse()).scaled_axis();
    Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z)
}

fn rig_error(found: &StereoRig, truth: &StereoRig) -> SVector<f64, 24> {
    let mut e = SVector::<f64, 24>::zeros();
    let cameras = [(found.left, truth.left), (found.right, truth.right)];
    for (side, (a, b)) in cameras.into_iter().enumerate() {
        for k in 0..9 {
            e[9 * side + k] = a.intrinsics()[k] - b.intrinsics()[k];
        }
    }
    let pose = pose_error(
        found.right_from_left.isometry(),
        truth.right_from_left.isometry(),
    );
    e.fixed_rows_mut::<6>(18).copy_from(&pose);
    e
}

fn chi2<const N: usize>(e: &SVector<f64, N>, c: &SMatrix<f64, N, N>) -> f64 {
    // Scaled to correlations first: parameters differ by orders of magnitude.
    let s = c.diagonal().map(f64::sqrt);
    let scaled = SMatrix::<f64, N, N>::from_fn(|i, j| c[(i, j)] / (s[i] * s[j]));
    let e = e.component_div(&s);
    let x = nalgebra::DMatrix::from_column_slice(N, N, scaled.as_slice())
        .lu()
        .solve(&nalgebra::DVector::from_column_slice(e.as_slice()))
        .unwrap();
    e.iter().zip(x.iter()).map(|(a, b)| a * b).sum()
}

#[test]
fn calibration_errors_follow_the_stated_covariance() {
    const SEEDS: u32 = 40;
    let truth = rig();
    let (mut sum, mut within) = (0.0, 0);
    for seed in 0..SEEDS {
        let mut rng = rng(u64::from(seed));
        let poses = poses(12, 0.6, &mut rng);
        let pairs = pairs(&poses, 0.15, &mut rng);
        let c = calibrate_stereo(
            &BOARD,
            &pairs,
            (640, 480),
            vec![],
            &StereoOptions::default(),
        )
        .unwrap();
        assert!(c.rejected.is_empty(), "{:?}", c.rejected);
        let e = rig_error(&c.rig, &truth);
        let covariance = c.covariance.fixed_view::<24, 24>(0, 0).into_owned();
        sum += chi2(&e, &covariance) / 24.0;
        let normalised = e.component_div(&c.sigmas().fixed_rows::<24>(0));
        within += normalised.iter().filter(|z| z.abs() <= 3.0).count();
    }
    let mean = sum / f64::from(SEEDS);
    let fraction = within as f64 / f64::from(24 * SEEDS);
    println!("chi2 per parameter {mean:.3}; within 3 sigma {fraction:.4}");
    // The mean of 40 x 24 squared normals has a sigma of 0.046; second-order terms add a little.
    assert!((0.85..1.2).contains(&mean), "{mean}");
    assert!(fraction >= 0.985, "{fraction}");
}

/// Flange poses for which the board (or point) it carries is before the cameras.
fn recorded(
    truth: &StereoRig,
    world_from_left: &Isometry3<f64>,
    flange_from_board: &Isometry3<f64>,
    board: bool,
    rng: &mut rand_chacha::ChaCha8Rng,
) -> Vec<RecordedPose> {
    let (sp, sr) = (0.1e-3, 0.5e-3);
    let mut out = Vec::new();
    while out.len() < 20 {
        let left_from_board = &poses(1, 0.5, rng)[0];
        let mut pair = synthetic::pair(truth, left_from_board, 0.15, rng);
        // Where the calibration's boards were: beyond, its distortion is extrapolated.
        let covered = |p: &nalgebra::Point2<f64>| {
            (50.0..590.0).contains(&p.x) && (40.0..440.0).contains(&p.y)
        };
        if !pair.left.iter().chain(&pair.right).all(covered) {
            continue;
        }
        let world_from_flange = world_from_left * left_from_board * flange_from_board.inverse();
        let mut noise = |s: f64| nalgebra::Vector3::from_fn(|_, _| s * gauss(rng));
        let read = Isometry3::from_parts(
            (world_from_flange.translation.vector + noise(sp)).into(),
            nalgebra::UnitQuaternion::from_scaled_axis(noise(sr)) * world_from_flange.rotation,
        );
        if !board {
            pair.left.truncate(1);
            pair.right.truncate(1);
        }
        out.push(RecordedPose {
            name: format!("pose {}", out.len()),
            world_from_flange: Transform::assume(read),
            left: pair.left,
            right: pair.right,
        });
    }
    out
}

#[test]
fn registration_errors_follow_the_stated_covariance() {
    const SEEDS: u32 = 30;
    let truth = rig();
    let world_from_left = Isometry3::new(
        nalgebra::Vector3::new(0.5, -0.4, 0.6),
        nalgebra::Vector3::new(-1.9, 0.3, 0.2),
    );
    let flange_from_board = Isometry3::new(
        nalgebra::Vector3::new(-0.05, 0.03, 0.08),
        nalgebra::Vector3::new(0.1, 0.2, -0.4),
    );
    for (name, target) in [
        ("board", Target::Board(BOARD)),
        ("point", Target::Point),
        (
            "known point",
            Target::KnownPoint(flange_from_board * nalgebra::Point3::origin()),
        ),
    ] {
        let (mut sum, mut fre, mut tre) = (0.0, 0.0, 0.0);
        for seed in 0..SEEDS {
            let mut rng = rng(1000 + u64::from(seed));
            let boards = poses(15, 0.6, &mut rng);
            let seen = pairs(&boards, 0.15, &mut rng);
            let c = calibrate_stereo(&BOARD, &seen, (640, 480), vec![], &StereoOptions::default())
                .unwrap();
            let is_board = matches!(target, Target::Board(_));
            let recorded = recorded(
                &truth,
                &world_from_left,
                &flange_from_board,
                is_board,
                &mut rng,
            );
            let options = RegistrationOptions::default();
            let r = register(&c.rig, Some(&c.covariance), &target, &recorded, &options).unwrap();
            let e = pose_error(r.world_from_left_camera.isometry(), &world_from_left);
            sum += chi2(&e, &r.covariance) / 6.0 / f64::from(SEEDS);
            fre += r.fre / f64::from(SEEDS);
            let at = hal::Position::new(nalgebra::Point3::new(0.04, 0.0, 0.42));
            tre += r.predicted_tre(&at) / f64::from(SEEDS);
        }
        println!(
            "{name}: chi2 per parameter {sum:.3}, FRE {:.3} mm, predicted TRE {:.3} mm",
            fre * 1e3,
            tre * 1e3
        );
        // Sigma of the mean of 30 x 6 squared normals: 0.105. The scaling by chi2 > 1 makes the
        // stated covariance a little too large.
        assert!((0.6..1.35).contains(&sum), "{name}: {sum}");
    }
}
