//! A log as a bag, for what reads bags: of ROS 1 and of ROS 2.
//!
//! Topics, types and contents are the log's. Stamps are wall-clock time, so that a bag can be laid
//! beside those of other recorders: the run's time and when it began, which the log says.

pub(crate) mod definition;
pub(crate) mod rewrite;
mod ros1;
pub(crate) mod ros2;
pub(crate) mod walk;

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::log::{LogReader, Messages, RawChannel, RawMessage, ReadError, log_sum};
use crate::msg::rosgraph_msgs;
use crate::seam::RosMsg;
use definition::Definition;
pub use definition::DefinitionError;
use rewrite::{Cdr, Ros1};
pub use walk::Malformed;
use walk::{Sink, walk};

/// The type whose number ROS 2 has not.
pub(crate) const HEADER: &str = "std_msgs/Header";
/// Topics on which one message holds for good.
const LATCHED: [&str; 2] = ["/tf_static", "/robot_description"];
/// Type of notes in ROS 1, and in ROS 2, whose levels are others.
pub(crate) const NOTE: &str = "rosgraph_msgs/Log";
const NOTE_2: &str = "rcl_interfaces/msg/Log";
const NOTE_2_DEFINITION: &str = "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n\
     builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\n\
     uint32 line\n";

/// A bag that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// The log.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A topic's definition.
    #[error("{topic}")]
    Definition {
        /// The topic.
        topic: String,
        /// What is wrong.
        source: DefinitionError,
    },
    /// A message.
    #[error("{topic}")]
    Message {
        /// The topic.
        topic: String,
        /// What is wrong.
        source: Malformed,
    },
    /// The bag.
    #[error("{path}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file in the bag.
    #[error("{path}")]
    Mcap {
        /// The file.
        path: PathBuf,
        /// Why.
        source: mcap::McapError,
    },
}

/// What a bag holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Written {
    /// Messages.
    pub messages: u64,
    /// Whether the log was whole.
    pub complete: bool,
}

/// A topic of a bag.
struct Topic<'a> {
    name: &'a str,
    message_type: &'a str,
    definition: &'a str,
    md5sum: &'a str,
    latched: bool,
}

/// A message of a bag.
struct Stamped<'a> {
    /// Wall-clock time \[ns\].
    nanos: u64,
    data: &'a [u8],
}

/// Writes `log` as the ROS 1 bag `bag`.
///
/// # Errors
/// See [`BagError`].
pub fn write_ros1(log: &Path, bag: &Path) -> Result<Written, BagError> {
    let io = |source| BagError::Io {
        path: bag.to_owned(),
        source,
    };
    let began = began(log)?;
    let file = File::create(bag).map_err(io)?;
    let mut out = ros1::Bag::new(BufWriter::new(file)).map_err(io)?;
    let mut topics: HashMap<Arc<str>, (u32, Definition)> = HashMap::new();
    let mut messages = Messages::open(log)?;
    let mut written = 0;
    for message in messages.by_ref() {
        let RawMessage {
            channel,
            stamp,
            data,
        } = message?;
        if !topics.contains_key(channel.topic.as_str()) {
            let sum = log_sum(&channel.topic).unwrap_or_else(|| "*".to_owned());
            let number = out.connect(&Topic {
                name: &channel.topic,
                message_type: &channel.message_type,
                definition: &channel.definition,
                md5sum: &sum,
                latched: LATCHED.contains(&channel.topic.as_str()),
            });
            let definition = read(&channel)?;
            topics.insert(channel.topic.as_str().into(), (number, definition));
        }
        let Some((number, definition)) = topics.get(channel.topic.as_str()) else {
            continue;
        };
        let mut same = Ros1::new(began);
        rewrite(&channel, definition, &data, &mut same)?;
        let message = Stamped {
            nanos: stamp.as_nanos().saturating_add(began),
            data: &same.bytes,
        };
        out.write(*number, &message).map_err(io)?;
        written += 1;
    }
    out.finish().map_err(io)?;
    Ok(Written {
        messages: written,
        complete: messages.is_complete(),
    })
}

