//! Why a log cannot be read: what is wrong, where, and what helps.

use std::io;

use mcap::McapError;

use super::kind::FileKind;
use crate::convert::ConvertError;

/// A file that is not a readable log.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be read.
    #[error("log {path}")]
    Io {
        /// The file.
        path: String,
        /// Why.
        source: io::Error,
    },
    /// Reading stopped in the middle.
    #[error("reading stopped at byte {at}")]
    Source {
        /// Offset of the record \[bytes\].
        at: u64,
        /// Why.
        source: io::Error,
    },
    /// Not an MCAP file.
    #[error("{}, not the log of a run; {}", .0.name(), .0.remedy())]
    Foreign(FileKind),
    /// An MCAP file damaged inside.
    #[error(
        "the MCAP file is damaged at byte {at}: {damage}; `mcap recover` keeps what is sound, and a file copied again may be whole"
    )]
    Damaged {
        /// Offset of the record \[bytes\].
        at: u64,
        /// What is wrong.
        damage: Damage,
    },
    /// Compressed in a way that is not read.
    #[error(
        "the chunk at byte {at} is compressed with `{name}`; `mcap compress --compression zstd` writes one that is read"
    )]
    Compression {
        /// Offset of the chunk \[bytes\].
        at: u64,
        /// The compression.
        name: String,
    },
    /// Not the log of a run.
    #[error(
        "an MCAP file, but not the log of a run: {missing} is missing or malformed; `run --out FOLDER` writes logs, and `estimate` also reads CSV tables (docs/LOGS.md)"
    )]
    NotARun {
        /// What is missing.
        missing: &'static str,
    },
    /// Written with other message definitions.
    #[error(
        "{topic}: written with another definition of its messages; read it with the version that wrote it"
    )]
    Definition {
        /// The channel.
        topic: &'static str,
    },
    /// A message is malformed.
    #[error(
        "{topic}: malformed message in the record at byte {at}; `mcap recover` keeps what is sound"
    )]
    Decode {
        /// The channel.
        topic: &'static str,
        /// Offset of the record, or of the chunk it is in \[bytes\].
        at: u64,
        /// Why.
        source: io::Error,
    },
    /// A message says something impossible.
    #[error(
        "{topic}: impossible content in the record at byte {at}: {problem}; record again, or leave that topic out with `mcap filter`"
    )]
    Content {
        /// The channel.
        topic: &'static str,
        /// Offset of the record, or of the chunk it is in \[bytes\].
        at: u64,
        /// Why.
        problem: ConvertError,
    },
    /// A right image without its left one.
    #[error(
        "a right image without its left one at byte {at}; images may be left out with `mcap filter`"
    )]
    UnpairedImage {
        /// Offset of the record, or of the chunk it is in \[bytes\].
        at: u64,
    },
}

/// What is wrong with an MCAP record.
#[derive(Debug, thiserror::Error)]
pub enum Damage {
    /// A record of the file.
    #[error("{}", lower(.0))]
    Record(McapError),
    /// A chunk's checksum.
    #[error("the chunk's checksum is wrong")]
    Checksum,
    /// A chunk's data.
    #[error("the chunk cannot be decompressed ({0})")]
    Compressed(io::Error),
    /// A chunk's compression.
    #[error("the chunk is compressed with `{0}`")]
    Compression(String),
    /// A chunk's length.
    #[error("the chunk holds {found} bytes, not {declared}")]
    Length {
        /// As the chunk's header says.
        declared: u64,
        /// As decompressed.
        found: u64,
    },
    /// A chunk too large.
    #[error("the chunk claims {0} bytes")]
    Size(u64),
    /// A record longer than its chunk.
    #[error("a record ends beyond its chunk")]
    Overrun,
}

fn lower(error: &McapError) -> String {
    let text = error.to_string();
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| {
        first.to_lowercase().chain(letters).collect()
    })
}
