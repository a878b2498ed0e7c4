//! What can be wrong with bytes, and with what is to become bytes.

/// Why bytes are not taken for a message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Reject {
    /// A header version that is not 1, 2 or 3.
    #[error("header version {found}, expected 1 to 3")]
    Version {
        /// What the header says.
        found: u16,
    },
    /// A body that is larger than the reader takes.
    #[error("a body of {bytes} bytes, at most {limit} are taken")]
    Oversized {
        /// What the header says.
        bytes: u64,
        /// What is taken.
        limit: usize,
    },
    /// The body does not belong to its checksum.
    #[error("checksum {found:#018x}, the body's is {expected:#018x}")]
    Checksum {
        /// Of the body.
        expected: u64,
        /// In the header.
        found: u64,
    },
    /// The bytes end before the message does.
    #[error("cut short in {field}")]
    Truncated {
        /// Where.
        field: &'static str,
    },
    /// Bytes are left where the content has ended.
    #[error("{bytes} bytes after the end of the content")]
    Trailing {
        /// How many.
        bytes: usize,
    },
    /// A text that is not UTF-8.
    #[error("{field} is no text")]
    Text {
        /// Which.
        field: &'static str,
    },
    /// A value that the protocol does not know.
    #[error("{field} is {found}")]
    Value {
        /// Which.
        field: &'static str,
        /// What it is.
        found: u64,
    },
    /// A type of message that is not read here.
    #[error("messages of type {name} are not read")]
    Type {
        /// Its name.
        name: String,
    },
}

impl Reject {
    /// Whether it is unknown where the next message begins: the connection has to be given up.
    pub const fn is_fatal(&self) -> bool {
        matches!(
            self,
            Self::Version { .. } | Self::Oversized { .. } | Self::Checksum { .. }
        )
    }

    /// A word for counters.
    pub const fn reason(&self) -> &'static str {
        match self {
            Self::Version { .. } => "version",
            Self::Oversized { .. } => "oversized",
            Self::Checksum { .. } => "checksum",
            Self::Truncated { .. } => "truncated",
            Self::Trailing { .. } => "trailing",
            Self::Text { .. } => "text",
            Self::Value { .. } => "value",
            Self::Type { .. } => "type",
        }
    }
}

/// A message that has no bytes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unsendable {
    /// A text that its field does not hold.
    #[error("{field} has {bytes} bytes, at most {limit} have room")]
    Long {
        /// Which.
        field: &'static str,
        /// Its length.
        bytes: usize,
        /// What there is room for.
        limit: usize,
    },
    /// A text with a zero byte, which ends texts on the wire.
    #[error("{field} contains a zero byte")]
    Zero {
        /// Which.
        field: &'static str,
    },
    /// More of something than can be counted on the wire.
    #[error("{found} {field}, at most {limit} can be counted")]
    Many {
        /// Of what.
        field: &'static str,
        /// How many.
        found: usize,
        /// How many can be.
        limit: usize,
    },
    /// Numbers that do not agree with each other.
    #[error("{field}: {found} where {expected} belong")]
    Disagree {
        /// Of what.
        field: &'static str,
        /// How many there are.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
}