/// Writes `log` as the ROS 2 bag `folder`, which is made: an MCAP file in CDR, and `metadata.yaml`.
///
/// # Errors
/// See [`BagError`].
pub fn write_ros2(log: &Path, folder: &Path) -> Result<Written, BagError> {
    let began = began(log)?;
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let name = format!("{name}_0.mcap");
    let path = folder.join(&name);
    let io = |source| BagError::Io {
        path: path.clone(),
        source,
    };
    let mcap = |source| BagError::Mcap {
        path: path.clone(),
        source,
    };
    std::fs::create_dir(folder).map_err(io)?;
    let file = File::create(&path).map_err(io)?;
    let mut out = ros2::Storage::new(BufWriter::new(file)).map_err(mcap)?;
    let mut topics: HashMap<Arc<str>, (usize, Definition)> = HashMap::new();
    let mut messages = Messages::open(log)?;
    let mut written = 0;
    for message in messages.by_ref() {
        let RawMessage {
            channel,
            stamp,
            data,
        } = message?;
        let is_note = channel.message_type == NOTE;
        if !topics.contains_key(channel.topic.as_str()) {
            let definition = read(&channel)?;
            let (message_type, text) = if is_note {
                (NOTE_2.to_owned(), note_definition())
            } else {
                let name = ros2::type_name(&channel.message_type);
                (name, ros2::definition(&definition))
            };
            let topic = Topic {
                name: &channel.topic,
                message_type: &message_type,
                definition: &text,
                md5sum: "",
                latched: LATCHED.contains(&channel.topic.as_str()),
            };
            let number = out.connect(&topic).map_err(mcap)?;
            topics.insert(channel.topic.as_str().into(), (number, definition));
        }
        let Some((number, definition)) = topics.get(channel.topic.as_str()) else {
            continue;
        };
        let mut cdr = Cdr::new(began);
        if is_note {
            note(&data, &mut cdr).map_err(|source| BagError::Message {
                topic: channel.topic.clone(),
                source,
            })?;
        } else {
            rewrite(&channel, definition, &data, &mut cdr)?;
        }
        let message = Stamped {
            nanos: stamp.as_nanos().saturating_add(began),
            data: &cdr.into_bytes(),
        };
        out.write(*number, &message).map_err(mcap)?;
        written += 1;
    }
    let description = out.finish(&name).map_err(mcap)?;
    std::fs::write(folder.join("metadata.yaml"), description).map_err(io)?;
    Ok(Written {
        messages: written,
        complete: messages.is_complete(),
    })
}

/// Wall-clock time at the run's time zero \[ns\]; zero where the log does not say.
fn began(log: &Path) -> Result<u64, ReadError> {
    let began = LogReader::open(log)?.run().began.unwrap_or_default();
    Ok(u64::try_from(began.as_nanos()).unwrap_or(0))
}

fn read(channel: &RawChannel) -> Result<Definition, BagError> {
    Definition::read(&channel.message_type, &channel.definition).map_err(|source| {
        BagError::Definition {
            topic: channel.topic.clone(),
            source,
        }
    })
}

fn rewrite(
    channel: &RawChannel,
    definition: &Definition,
    data: &[u8],
    sink: &mut dyn Sink,
) -> Result<(), BagError> {
    walk(definition, data, sink).map_err(|source| BagError::Message {
        topic: channel.topic.clone(),
        source,
    })
}

fn note_definition() -> String {
    format!(
        "{NOTE_2_DEFINITION}{}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n",
        "=".repeat(80)
    )
}

/// A note as ROS 2 has it.
pub(crate) fn note(mut data: &[u8], cdr: &mut Cdr) -> Result<(), Malformed> {
    let note = rosgraph_msgs::Log::decode(&mut data).map_err(|_| Malformed)?;
    let level = match note.level {
        rosgraph_msgs::Log::DEBUG => 10,
        rosgraph_msgs::Log::WARN => 30,
        rosgraph_msgs::Log::ERROR => 40,
        rosgraph_msgs::Log::FATAL => 50,
        _ => 20,
    };
    cdr.stamp(note.header.stamp.sec, note.header.stamp.nsec);
    cdr.plain(1, &[level]);
    for text in [&note.name, &note.msg, &note.file, &note.function] {
        cdr.text(text.as_bytes());
    }
    cdr.plain(4, &note.line.to_le_bytes());
    Ok(())
}

/// Seconds and nanoseconds; seconds beyond 32 bits are the last ones.
fn seconds(nanos: u64) -> (u32, u32) {
    const SECOND: u64 = 1_000_000_000;
    let whole = u32::try_from(nanos / SECOND).unwrap_or(u32::MAX);
    (whole, u32::try_from(nanos % SECOND).unwrap_or(0))
}

fn nanos(seconds: u32, nanos: u32) -> u64 {
    u64::from(seconds) * 1_000_000_000 + u64::from(nanos)
}
