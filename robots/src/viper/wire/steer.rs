//! Bodies of our own `steer` messages, in the vendor range 1200-1299; `docs/VPLUS.md` has the
//! table of fields. Experimental: no real controller has run it yet.
//!
//! A client's first frame is [`Hello`]. It is as long as a type 11 frame and has the stop order
//! where such a frame has its sequence number, so that a controller which runs the 2018 program
//! takes it for a stop, moves nothing and gives itself away by its answer.

use super::{Body, Codec, Status, sequence};

/// Joints in the messages of this dialect.
pub const JOINTS: usize = 6;
/// `"STR1"`.
pub const MAGIC: i32 = 0x5354_5231;
/// Version of this dialect.
pub const VERSION: i32 = 1;
/// Flag of a [`Point`]: the first of a motion, which arms the controller.
pub const START: i32 = 1;

/// Type of [`Hello`] and [`HelloReply`].
pub const HELLO: i32 = 1200;
/// Type of [`Point`] and [`PointReply`].
pub const POINT: i32 = 1201;
/// Type of [`Stop`] and [`StopReply`].
pub const STOP: i32 = 1202;
/// Type of [`Feedback`].
pub const FEEDBACK: i32 = 1203;

/// The client's greeting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hello {
    /// Always [`sequence::STOP`].
    pub stop: i32,
    /// Always [`MAGIC`].
    pub magic: i32,
    /// The client's [`VERSION`].
    pub version: i32,
    /// Nominal time between points \[us\].
    pub period_us: i32,
    /// The controller brakes after this time without a point while armed \[ms\].
    pub watchdog_ms: i32,
    /// Joints of the arm that the client expects.
    pub joints: i32,
    /// Zero.
    pub reserved: [i32; 7],
}

impl Default for Hello {
    fn default() -> Self {
        Self {
            stop: sequence::STOP,
            magic: MAGIC,
            version: VERSION,
            period_us: 16_000,
            watchdog_ms: 100,
            joints: 6,
            reserved: [0; 7],
        }
    }
}

impl Body for Hello {
    const SIZE: usize = 52;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.stop);
        codec.i32(&mut self.magic);
        codec.i32(&mut self.version);
        codec.i32(&mut self.period_us);
        codec.i32(&mut self.watchdog_ms);
        codec.i32(&mut self.joints);
        codec.i32s(&mut self.reserved);
    }
}

/// The controller's answer: what it is and what it allows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HelloReply {
    /// Always [`MAGIC`].
    pub magic: i32,
    /// The program's [`VERSION`].
    pub version: i32,
    /// Number of this session; points and stops must quote it.
    pub session: i32,
    /// The controller's cycle \[us\].
    pub cycle_us: i32,
    /// Watchdog in force \[ms\].
    pub watchdog_ms: i32,
    /// Joints of the arm.
    pub joints: i32,
    /// Lowest positions that the controller accepts \[rad\].
    pub lower: [f32; JOINTS],
    /// Highest positions that the controller accepts \[rad\].
    pub upper: [f32; JOINTS],
    /// Highest speeds that the controller accepts \[rad/s\].
    pub speed: [f32; JOINTS],
}

impl Body for HelloReply {
    const SIZE: usize = 96;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.magic);
        codec.i32(&mut self.version);
        codec.i32(&mut self.session);
        codec.i32(&mut self.cycle_us);
        codec.i32(&mut self.watchdog_ms);
        codec.i32(&mut self.joints);
        codec.f32s(&mut self.lower);
        codec.f32s(&mut self.upper);
        codec.f32s(&mut self.speed);
    }
}

/// A set point to be reached `duration_us` after the one before.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// The session.
    pub session: i32,
    /// One more than the point before; a [`START`] point may leave a gap.
    pub sequence: i32,
    /// [`START`] or 0.
    pub flags: i32,
    /// Time for the segment \[us\].
    pub duration_us: i32,
    /// Positions to reach \[rad\].
    pub positions: [f32; JOINTS],
}

impl Body for Point {
    const SIZE: usize = 40;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.session);
        codec.i32(&mut self.sequence);
        codec.i32(&mut self.flags);
        codec.i32(&mut self.duration_us);
        codec.f32s(&mut self.positions);
    }
}

