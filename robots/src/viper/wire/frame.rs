//! A whole frame.

use super::cursor::{Reader, Writer};
use super::{
    Body, ByteOrder, JointFeedback, JointPosition, Ping, Status, TrajAck, TrajPt, TrajPtFull,
    WireError, steer,
};

/// Bytes of length, message type, communication type and reply code.
pub const HEADER: usize = 16;
/// Bytes of the longest frame.
pub const MAX_FRAME: usize = HEADER + TrajPtFull::SIZE;

/// What kind of communication a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Comm {
    /// Nobody answers.
    Topic,
    /// An answer is expected.
    Request,
    /// The answer.
    Reply,
}

/// The code of a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplyCode {
    /// Not a reply.
    None,
    /// Done, or accepted.
    Success,
    /// Refused.
    Failure,
}

/// The body of a frame, by message type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Message {
    /// Type 1, as the C++ library sends it.
    EmptyPing,
    /// Type 1.
    Ping(Ping),
    /// Type 10.
    JointPosition(JointPosition),
    /// Type 11.
    TrajPt(TrajPt),
    /// Type 11, the 2018 program's reply.
    TrajAck(TrajAck),
    /// Type 13.
    Status(Status),
    /// Type 14.
    TrajPtFull(TrajPtFull),
    /// Type 15.
    JointFeedback(JointFeedback),
    /// Type 1200, request.
    Hello(steer::Hello),
    /// Type 1200, reply.
    HelloReply(steer::HelloReply),
    /// Type 1201, request.
    Point(steer::Point),
    /// Type 1201, reply.
    PointReply(steer::PointReply),
    /// Type 1202, request.
    Stop(steer::Stop),
    /// Type 1202, reply.
    StopReply(steer::StopReply),
    /// Type 1203.
    Feedback(steer::Feedback),
}

/// One frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Kind of communication.
    pub comm: Comm,
    /// Reply code.
    pub reply: ReplyCode,
    /// Body.
    pub message: Message,
}

/// An encoded frame.
#[derive(Clone, Copy)]
pub struct Bytes {
    buffer: [u8; MAX_FRAME],
    length: usize,
}

impl Bytes {
    /// The bytes.
    pub fn as_slice(&self) -> &[u8] {
        &self.buffer[..self.length]
    }
}

