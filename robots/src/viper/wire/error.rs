//! What can be wrong with a frame.

/// A frame that cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The length field reads well in the other byte order.
    #[error(
        "length field {found:#010x} where {swapped:#x} fits: the peer uses the other byte order"
    )]
    ByteOrder {
        /// The field as read.
        found: u32,
        /// The field in the other order.
        swapped: u32,
    },
    /// The length field is outside the range of known messages.
    #[error("length field {length} is not between {least} and {most}")]
    Length {
        /// The field.
        length: i32,
        /// Shortest frame without its length field \[bytes\].
        least: usize,
        /// Longest frame without its length field \[bytes\].
        most: usize,
    },
    /// The message type is unknown.
    #[error("unknown message type {kind}")]
    Type {
        /// The field.
        kind: i32,
    },
    /// The communication type is not topic, request or reply.
    #[error("unknown communication type {comm}")]
    Comm {
        /// The field.
        comm: i32,
    },
    /// The reply code is not none, success or failure.
    #[error("unknown reply code {code}")]
    ReplyCode {
        /// The field.
        code: i32,
    },
    /// The body does not have the size of its type.
    #[error("body of {found} bytes does not fit message type {kind}")]
    BodySize {
        /// Message type.
        kind: i32,
        /// Size of the body \[bytes\].
        found: usize,
    },
    /// A position or time is not a finite number.
    #[error("message type {kind} holds a number that is not finite")]
    NotFinite {
        /// Message type.
        kind: i32,
    },
}
