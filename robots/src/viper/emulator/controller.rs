//! The emulated controller without sockets: bytes and time in, bytes out.

use std::collections::VecDeque;
use std::time::Duration;

use hal::{Joints, Stamp};

use super::EmulatorConfig;
use super::journal::{Journal, Record};
use super::knobs::{Answers, Knobs};
use super::outbox::Outbox;
use super::segment::Segment;
use super::steer_program::Steering;
use crate::viper::Port;
use crate::viper::config::Dialect;
use crate::viper::wire::steer::Refusal;
use crate::viper::wire::{Frame, Message, Status};

/// Bytes that a client may pile up before it is thrown out.
const MOST_UNREAD: usize = 64 * 1024;

#[derive(Debug, Default)]
pub(super) struct Connection {
    pub(super) open: bool,
    pub(super) closing: bool,
    pub(super) opened_after: Stamp,
    pub(super) outbox: Outbox,
    pub(super) sent: u64,
    pub(super) received: u64,
}

/// The controller.
#[derive(Debug)]
pub(super) struct Controller {
    pub(super) config: EmulatorConfig,
    pub(super) knobs: Knobs,
    pub(super) journal: Journal,
    pub(super) now: Stamp,
    pub(super) tick: i32,
    pub(super) connections: [Connection; 2],
    pub(super) unread: VecDeque<u8>,
    arriving: VecDeque<(Stamp, Vec<u8>)>,
    positions: Joints,
    rates: Joints,
    pub(super) executing: Option<Segment>,
    pub(super) waiting: Option<Wait>,
    pub(super) blocked: Option<Joints>,
    pub(super) steering: Steering,
    stopped_by_power: bool,
}

/// A motion that begins when the present one ends.
#[derive(Clone, Copy, Debug)]
pub(super) enum Wait {
    Fast(Joints),
    Timed(Joints, Duration),
}

impl Controller {
    pub(super) fn new(config: EmulatorConfig) -> Self {
        Self {
            knobs: Knobs::default(),
            journal: Journal::new(config.journal),
            now: Stamp::ZERO,
            tick: 0,
            connections: [
                Connection {
                    outbox: Outbox::new(config.seed),
                    ..Connection::default()
                },
                Connection {
                    outbox: Outbox::new(!config.seed),
                    ..Connection::default()
                },
            ],
            unread: VecDeque::new(),
            arriving: VecDeque::new(),
            positions: config.start,
            rates: config.start.zeroed(),
            executing: None,
            waiting: None,
            blocked: None,
            steering: Steering::default(),
            stopped_by_power: false,
            config,
        }
    }

    /// Takes a client, unless there is one or the program is restarting.
    pub(super) fn connect(&mut self, port: Port) -> bool {
        let connection = &mut self.connections[port as usize];
        if connection.open || self.now < connection.opened_after {
            self.record(Record::TurnedAway(port));
            return false;
        }
        connection.open = true;
        connection.closing = false;
        connection.outbox.clear();
        (connection.sent, connection.received) = (0, 0);
        if port == Port::Motion {
            self.unread.clear();
            self.arriving.clear();
        }
        self.record(Record::Connected(port));
        true
    }

    /// The client is gone.
    pub(super) fn disconnect(&mut self, port: Port) {
        let connection = &mut self.connections[port as usize];
        if !std::mem::take(&mut connection.open) {
            return;
        }
        connection.closing = false;
        connection.outbox.clear();
        self.record(Record::Closed(port));
        if port == Port::Motion {
            self.unread.clear();
            self.arriving.clear();
            if self.config.dialect == Dialect::Steer {
                self.disarm(Refusal::ClientLost);
            }
        }
    }

    /// Throws the client out.
    pub(super) fn close(&mut self, port: Port) {
        self.connections[port as usize].closing = true;
    }

