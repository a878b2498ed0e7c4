//! One image, a pair with the curve in space, and a start from nothing.
//!
//! A needle goes in and comes out again, so that the pictures can be gone through without end.
#![expect(clippy::unwrap_used, reason = "a bench may stop")]

#[path = "../tests/needle_pictures/mod.rs"]
mod needle_pictures;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use needle_pictures::film::Film;

fn image(c: &mut Criterion) {
    let mut group = c.benchmark_group("track_image");
    for width in [640, 1280] {
        let mut film = Film::new(width);
        let mut tracker = film.image_tracker();
        group.bench_function(BenchmarkId::from_parameter(width), |b| {
            b.iter(|| film.follow(black_box(&mut tracker)).unwrap());
        });
    }
    group.finish();
}

fn pair(c: &mut Criterion) {
    let mut group = c.benchmark_group("track_pair_3d");
    for width in [640, 1280] {
        let mut film = Film::new(width);
        let mut tracker = film.stereo_tracker();
        group.bench_function(BenchmarkId::from_parameter(width), |b| {
            b.iter(|| film.track(black_box(&mut tracker)));
        });
    }
    group.finish();
}

fn reinitialise(c: &mut Criterion) {
    let mut group = c.benchmark_group("reinitialise");
    let film = Film::new(1280);
    let mut tracker = film.stereo_tracker();
    group.bench_function(BenchmarkId::from_parameter(1280), |b| {
        b.iter(|| film.find_again(black_box(&mut tracker)));
    });
    group.bench_function("1280, nothing known", |b| {
        b.iter(|| film.find_afresh(black_box(&mut tracker)));
    });
    group.finish();
}

criterion_group!(benches, image, pair, reinitialise);
criterion_main!(benches);
