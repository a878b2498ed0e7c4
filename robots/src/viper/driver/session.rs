//! One link's conversation in its dialect.

use std::collections::VecDeque;
use std::time::Duration;

use hal::{JointLimit, Joints, Stamp};

use super::course::Segment;
use super::fault::{ProtocolError, Unfit};

use crate::viper::Port;
use crate::viper::config::{Config, Dialect};
use crate::viper::wire::{
    ByteOrder, Bytes, Decoder, Frame, Message, ReplyCode, Status, TrajPt, WIRE_JOINTS, WireError,
    sequence, steer,
};

/// What came from the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Event {
    /// The greeting was answered; the arm may be the wrong one.
    Greeted(Option<Unfit>),
    /// A point was accepted after this time.
    Accepted(Duration),
    /// The greeting or a stop was refused.
    StopRefused,
    /// A point was refused.
    Refused(i32, Option<steer::Refusal>),
    /// The stop was accepted after this time.
    Stopped(Duration),
    /// Positions without time.
    Positions(Joints, Option<Unfit>),
    /// State of the controller.
    Status(Status),
    /// Positions at a controller cycle; whether the controller has disarmed itself since it
    /// accepted the start point, and why it disarmed last.
    Cycle {
        tick: i32,
        cycle: Duration,
        positions: Joints,
        status: Status,
        disarmed: bool,
        disarmed_by: Option<steer::Refusal>,
    },
}

#[derive(Clone, Copy, Debug)]
struct Asked {
    sequence: i32,
    at: Stamp,
}

/// Frames not yet taken by the transport; more never wait at once: greeting, one point, one stop.
const OUTGOING: usize = 4;

/// State of one link's conversation; made anew with every link.
#[derive(Debug)]
pub(super) struct Session {
    dialect: Dialect,
    decoders: [Decoder; 2],
    outgoing: VecDeque<Bytes>,
    point: Option<Asked>,
    stop: Option<Asked>,
    greeting: Option<Stamp>,
    number: i32,
    sequence: i32,
    cycle: Duration,
    /// Controller cycle at which the start point was accepted.
    armed_at: Option<i32>,
    /// Whether the controller has been given a start point since it was stopped.
    pub(super) armed: bool,
}

impl Session {
    pub(super) fn new(config: &Config) -> Self {
        let decoder = Decoder::new(ByteOrder::Big, config.preamble);
        Self {
            dialect: config.dialect,
            decoders: [decoder.clone(), decoder],
            outgoing: VecDeque::with_capacity(OUTGOING),
            point: None,
            stop: None,
            greeting: None,
            number: 0,
            sequence: 0,
            cycle: config.period,
            armed_at: None,
            armed: false,
        }
    }

    /// The next frame for the motion port.
    pub(super) fn transmit(&mut self) -> Option<Bytes> {
        self.outgoing.pop_front()
    }

    /// Whether a frame waits for the transport.
    pub(super) fn has_output(&self) -> bool {
        !self.outgoing.is_empty()
    }

    /// Whether a point may be sent: nothing is unanswered.
    pub(super) const fn is_clear(&self) -> bool {
        self.point.is_none() && self.stop.is_none() && self.greeting.is_none()
    }

    pub(super) const fn is_stopping(&self) -> bool {
        self.stop.is_some()
    }

    /// The oldest unanswered question: number and age.
    pub(super) fn unanswered(&self, now: Stamp) -> Option<(i32, Duration)> {
        let asked = self.point.iter().chain(&self.stop);
        asked
            .map(|asked| (asked.sequence, now.since(asked.at)))
            .max_by_key(|(_, age)| *age)
    }

    /// Opens the conversation. In both dialects the greeting is a stop order to a 2018 program.
    pub(super) fn greet(&mut self, now: Stamp, config: &Config) {
        self.greeting = Some(now);
        let message = match self.dialect {
            Dialect::Adept2018 => Message::TrajPt(stop_point()),
            Dialect::Steer => Message::Hello(steer::Hello {
                period_us: microseconds(config.period),
                watchdog_ms: microseconds(config.timing.controller_watchdog) / 1000,
                ..steer::Hello::default()
            }),
        };
        self.send(message);
    }

    /// Sends the start check, where the dialect has one; true if a point may follow at once.
    pub(super) fn start(&mut self, now: Stamp, at: &Joints) -> bool {
        if self.armed {
            return true;
        }
        self.armed = true;
        if self.dialect == Dialect::Adept2018 {
            return true;
        }
        self.ask_point(now, at, steer::START, 0);
        false
    }

    /// Sends a point.
    pub(super) fn point(&mut self, now: Stamp, segment: &Segment) {
        self.ask_point(now, &segment.to, 0, microseconds(segment.duration));
    }

