//! Bodies of REP-I0006 messages.

use super::{Body, Codec};

/// Joints in every simple_message; those that the arm has not are zero.
pub const WIRE_JOINTS: usize = 10;

/// A sequence number of a trajectory point; negative ones are orders.
pub type Sequence = i32;

/// Special sequence numbers.
pub mod sequence {
    use super::Sequence;

    /// Start of a trajectory to be downloaded.
    pub const START_DOWNLOAD: Sequence = -1;
    /// Start of a streamed trajectory.
    pub const START_STREAMING: Sequence = -2;
    /// End of a trajectory.
    pub const END: Sequence = -3;
    /// Stop.
    pub const STOP: Sequence = -4;
}

/// Sign of life (type 1), in REP-I0006's long form.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ping {
    /// Unused.
    pub data: [i32; WIRE_JOINTS],
}

impl Body for Ping {
    const SIZE: usize = 40;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32s(&mut self.data);
    }
}

/// Measured positions (type 10).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointPosition {
    /// Number of the message; 0 from the Viper.
    pub sequence: Sequence,
    /// Positions \[rad\].
    pub positions: [f32; WIRE_JOINTS],
}

impl Body for JointPosition {
    const SIZE: usize = 44;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.sequence);
        codec.f32s(&mut self.positions);
    }
}

/// A set point (type 11).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrajPt {
    /// Number of the point, or an order of [`sequence`].
    pub sequence: Sequence,
    /// Positions to reach \[rad\].
    pub positions: [f32; WIRE_JOINTS],
    /// Speed, 0 to 1 of the highest.
    pub velocity: f32,
    /// Time for the segment \[s\].
    pub duration: f32,
}

impl Body for TrajPt {
    const SIZE: usize = 52;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.sequence);
        codec.f32s(&mut self.positions);
        codec.f32(&mut self.velocity);
        codec.f32(&mut self.duration);
    }
}

/// Short reply to a set point (type 11) as the Viper's 2018 program sends it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TrajAck {
    /// 0 for a point, [`sequence::STOP`] for a stop.
    pub sequence: Sequence,
}

impl Body for TrajAck {
    const SIZE: usize = 4;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.sequence);
    }
}

/// A yes-or-no that may be unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TriState {
    /// Not known.
    Unknown,
    /// No.
    False,
    /// Yes.
    True,
}

impl From<i32> for TriState {
    fn from(field: i32) -> Self {
        match field {
            0 => Self::False,
            1 => Self::True,
            _ => Self::Unknown,
        }
    }
}

/// Operating mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Not known; not automatic.
    Unknown,
    /// Manual.
    Manual,
    /// Automatic.
    Automatic,
}

/// State of the controller (type 13): tri-states -1 unknown, 0 no, 1 yes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// Drives have power.
    pub drives_powered: i32,
    /// Emergency stop pressed.
    pub e_stopped: i32,
    /// The controller's number of the error.
    pub error_code: i32,
    /// An error is pending.
    pub in_error: i32,
    /// The arm moves.
    pub in_motion: i32,
    /// 1 manual, 2 automatic, all else unknown.
    pub mode: i32,
    /// Motion is possible.
    pub motion_possible: i32,
}

impl Status {
    /// Powered, automatic, at rest, no error.
    pub const READY: Self = Self {
        drives_powered: 1,
        e_stopped: 0,
        error_code: 0,
        in_error: 0,
        in_motion: 0,
        mode: 2,
        motion_possible: 1,
    };

    /// The operating mode.
    pub const fn operating_mode(&self) -> Mode {
        match self.mode {
            1 => Mode::Manual,
            2 => Mode::Automatic,
            _ => Mode::Unknown,
        }
    }
}

impl Body for Status {
    const SIZE: usize = 28;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.drives_powered);
        codec.i32(&mut self.e_stopped);
        codec.i32(&mut self.error_code);
        codec.i32(&mut self.in_error);
        codec.i32(&mut self.in_motion);
        codec.i32(&mut self.mode);
        codec.i32(&mut self.motion_possible);
    }
}

/// A set point with time, speed and acceleration (type 14); not used by the Viper.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TrajPtFull {
    /// Number of the arm.
    pub robot_id: i32,
    /// Number of the point.
    pub sequence: Sequence,
    /// Which fields hold: 1 time, 2 positions, 4 velocities, 8 accelerations.
    pub valid: i32,
    /// Time from the start \[s\].
    pub time: f32,
    /// Positions \[rad\].
    pub positions: [f32; WIRE_JOINTS],
    /// Velocities \[rad/s\].
    pub velocities: [f32; WIRE_JOINTS],
    /// Accelerations \[rad/s2\].
    pub accelerations: [f32; WIRE_JOINTS],
}

impl Body for TrajPtFull {
    const SIZE: usize = 136;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.robot_id);
        codec.i32(&mut self.sequence);
        codec.i32(&mut self.valid);
        codec.f32(&mut self.time);
        codec.f32s(&mut self.positions);
        codec.f32s(&mut self.velocities);
        codec.f32s(&mut self.accelerations);
    }
}

/// Measured positions with time, speed and acceleration (type 15); not used by the Viper.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointFeedback {
    /// Number of the arm.
    pub robot_id: i32,
    /// Which fields hold: 1 time, 2 positions, 4 velocities, 8 accelerations.
    pub valid: i32,
    /// Time \[s\].
    pub time: f32,
    /// Positions \[rad\].
    pub positions: [f32; WIRE_JOINTS],
    /// Velocities \[rad/s\].
    pub velocities: [f32; WIRE_JOINTS],
    /// Accelerations \[rad/s2\].
    pub accelerations: [f32; WIRE_JOINTS],
}

impl Body for JointFeedback {
    const SIZE: usize = 132;

    fn visit(&mut self, codec: &mut impl Codec) {
        codec.i32(&mut self.robot_id);
        codec.i32(&mut self.valid);
        codec.f32(&mut self.time);
        codec.f32s(&mut self.positions);
        codec.f32s(&mut self.velocities);
        codec.f32s(&mut self.accelerations);
    }
}

/// Operation on the controller's digital signals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IoOperation {
    /// Reads a signal.
    Read,
    /// Writes a signal.
    Write,
}

/// A frame of the digital-signal port (11001) of the 2018 program: operation and signal number,
/// without a header. The driver does not use this port.
pub fn encode_io(operation: IoOperation, signal: i32) -> [u8; 8] {
    let code: i32 = match operation {
        IoOperation::Read => 1,
        IoOperation::Write => 2,
    };
    let mut bytes = [0; 8];
    bytes[..4].copy_from_slice(&code.to_be_bytes());
    bytes[4..].copy_from_slice(&signal.to_be_bytes());
    bytes
}
