//! Detection, refinement, solving and triangulation.
#![expect(clippy::unwrap_used, reason = "a bench may stop")]

#[path = "../tests/synthetic/mod.rs"]
mod synthetic;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use hal::GrayImage;
use nalgebra::{Isometry3, Matrix2, Unit, Vector3};
use synthetic::{BOARD, pairs, poses, render, rig, rng};
use vision::calibrate::{StereoOptions, calibrate_stereo};
use vision::camera::{Container, DistortedPx, FlatWindow, StereoRig, triangulate};
use vision::detect::{RefineOptions, find_board, refine_board};

/// A photograph where there is one, else a rendered board.
#[expect(clippy::disallowed_methods, reason = "told where the photographs are")]
fn picture() -> GrayImage {
    let photograph = std::env::var("NEEDLE_STEER_REFERENCE")
        .ok()
        .and_then(|folder| {
            let path = std::path::Path::new(&folder).join("stereo/left01.jpg");
            vision::files::read_image(&path).ok()
        });
    photograph.unwrap_or_else(|| {
        let mut rng = rng(1);
        let pose = poses(1, 0.5, &mut rng)[0];
        render(&rig().left, &pose, &BOARD, 3.0, &mut rng)
    })
}

fn detection(c: &mut Criterion) {
    let image = picture();
    let mut group = c.benchmark_group("detect_board");
    group.bench_function(BenchmarkId::from_parameter("640"), |b| {
        b.iter(|| find_board(black_box(&image), BOARD.size).unwrap());
    });
    group.finish();
    let found = find_board(&image, BOARD.size).unwrap();
    let mut group = c.benchmark_group("refine_board");
    group.bench_function(BenchmarkId::from_parameter("640"), |b| {
        b.iter(|| {
            let mut board = found.clone();
            refine_board(black_box(&image), &mut board, &RefineOptions::default()).unwrap();
            board
        });
    });
    group.finish();
}

fn solving(c: &mut Criterion) {
    let mut rng = rng(2);
    let poses = poses(13, 0.6, &mut rng);
    let pairs = pairs(&poses, 0.15, &mut rng);
    let options = StereoOptions::default();
    let mut group = c.benchmark_group("stereo_solve");
    group.bench_function(BenchmarkId::from_parameter("13"), |b| {
        b.iter(|| {
            calibrate_stereo(&BOARD, black_box(&pairs), (640, 480), vec![], &options).unwrap()
        });
    });
    group.finish();
}

fn triangulation(c: &mut Criterion) {
    let window = FlatWindow {
        normal: Unit::new_normalize(Vector3::z()),
        distance: 0.447,
        thickness: 0.003,
        wall_index: 1.49,
        gel_index: 1.34,
    };
    let centre = Isometry3::translation(0.0, 0.0, 0.5);
    let turn = Isometry3::rotation(Vector3::y() * core::f64::consts::FRAC_PI_2);
    let mut camera = rig().left;
    (camera.fx, camera.fy) = (2000.0, 2000.0);
    let rig = StereoRig {
        left: camera,
        right: camera,
        right_from_left: hal::Transform::assume(centre * turn * centre.inverse()),
        container: Some(Container {
            left: window,
            right: window,
        }),
    };
    let views = rig.views();
    let point = Vector3::new(0.01, -0.02, 0.51);
    let px: [DistortedPx; 2] = views.map(|v| v.project(&point).unwrap());
    let unit = [Matrix2::identity(); 2];
    let mut group = c.benchmark_group("triangulate");
    group.bench_function(BenchmarkId::from_parameter("refracted"), |b| {
        b.iter(|| triangulate(black_box(&views), black_box(&px), &unit).unwrap());
    });
    group.finish();
}

criterion_group!(benches, detection, solving, triangulation);
criterion_main!(benches);