impl core::fmt::Debug for Bytes {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        self.as_slice()
            .iter()
            .try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl Frame {
    /// A frame that expects an answer.
    pub const fn request(message: Message) -> Self {
        Self {
            comm: Comm::Request,
            reply: ReplyCode::None,
            message,
        }
    }

    /// A frame that nobody answers.
    pub const fn topic(message: Message) -> Self {
        Self {
            comm: Comm::Topic,
            reply: ReplyCode::None,
            message,
        }
    }

    /// An answer.
    pub const fn reply(message: Message, success: bool) -> Self {
        let reply = if success {
            ReplyCode::Success
        } else {
            ReplyCode::Failure
        };
        Self {
            comm: Comm::Reply,
            reply,
            message,
        }
    }

    /// The bytes of this frame.
    pub fn encode(&self, order: ByteOrder) -> Bytes {
        let mut bytes = Bytes {
            buffer: [0; MAX_FRAME],
            length: HEADER,
        };
        match self.message {
            Message::EmptyPing => self.header(1, order, &mut bytes),
            Message::Ping(body) => self.write(1, body, order, &mut bytes),
            Message::JointPosition(body) => self.write(10, body, order, &mut bytes),
            Message::TrajPt(body) => self.write(11, body, order, &mut bytes),
            Message::TrajAck(body) => self.write(11, body, order, &mut bytes),
            Message::Status(body) => self.write(13, body, order, &mut bytes),
            Message::TrajPtFull(body) => self.write(14, body, order, &mut bytes),
            Message::JointFeedback(body) => self.write(15, body, order, &mut bytes),
            Message::Hello(body) => self.write(steer::HELLO, body, order, &mut bytes),
            Message::HelloReply(body) => self.write(steer::HELLO, body, order, &mut bytes),
            Message::Point(body) => self.write(steer::POINT, body, order, &mut bytes),
            Message::PointReply(body) => self.write(steer::POINT, body, order, &mut bytes),
            Message::Stop(body) => self.write(steer::STOP, body, order, &mut bytes),
            Message::StopReply(body) => self.write(steer::STOP, body, order, &mut bytes),
            Message::Feedback(body) => self.write(steer::FEEDBACK, body, order, &mut bytes),
        }
        bytes
    }

    fn write<B: Body>(&self, kind: i32, mut body: B, order: ByteOrder, bytes: &mut Bytes) {
        bytes.length = HEADER + B::SIZE;
        self.header(kind, order, bytes);
        body.visit(&mut Writer {
            rest: &mut bytes.buffer[HEADER..bytes.length],
            order,
        });
    }

    fn header(&self, kind: i32, order: ByteOrder, bytes: &mut Bytes) {
        let comm = match self.comm {
            Comm::Topic => 1,
            Comm::Request => 2,
            Comm::Reply => 3,
        };
        let reply = match self.reply {
            ReplyCode::None => 0,
            ReplyCode::Success => 1,
            ReplyCode::Failure => 2,
        };
        let length = i32::try_from(bytes.length - 4).unwrap_or(i32::MAX);
        for (field, value) in bytes
            .buffer
            .chunks_exact_mut(4)
            .zip([length, kind, comm, reply])
        {
            field.copy_from_slice(&order.bytes(value));
        }
    }

    /// Reads a frame without its length field.
    ///
    /// # Errors
    /// See [`WireError`].
    pub fn decode(frame: &[u8], order: ByteOrder) -> Result<Self, WireError> {
        let Some((header, body)) = frame.split_first_chunk::<{ HEADER - 4 }>() else {
            return Err(WireError::Length {
                length: i32::try_from(frame.len()).unwrap_or(i32::MAX),
                least: HEADER - 4,
                most: MAX_FRAME - 4,
            });
        };
        let mut fields = [0; 3];
        super::Codec::i32s(
            &mut Reader {
                rest: header,
                order,
            },
            &mut fields,
        );
        let [kind, comm, code] = fields;
        let comm = match comm {
            1 => Comm::Topic,
            2 => Comm::Request,
            3 => Comm::Reply,
            comm => return Err(WireError::Comm { comm }),
        };
        let reply = match code {
            0 => ReplyCode::None,
            1 => ReplyCode::Success,
            2 => ReplyCode::Failure,
            code => return Err(WireError::ReplyCode { code }),
        };
        let message = Message::decode(kind, comm, body, order)?;
        if !message.is_finite() {
            return Err(WireError::NotFinite { kind });
        }
        Ok(Self {
            comm,
            reply,
            message,
        })
    }
}

impl Message {
    fn decode(kind: i32, comm: Comm, bytes: &[u8], order: ByteOrder) -> Result<Self, WireError> {
        let body = Reading { kind, bytes, order };
        Ok(match (kind, comm) {
            (1, _) if bytes.is_empty() => Self::EmptyPing,
            (1, _) => Self::Ping(body.read()?),
            (10, _) => Self::JointPosition(body.read()?),
            (11, Comm::Reply) if bytes.len() == TrajAck::SIZE => Self::TrajAck(body.read()?),
            (11, _) => Self::TrajPt(body.read()?),
            (13, _) => Self::Status(body.read()?),
            (14, _) => Self::TrajPtFull(body.read()?),
            (15, _) => Self::JointFeedback(body.read()?),
            (steer::HELLO, Comm::Reply) => Self::HelloReply(body.read()?),
            (steer::HELLO, _) => Self::Hello(body.read()?),
            (steer::POINT, Comm::Reply) => Self::PointReply(body.read()?),
            (steer::POINT, _) => Self::Point(body.read()?),
            (steer::STOP, Comm::Reply) => Self::StopReply(body.read()?),
            (steer::STOP, _) => Self::Stop(body.read()?),
            (steer::FEEDBACK, _) => Self::Feedback(body.read()?),
            (kind, _) => return Err(WireError::Type { kind }),
        })
    }

    fn is_finite(&self) -> bool {
        let finite = |values: &[f32]| values.iter().all(|value| value.is_finite());
        match self {
            Self::JointPosition(body) => finite(&body.positions),
            Self::TrajPt(body) => {
                finite(&body.positions) && finite(&[body.velocity, body.duration])
            }
            Self::TrajPtFull(body) => {
                finite(&[body.time])
                    && finite(&body.positions)
                    && finite(&body.velocities)
                    && finite(&body.accelerations)
            }
            Self::JointFeedback(body) => {
                finite(&[body.time])
                    && finite(&body.positions)
                    && finite(&body.velocities)
                    && finite(&body.accelerations)
            }
            Self::HelloReply(body) => {
                finite(&body.lower) && finite(&body.upper) && finite(&body.speed)
            }
            Self::Point(body) => finite(&body.positions),
            Self::Feedback(body) => finite(&body.positions),
            _ => true,
        }
    }
}

struct Reading<'a> {
    kind: i32,
    bytes: &'a [u8],
    order: ByteOrder,
}

impl Reading<'_> {
    fn read<B: Body>(&self) -> Result<B, WireError> {
        if self.bytes.len() != B::SIZE {
            return Err(WireError::BodySize {
                kind: self.kind,
                found: self.bytes.len(),
            });
        }
        let mut body = B::default();
        body.visit(&mut Reader {
            rest: self.bytes,
            order: self.order,
        });
        Ok(body)
    }
}