    fn ask_point(&mut self, now: Stamp, to: &Joints, flags: i32, duration_us: i32) {
        self.sequence = self.sequence.checked_add(1).unwrap_or(1);
        self.point = Some(Asked {
            sequence: self.sequence,
            at: now,
        });
        let message = match self.dialect {
            Dialect::Adept2018 => Message::TrajPt(TrajPt {
                sequence: self.sequence,
                positions: to_wire(to),
                // Ignored by the program; written for whoever reads a trace.
                velocity: 1.0,
                duration: 1e-6 * duration_us as f32,
            }),
            Dialect::Steer => Message::Point(steer::Point {
                session: self.number,
                sequence: self.sequence,
                flags,
                duration_us,
                positions: to_wire(to),
            }),
        };
        self.send(message);
    }

    /// Orders a stop, unless one is unanswered already. A point not yet taken by the transport
    /// is withdrawn.
    pub(super) fn stop(&mut self, now: Stamp) {
        self.armed = false;
        self.armed_at = None;
        if self.stop.is_some() || self.greeting.is_some() {
            return;
        }
        if self.outgoing.pop_back().is_some() {
            self.point = None;
        }
        let (sequence, message) = match self.dialect {
            Dialect::Adept2018 => (sequence::STOP, Message::TrajPt(stop_point())),
            Dialect::Steer => {
                self.sequence = self.sequence.checked_add(1).unwrap_or(1);
                let stop = steer::Stop {
                    session: self.number,
                    sequence: self.sequence,
                };
                (self.sequence, Message::Stop(stop))
            }
        };
        self.stop = Some(Asked { sequence, at: now });
        self.send(message);
    }

    fn send(&mut self, message: Message) {
        if self.outgoing.len() < OUTGOING {
            self.outgoing
                .push_back(Frame::request(message).encode(ByteOrder::Big));
        }
    }

    /// Takes bytes from a port and hands out what they mean.
    pub(super) fn receive(
        &mut self,
        now: Stamp,
        port: Port,
        bytes: &[u8],
        config: &Config,
        mut sink: impl FnMut(&mut Self, Event),
    ) -> Result<(), ProtocolError> {
        let spare = Decoder::new(ByteOrder::Big, 0);
        let mut decoder = std::mem::replace(&mut self.decoders[port as usize], spare);
        let mut outcome = Ok(());
        let decoded: Result<(), WireError> = decoder.push(bytes, |frame| {
            if outcome.is_ok() {
                outcome = self.interpret(now, port, &frame, config).map(|event| {
                    if let Some(event) = event {
                        sink(self, event);
                    }
                });
            }
        });
        self.decoders[port as usize] = decoder;
        outcome?;
        Ok(decoded?)
    }

    fn interpret(
        &mut self,
        now: Stamp,
        port: Port,
        frame: &Frame,
        config: &Config,
    ) -> Result<Option<Event>, ProtocolError> {
        let success = frame.reply == ReplyCode::Success;
        let joints = config.limits.len();
        match (port, self.dialect, frame.message) {
            (_, _, Message::EmptyPing | Message::Ping(_)) => Ok(None),
            (Port::Motion, Dialect::Adept2018, Message::TrajAck(ack)) => {
                self.answer(now, ack.sequence, success)
            }
            (Port::State, Dialect::Adept2018, Message::JointPosition(body)) => {
                let unfit = body.positions[joints..]
                    .iter()
                    .rposition(|q| *q != 0.0)
                    .map(|last| Unfit::Joints {
                        expected: joints,
                        found: joints + last + 1,
                    });
                Ok(Some(Event::Positions(
                    from_wire(&body.positions[..joints]),
                    unfit,
                )))
            }
            (Port::State, Dialect::Adept2018, Message::Status(status)) => {
                Ok(Some(Event::Status(status)))
            }
            (Port::Motion, Dialect::Steer, Message::HelloReply(reply)) => {
                self.greeted(&reply, &config.limits, config.tolerances.limits)
            }
            (Port::Motion, Dialect::Steer, Message::PointReply(reply)) => {
                let asked = self.asked_point(reply.session, reply.sequence)?;
                if success {
                    if self.armed {
                        self.armed_at.get_or_insert(reply.tick);
                    }
                    return Ok(Some(Event::Accepted(now.since(asked.at))));
                }
                let refusal = steer::Refusal::from_code(reply.refusal);
                Ok(Some(Event::Refused(reply.sequence, refusal)))
            }
            (Port::Motion, Dialect::Steer, Message::StopReply(reply)) => {
                let Some(asked) = self.stop.take() else {
                    return Err(ProtocolError::Unasked {
                        found: reply.sequence,
                    });
                };
                self.check(reply.session, asked.sequence, reply.sequence)?;
                Ok(Some(if success {
                    Event::Stopped(now.since(asked.at))
                } else {
                    Event::StopRefused
                }))
            }
            (Port::Motion, Dialect::Steer, Message::TrajAck(_)) if self.greeting.is_some() => {
                Err(ProtocolError::OtherDialect)
            }
            (Port::State, Dialect::Steer, Message::Feedback(body)) => Ok(Some(Event::Cycle {
                tick: body.tick,
                cycle: self.cycle,
                positions: from_wire(&body.positions),
                status: body.status,
                disarmed: body.armed != 1 && self.armed_at.is_some_and(|at| body.tick > at),
                disarmed_by: steer::Refusal::from_code(body.disarmed_by),
            })),
            (Port::Motion, ..) => Err(ProtocolError::Unexpected { port: "motion" }),
            (Port::State, ..) => Err(ProtocolError::Unexpected { port: "state" }),
        }
    }