    /// Takes bytes that the client sent at `now`.
    pub(super) fn receive(&mut self, now: Stamp, port: Port, bytes: &[u8]) {
        self.advance(now);
        self.connections[port as usize].received += bytes.len() as u64;
        self.record(Record::Received(port, bytes.to_vec()));
        if port == Port::State {
            return;
        }
        let due = self.now + self.knobs.order_delay;
        let due = self.arriving.back().map_or(due, |(last, _)| due.max(*last));
        self.arriving.push_back((due, bytes.to_vec()));
        let unread: usize = self.arriving.iter().map(|(_, bytes)| bytes.len()).sum();
        if unread + self.unread.len() > MOST_UNREAD {
            self.close(Port::Motion);
        }
        self.advance(now);
    }

    /// Lets time pass.
    pub(super) fn advance(&mut self, now: Stamp) {
        loop {
            let next_tick = self.tick_stamp(self.tick + 1);
            let arrival = self.arriving.front().map(|(due, _)| *due);
            let segment_end = self.executing.as_ref().map(Segment::end);
            let next = [Some(next_tick), arrival, segment_end]
                .into_iter()
                .flatten()
                .min();
            let Some(next) = next.filter(|next| *next <= now) else {
                break;
            };
            self.now = self.now.max(next);
            self.settle();
            while self
                .arriving
                .front()
                .is_some_and(|(due, _)| *due <= self.now)
            {
                let bytes = self
                    .arriving
                    .pop_front()
                    .map(|(_, bytes)| bytes)
                    .unwrap_or_default();
                self.unread.extend(bytes);
                self.read();
            }
            if next_tick <= self.now {
                self.tick += 1;
                self.cycle();
            }
        }
        self.now = self.now.max(now);
        self.settle();
    }

    fn tick_stamp(&self, tick: i32) -> Stamp {
        let ticks = u32::try_from(tick).unwrap_or(0);
        Stamp::ZERO + self.config.cycle * ticks
    }

    fn read(&mut self) {
        match self.config.dialect {
            Dialect::Adept2018 => self.read_2018(),
            Dialect::Steer => self.read_steer(),
        }
    }

    /// Brings positions up to date and begins the motion that waits.
    fn settle(&mut self) {
        while let Some(segment) = self.executing {
            (self.positions, self.rates) = segment.at(self.now);
            if self.now < segment.end() {
                return;
            }
            self.executing = None;
            if let Some(wait) = self.waiting.take() {
                self.begin(segment.end(), wait);
            }
            if let Some(target) = self.blocked.take() {
                self.queue(Wait::Fast(target));
            }
            self.read();
        }
    }

    fn begin(&mut self, start: Stamp, wait: Wait) {
        self.executing = Some(match wait {
            Wait::Fast(to) => Segment::trapezoid(start, self.positions, &to, &self.config.limits),
            Wait::Timed(to, duration) => Segment::linear(start, self.positions, &to, duration),
        });
    }

    /// Whether another motion finds room.
    pub(super) const fn has_room(&self) -> bool {
        self.waiting.is_none() && self.blocked.is_none()
    }

    /// Takes a motion: at once, or after the present one.
    pub(super) fn queue(&mut self, wait: Wait) {
        if self.executing.is_none() {
            self.begin(self.now, wait);
        } else {
            self.waiting = Some(wait);
        }
    }

    /// Flushes what waits and brakes what moves.
    pub(super) fn brake(&mut self) {
        self.settle();
        self.waiting = None;
        self.blocked = None;
        if self.rates.max_abs() > 0.0 {
            let (from, rates) = (self.positions, self.rates);
            self.executing = Some(Segment::brake(self.now, from, rates, &self.config.limits));
            self.record(Record::Braked);
        } else {
            self.executing = None;
        }
    }

    /// One controller cycle: power, watchdog, feedback, journal.
    fn cycle(&mut self) {
        let dead = !self.is_powered();
        if dead && !self.stopped_by_power {
            self.cut_power();
        }
        self.stopped_by_power = dead;
        if self.config.dialect == Dialect::Steer {
            self.watch_steer();
        }
        self.record(Record::Position(self.positions));
        self.report();
    }

