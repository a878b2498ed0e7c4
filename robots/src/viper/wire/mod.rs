//! Frames of the controller's sockets: ROS-Industrial simple_message (REP-I0006) and our own
//! [`steer`] messages in the vendor range.
//!
//! A frame is length (excluding itself) | message type | communication type | reply code | body,
//! all 32-bit, packed; the Viper's controller uses big-endian. Each body is described once, in
//! [`Body::visit`], for both directions.
//!
//! **Architecture invariant:** nothing here allocates or does I/O, and no input makes it panic.

mod cursor;
mod decoder;
mod error;
mod frame;
mod simple;
pub mod steer;

pub use cursor::{Body, ByteOrder, Codec};
pub use decoder::Decoder;
pub use error::WireError;
pub use frame::{Bytes, Comm, Frame, HEADER, MAX_FRAME, Message, ReplyCode};
pub use simple::{
    IoOperation, JointFeedback, JointPosition, Mode, Ping, Sequence, Status, TrajAck, TrajPt,
    TrajPtFull, TriState, WIRE_JOINTS, encode_io, sequence,
};
