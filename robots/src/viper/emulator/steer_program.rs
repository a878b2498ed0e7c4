//! Our own V+ program (`robots/vplus/steer.v2`), as its text reads.

use std::time::Duration;

use hal::{Joints, Stamp};

use super::controller::{Controller, Wait};
use super::journal::Record;
use crate::viper::Port;
use crate::viper::config::Dialect;
use crate::viper::wire::steer::{
    self, Feedback, Hello, HelloReply, Point, PointReply, Refusal, Stop, StopReply,
};
use crate::viper::wire::{ByteOrder, Frame, HEADER, MAX_FRAME, Message};

/// Between a start point and the arm \[rad\].
const START_TOLERANCE: f64 = 0.01;
/// Segments may be this much faster than the limits: rounding of the wire over a short time.
const SPEED_ROUNDING: f64 = 1.05;

/// Bytes that are no frame of this dialect.
struct NotOurs;

/// State of the program.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Steering {
    session: i32,
    greeted: bool,
    sequence: i32,
    armed: bool,
    disarmed_by: Option<Refusal>,
    watchdog: Duration,
    fed: Stamp,
}

impl Controller {
    /// Reads whole frames while the queue has room for a point.
    pub(super) fn read_steer(&mut self) {
        while self.has_room() {
            let Some(frame) = self.next_frame() else {
                return;
            };
            match frame.message {
                Message::Hello(hello) => self.greet(&hello),
                _ if !self.steering.greeted => return self.reject(),
                Message::Point(point) => self.take_point(&point),
                Message::Stop(stop) => self.take_stop(stop),
                Message::EmptyPing | Message::Ping(_) => {
                    self.answer(Message::EmptyPing, true);
                }
                _ => return self.reject(),
            }
        }
        // A stop must not wait behind a full queue.
        self.read_stop_ahead();
    }

    fn next_frame(&mut self) -> Option<Frame> {
        if let Ok((frame, size)) = self.peek_frame(0)? {
            self.unread.drain(..size);
            return Some(frame);
        }
        self.reject();
        None
    }

    /// The frame that begins at `offset` of the unread bytes, with its size; `None` if it is not
    /// complete.
    fn peek_frame(&mut self, offset: usize) -> Option<Result<(Frame, usize), NotOurs>> {
        let bytes = self.unread.make_contiguous().get(offset..)?;
        let length = ByteOrder::Big.integer(*bytes.first_chunk()?);
        let size = usize::try_from(length).map_or(0, |length| length.saturating_add(4));
        if !(HEADER..=MAX_FRAME).contains(&size) {
            return Some(Err(NotOurs));
        }
        let frame = bytes.get(4..size)?;
        let frame = Frame::decode(frame, ByteOrder::Big).map(|frame| (frame, size));
        Some(frame.map_err(|_| NotOurs))
    }

    fn read_stop_ahead(&mut self) {
        let mut offset = 0;
        while let Some(Ok((frame, size))) = self.peek_frame(offset) {
            if let Message::Stop(stop) = frame.message {
                self.unread.drain(..offset + size);
                self.take_stop(stop);
                return;
            }
            offset += size;
        }
    }

    fn reject(&mut self) {
        self.disarm(Refusal::Protocol);
        self.unread.clear();
        self.close(Port::Motion);
    }

