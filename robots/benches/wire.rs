//! `wire/encode_decode`: a point and a feedback frame, written and read.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use robots::viper::wire::steer::{Feedback, Point};
use robots::viper::wire::{ByteOrder, Decoder, Frame, Message};

fn encode_decode(criterion: &mut Criterion) {
    let positions = [0.3, -1.2, 2.1, 0.4, -0.7, 1.1];
    let point = Point {
        session: 1,
        sequence: 7,
        flags: 0,
        duration_us: 16_000,
        positions,
    };
    let feedback = Feedback {
        session: 1,
        tick: 99,
        positions,
        ..Feedback::default()
    };
    let frames = [
        Frame::request(Message::Point(point)),
        Frame::topic(Message::Feedback(feedback)),
    ];
    let mut group = criterion.benchmark_group("wire");
    group.bench_function(BenchmarkId::from_parameter("encode_decode"), |bencher| {
        let mut decoder = Decoder::new(ByteOrder::Big, 0);
        bencher.iter(|| {
            let mut seen = 0;
            for frame in &frames {
                let bytes = black_box(frame).encode(ByteOrder::Big);
                let outcome = decoder.push(bytes.as_slice(), |frame| {
                    black_box(frame);
                    seen += 1;
                });
                debug_assert!(outcome.is_ok());
            }
            seen
        });
    });
    group.finish();
}

criterion_group!(benches, encode_decode);
criterion_main!(benches);