/// Why the controller refused a point or disarmed itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The session is not the present one.
    Session,
    /// The sequence number is not the next one.
    Sequence,
    /// The controller is not armed; only a START point arms it.
    NotArmed,
    /// A START point is not where the arm is.
    StartMismatch,
    /// A position outside the controller's limits.
    Limit,
    /// A segment faster than the controller's limits.
    Speed,
    /// Duration outside 8-100 ms.
    Duration,
    /// Power, mode, emergency stop or error forbid motion.
    State,
    /// The watchdog ran out.
    Watchdog,
    /// Stopped by the client.
    Stopped,
    /// The client left.
    ClientLost,
    /// A frame that does not belong to this dialect, or cannot be read.
    Protocol,
    /// A number that this version does not know.
    Unknown(i32),
}

impl Refusal {
    /// The number on the wire; 0 means none.
    pub const fn code(this: Option<Self>) -> i32 {
        match this {
            None => 0,
            Some(Self::Session) => 1,
            Some(Self::Sequence) => 2,
            Some(Self::NotArmed) => 3,
            Some(Self::StartMismatch) => 4,
            Some(Self::Limit) => 5,
            Some(Self::Speed) => 6,
            Some(Self::Duration) => 7,
            Some(Self::State) => 8,
            Some(Self::Watchdog) => 9,
            Some(Self::Stopped) => 10,
            Some(Self::ClientLost) => 11,
            Some(Self::Protocol) => 12,
            Some(Self::Unknown(code)) => code,
        }
    }

    /// The reason of a number on the wire.
    pub const fn from_code(code: i32) -> Option<Self> {
        Some(match code {
            0 => return None,
            1 => Self::Session,
            2 => Self::Sequence,
            3 => Self::NotArmed,
            4 => Self::StartMismatch,
            5 => Self::Limit,
            6 => Self::Speed,
            7 => Self::Duration,
            8 => Self::State,
            9 => Self::Watchdog,
            10 => Self::Stopped,
            11 => Self::ClientLost,
            12 => Self::Protocol,
            code => Self::Unknown(code),
        })
    }
}

/// The answer to a [`Point`], when it entered the queue or was refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PointReply {
    /// The session.
    pub session: i32,
    /// The point's number.
    pub sequence: i32,
    /// [`Refusal::code`]; 0 accepted.
    pub refusal: i32,
    /// The controller's cycle count.
    pub tick: i32,
}

impl Body for PointReply {
    const SIZE: usize = 16;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.session);
        codec.i32(&mut self.sequence);
        codec.i32(&mut self.refusal);
        codec.i32(&mut self.tick);
    }
}

/// The order to brake, flush and disarm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stop {
    /// The session.
    pub session: i32,
    /// The last point's number.
    pub sequence: i32,
}

impl Body for Stop {
    const SIZE: usize = 8;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.session);
        codec.i32(&mut self.sequence);
    }
}

/// The answer to a [`Stop`], given when braking has begun.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StopReply {
    /// The session.
    pub session: i32,
    /// The stop's number.
    pub sequence: i32,
    /// The controller's cycle count.
    pub tick: i32,
}

impl Body for StopReply {
    const SIZE: usize = 12;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.session);
        codec.i32(&mut self.sequence);
        codec.i32(&mut self.tick);
    }
}

/// Feedback of every controller cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Feedback {
    /// The session; 0 before the first greeting.
    pub session: i32,
    /// The controller's cycle count when the encoders were read.
    pub tick: i32,
    /// Number of the last point taken into the queue.
    pub sequence: i32,
    /// 1 while points are executed, else 0.
    pub armed: i32,
    /// Why it disarmed last: [`Refusal::code`].
    pub disarmed_by: i32,
    /// State of the controller.
    pub status: Status,
    /// Positions \[rad\].
    pub positions: [f32; JOINTS],
}

impl Body for Feedback {
    const SIZE: usize = 72;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.session);
        codec.i32(&mut self.tick);
        codec.i32(&mut self.sequence);
        codec.i32(&mut self.armed);
        codec.i32(&mut self.disarmed_by);
        self.status.visit(codec);
        codec.f32s(&mut self.positions);
    }
}