    fn cut_power(&mut self) {
        self.brake();
        match self.config.dialect {
            Dialect::Adept2018 => self.unread.clear(),
            Dialect::Steer => self.disarm(Refusal::State),
        }
    }

    /// Changes the knobs; power and mode act at once.
    pub(super) fn turn(&mut self, act: impl FnOnce(&mut Knobs)) {
        act(&mut self.knobs);
        if self.knobs.e_stop {
            self.knobs.powered = false;
        }
        let dead = !self.is_powered();
        if dead && !self.stopped_by_power {
            self.stopped_by_power = true;
            self.cut_power();
        }
    }

    /// Whether the controller would move the arm.
    pub(super) const fn is_powered(&self) -> bool {
        let knobs = &self.knobs;
        knobs.powered && !knobs.e_stop && knobs.mode == 2 && knobs.error_code == 0
    }

    pub(super) const fn is_moving(&self) -> bool {
        self.executing.is_some()
    }

    /// True positions \[rad\].
    pub(super) const fn true_positions(&self) -> Joints {
        self.positions
    }

    /// True rates \[rad/s\].
    pub(super) const fn true_rates(&self) -> Joints {
        self.rates
    }

    /// What the encoders say \[rad\].
    pub(super) fn encoders<const N: usize>(&self) -> [f32; N] {
        let mut values = [0.0; N];
        let offsets = self.knobs.encoder_offset;
        for (value, (q, offset)) in values.iter_mut().zip(self.positions.iter().zip(offsets)) {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "the wire has single precision"
            )]
            let read = (q + offset) as f32;
            *value = read;
        }
        values
    }

    pub(super) fn status(&self) -> Status {
        let moving = self.is_moving();
        Status {
            drives_powered: i32::from(self.knobs.powered),
            e_stopped: i32::from(self.knobs.e_stop),
            error_code: self.knobs.error_code,
            in_error: i32::from(self.knobs.error_code != 0),
            in_motion: i32::from(moving),
            mode: self.knobs.mode,
            motion_possible: i32::from(!moving && self.is_powered()),
        }
    }

    /// Sends feedback, unless it is frozen or lost.
    pub(super) fn feed_back(&mut self, message: Message) {
        let outbox = &mut self.connections[Port::State as usize].outbox;
        if self.knobs.freeze_feedback || outbox.chance() < self.knobs.feedback_loss {
            return;
        }
        self.send(
            Port::State,
            Frame::topic(message),
            self.knobs.feedback_delay,
        );
    }

    /// Sends an answer, as truly as the knobs let it.
    pub(super) fn answer(&mut self, mut message: Message, success: bool) {
        if self.knobs.freeze_answers {
            return;
        }
        let lie = self.knobs.answers;
        if lie == Answers::WrongSequence {
            match &mut message {
                Message::TrajAck(body) => body.sequence += 1,
                Message::PointReply(body) => body.sequence += 1,
                Message::StopReply(body) => body.sequence += 1,
                _ => {}
            }
        }
        let frame = Frame::reply(message, success && lie != Answers::Failure);
        let delay = self.knobs.answer_delay;
        self.send(Port::Motion, frame, delay);
        if lie == Answers::Twice {
            self.send(Port::Motion, frame, delay);
        }
    }

    fn send(&mut self, port: Port, frame: Frame, delay: Duration) {
        let connection = &mut self.connections[port as usize];
        if !connection.open {
            return;
        }
        let bytes = frame.encode(self.knobs.order);
        connection
            .outbox
            .push(self.now, delay, self.knobs.jitter, bytes.as_slice());
        self.record(Record::Sent(port, bytes.as_slice().to_vec()));
    }

    /// Puts raw bytes on a port.
    pub(super) fn inject(&mut self, port: Port, bytes: &[u8]) {
        self.connections[port as usize].outbox.push(
            self.now,
            Duration::ZERO,
            Duration::ZERO,
            bytes,
        );
        self.record(Record::Sent(port, bytes.to_vec()));
    }

    pub(super) fn record(&mut self, record: Record) {
        self.journal.push(self.now, record);
    }
}
