//! `driver/cycle`: one period of the driver at work: command, limits, point, answer, feedback.

use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use hal::{Joints, RateCommand, Stamp};
use robots::viper::driver::Core;
use robots::viper::wire::steer::{Feedback, HelloReply, JOINTS, MAGIC, POINT, PointReply, VERSION};
use robots::viper::wire::{ByteOrder, Frame, HEADER, Message, Status};
use robots::viper::{Config, Dialect, Port, viper_limits};

const PERIOD: Duration = Duration::from_millis(16);

/// A controller that believes everything and is where it was told to be.
struct Controller {
    core: Core,
    now: Stamp,
    tick: i32,
    positions: [f32; JOINTS],
    sequence: u64,
}

impl Controller {
    fn new() -> Option<Self> {
        let core = Core::new(Config::viper("bench", Dialect::Steer)).ok()?;
        let positions = [0.0, -0.75, 2.0, 0.0, 1.0, 0.0];
        let mut this = Self {
            core,
            now: Stamp::ZERO,
            tick: 1,
            positions,
            sequence: 0,
        };
        this.core.tick(this.now);
        this.core.connected(this.now, 1);
        this.core.transmit(1)?;
        let mut reply = HelloReply {
            magic: MAGIC,
            version: VERSION,
            session: 1,
            cycle_us: 16_000,
            watchdog_ms: 100,
            joints: 6,
            ..HelloReply::default()
        };
        for (joint, limit) in viper_limits().iter().enumerate() {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "the wire has single precision"
            )]
            let narrow = [limit.lower, limit.upper, limit.velocity].map(|value| value as f32);
            [reply.lower[joint], reply.upper[joint], reply.speed[joint]] = narrow;
        }
        this.answer(
            Port::Motion,
            &Frame::reply(Message::HelloReply(reply), true),
        );
        this.feed_back();
        this.core.enable(this.now).ok()?;
        Some(this)
    }

    fn answer(&mut self, port: Port, frame: &Frame) {
        self.core
            .received(self.now, 1, port, frame.encode(ByteOrder::Big).as_slice());
    }

    fn feed_back(&mut self) {
        let (tick, positions) = (self.tick, self.positions);
        let feedback = Feedback {
            session: 1,
            tick,
            armed: 1,
            status: Status::READY,
            positions,
            ..Feedback::default()
        };
        self.answer(Port::State, &Frame::topic(Message::Feedback(feedback)));
    }

    /// One period; whether the driver went on.
    fn cycle(&mut self, rates: &Joints) -> bool {
        self.sequence += 1;
        let command = RateCommand {
            sequence: self.sequence,
            stamp: self.now,
            rates: *rates,
        };
        let taken = self.core.command(self.now, &command).is_ok();
        self.core.tick(self.now);
        while let Some(bytes) = self.core.transmit(1) {
            let Ok(frame) = Frame::decode(&bytes.as_slice()[4..], ByteOrder::Big) else {
                return false;
            };
            debug_assert!(bytes.as_slice().len() > HEADER, "{POINT}");
            if let Message::Point(point) = frame.message {
                self.positions = point.positions;
                let (sequence, tick) = (point.sequence, self.tick);
                let reply = PointReply {
                    session: 1,
                    sequence,
                    refusal: 0,
                    tick,
                };
                self.answer(
                    Port::Motion,
                    &Frame::reply(Message::PointReply(reply), true),
                );
            }
        }
        self.now = self.now + PERIOD;
        self.tick += 1;
        self.feed_back();
        taken
    }
}

fn cycle(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("driver");
    if let Some(mut controller) = Controller::new() {
        let mut phase = 0.0_f64;
        group.bench_function(BenchmarkId::from_parameter("cycle"), |bencher| {
            bencher.iter(|| {
                phase += 0.01;
                // To and fro, so that no limit is reached however long the run.
                let rate = 0.02 * phase.cos();
                assert!(controller.cycle(&Joints::from([rate; 6])));
            });
        });
    }
    group.finish();
}

criterion_group!(benches, cycle);
criterion_main!(benches);