    /// An answer of the 2018 program: 0 for a point, the stop order for a stop or the greeting.
    fn answer(
        &mut self,
        now: Stamp,
        found: i32,
        success: bool,
    ) -> Result<Option<Event>, ProtocolError> {
        let event = match found {
            0 => {
                let asked = self.point.take().ok_or(ProtocolError::Unasked { found })?;
                Event::Accepted(now.since(asked.at))
            }
            sequence::STOP => {
                if self.greeting.take().is_some() {
                    Event::Greeted(None)
                } else {
                    let asked = self.stop.take().ok_or(ProtocolError::Unasked { found })?;
                    Event::Stopped(now.since(asked.at))
                }
            }
            _ => return Err(ProtocolError::Sequence { expected: 0, found }),
        };
        Ok(Some(match (success, found) {
            (true, _) => event,
            (false, 0) => Event::Refused(found, None),
            (false, _) => Event::StopRefused,
        }))
    }

    fn greeted(
        &mut self,
        reply: &steer::HelloReply,
        limits: &[JointLimit],
        tolerance: f64,
    ) -> Result<Option<Event>, ProtocolError> {
        if self.greeting.take().is_none() {
            return Err(ProtocolError::Unasked {
                found: steer::HELLO,
            });
        }
        let steer::HelloReply { magic, version, .. } = *reply;
        if magic != steer::MAGIC || version != steer::VERSION || reply.cycle_us <= 0 {
            return Err(ProtocolError::OtherVersion { magic, version });
        }
        self.number = reply.session;
        self.cycle = Duration::from_micros(u64::try_from(reply.cycle_us).unwrap_or(0));
        if usize::try_from(reply.joints) != Ok(limits.len()) {
            let found = usize::try_from(reply.joints).unwrap_or(0);
            return Ok(Some(Event::Greeted(Some(Unfit::Joints {
                expected: limits.len(),
                found,
            }))));
        }
        let theirs = reply.lower.iter().zip(&reply.upper).zip(&reply.speed);
        let unfit = limits
            .iter()
            .zip(theirs)
            .enumerate()
            .find_map(|(joint, (ours, theirs))| {
                let ((lower, upper), speed) = theirs;
                let (lower, upper, speed) =
                    (f64::from(*lower), f64::from(*upper), f64::from(*speed));
                let differs = (lower - ours.lower).abs() > tolerance
                    || (upper - ours.upper).abs() > tolerance
                    || speed < ours.velocity - tolerance;
                differs.then_some(Unfit::Limits {
                    joint,
                    lower_rad: lower,
                    upper_rad: upper,
                    speed_rad_s: speed,
                })
            });
        Ok(Some(Event::Greeted(unfit)))
    }

    fn asked_point(&mut self, session: i32, found: i32) -> Result<Asked, ProtocolError> {
        let asked = self.point.take().ok_or(ProtocolError::Unasked { found })?;
        self.check(session, asked.sequence, found)?;
        Ok(asked)
    }

    const fn check(&self, session: i32, expected: i32, found: i32) -> Result<(), ProtocolError> {
        if session != self.number {
            return Err(ProtocolError::Session {
                expected: self.number,
                found: session,
            });
        }
        if expected != found {
            return Err(ProtocolError::Sequence { expected, found });
        }
        Ok(())
    }
}

const fn stop_point() -> TrajPt {
    TrajPt {
        sequence: sequence::STOP,
        positions: [0.0; WIRE_JOINTS],
        velocity: 0.0,
        duration: 0.0,
    }
}

fn microseconds(duration: Duration) -> i32 {
    i32::try_from(duration.as_micros()).unwrap_or(i32::MAX)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the wire has single precision"
)]
fn to_wire<const N: usize>(joints: &Joints) -> [f32; N] {
    let mut wire = [0.0; N];
    for (to, from) in wire.iter_mut().zip(joints.iter()) {
        *to = *from as f32;
    }
    wire
}

fn from_wire(values: &[f32]) -> Joints {
    let mut joints = [0.0; 6];
    for (to, from) in joints.iter_mut().zip(values) {
        *to = f64::from(*from);
    }
    Joints::from(joints)
}