    fn greet(&mut self, hello: &Hello) {
        self.disarm(Refusal::Stopped);
        let limits = &self.config.limits;
        let mut reply = HelloReply {
            magic: steer::MAGIC,
            version: steer::VERSION,
            session: self.steering.session.wrapping_add(1),
            cycle_us: i32::try_from(self.config.cycle.as_micros()).unwrap_or(i32::MAX),
            watchdog_ms: hello.watchdog_ms.clamp(20, 500),
            joints: self.config.joints,
            ..HelloReply::default()
        };
        for (joint, limit) in limits.iter().enumerate().take(steer::JOINTS) {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "the wire has single precision"
            )]
            let [lower, upper, speed] =
                [limit.lower, limit.upper, limit.velocity].map(|value| value as f32);
            (reply.lower[joint], reply.upper[joint], reply.speed[joint]) = (lower, upper, speed);
        }
        let fits = hello.magic == steer::MAGIC && hello.version == steer::VERSION;
        self.steering = Steering {
            session: reply.session,
            greeted: fits,
            watchdog: Duration::from_millis(u64::try_from(reply.watchdog_ms).unwrap_or(100)),
            disarmed_by: self.steering.disarmed_by,
            ..Steering::default()
        };
        self.answer(Message::HelloReply(reply), fits);
    }

    fn take_point(&mut self, point: &Point) {
        let refusal = self.check_point(point);
        let reply = PointReply {
            session: self.steering.session,
            sequence: point.sequence,
            refusal: Refusal::code(refusal),
            tick: self.tick,
        };
        if let Some(refusal) = refusal {
            self.disarm(refusal);
        } else {
            self.steering.sequence = point.sequence;
            self.steering.fed = self.now;
            let target = Joints::from(point.positions.map(f64::from));
            if point.flags & steer::START != 0 {
                self.steering.armed = true;
                self.record(Record::Armed);
            } else {
                let us = u64::try_from(point.duration_us).unwrap_or(0);
                self.queue(Wait::Timed(target, Duration::from_micros(us)));
            }
        }
        self.answer(Message::PointReply(reply), refusal.is_none());
    }

    fn check_point(&self, point: &Point) -> Option<Refusal> {
        let state = &self.steering;
        let target = point.positions.map(f64::from);
        let limits = &self.config.limits;
        if point.session != state.session {
            return Some(Refusal::Session);
        }
        if !self.is_powered() {
            return Some(Refusal::State);
        }
        let inside = limits
            .iter()
            .zip(target)
            .all(|(limit, q)| (limit.lower..=limit.upper).contains(&q));
        if !inside {
            return Some(Refusal::Limit);
        }
        if point.flags & steer::START != 0 {
            let near = self
                .true_positions()
                .iter()
                .zip(target)
                .all(|(q, target)| (q - target).abs() <= START_TOLERANCE);
            return if point.sequence <= state.sequence {
                Some(Refusal::Sequence)
            } else if near && !self.is_moving() {
                None
            } else {
                Some(Refusal::StartMismatch)
            };
        }
        if !state.armed {
            return Some(Refusal::NotArmed);
        }
        if state.sequence.checked_add(1) != Some(point.sequence) {
            return Some(Refusal::Sequence);
        }
        if !(8_000..=100_000).contains(&point.duration_us) {
            return Some(Refusal::Duration);
        }
        let seconds = 1e-6 * f64::from(point.duration_us);
        let from = self.queue_end();
        let slow = limits
            .iter()
            .zip(from.iter().zip(target))
            .all(|(limit, (from, to))| {
                (to - from).abs() <= limit.velocity * seconds * SPEED_ROUNDING + START_TOLERANCE
            });
        (!slow).then_some(Refusal::Speed)
    }

    /// Where the arm will be when all that is queued is done.
    fn queue_end(&self) -> Joints {
        match (&self.waiting, &self.executing) {
            (Some(Wait::Fast(to) | Wait::Timed(to, _)), _) => *to,
            (None, Some(segment)) => segment.at(segment.end()).0,
            (None, None) => self.true_positions(),
        }
    }

    fn take_stop(&mut self, stop: Stop) {
        self.disarm(Refusal::Stopped);
        self.steering.sequence = self.steering.sequence.max(stop.sequence);
        let (session, tick) = (self.steering.session, self.tick);
        self.answer(
            Message::StopReply(StopReply {
                session,
                sequence: stop.sequence,
                tick,
            }),
            stop.session == session,
        );
    }

    /// Brakes, flushes and asks for a new start point.
    pub(super) fn disarm(&mut self, reason: Refusal) {
        self.brake();
        if std::mem::take(&mut self.steering.armed) {
            self.steering.disarmed_by = Some(reason);
            self.record(Record::Disarmed(Some(reason)));
        }
    }

    pub(super) fn watch_steer(&mut self) {
        let silent = self.now.since(self.steering.fed) > self.steering.watchdog;
        if self.steering.armed && silent {
            self.disarm(Refusal::Watchdog);
        }
    }

    pub(super) fn report(&mut self) {
        if self.config.dialect == Dialect::Adept2018 {
            return self.report_2018();
        }
        let feedback = Feedback {
            session: self.steering.session,
            tick: self.tick,
            sequence: self.steering.sequence,
            armed: i32::from(self.steering.armed),
            disarmed_by: Refusal::code(self.steering.disarmed_by),
            status: self.status(),
            positions: self.encoders(),
        };
        self.feed_back(Message::Feedback(feedback));
    }
}
