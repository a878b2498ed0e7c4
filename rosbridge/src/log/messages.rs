//! The messages of a log as they are, whatever they say.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use std::sync::Arc;

use hal::Stamp;
use mcap::records::{Record as Raw, op};

use super::error::{Damage, ReadError};
use super::kind::FileKind;
use super::records::Records;
use super::topic::MESSAGE_ENCODING;

/// A topic of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawChannel {
    /// Its name.
    pub topic: String,
    /// Type of its messages.
    pub message_type: String,
    /// Definition of that type, with all that it is made of.
    pub definition: String,
}

/// A message of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawMessage {
    /// Its topic.
    pub channel: Arc<RawChannel>,
    /// The run's time.
    pub stamp: Stamp,
    /// Its bytes, as ROS 1 has them.
    pub data: Vec<u8>,
}

/// A record: a message, or what says something of messages.
enum Taken {
    Message(RawMessage),
    Other,
}

/// Reads a log message by message, also one that breaks off.
pub struct Messages<R: Read> {
    records: Records<R>,
    schemas: HashMap<u16, (String, Vec<u8>)>,
    channels: HashMap<u16, Arc<RawChannel>>,
}

impl Messages<BufReader<File>> {
    /// Opens a log file.
    ///
    /// # Errors
    /// The file cannot be read or is no MCAP file.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        if path.is_dir() {
            return Err(ReadError::Foreign(FileKind::Folder));
        }
        let file = File::open(path).map_err(|source| ReadError::Io {
            path: path.display().to_string(),
            source,
        })?;
        Ok(Self {
            records: Records::new(BufReader::new(file))?,
            schemas: HashMap::new(),
            channels: HashMap::new(),
        })
    }
}

impl<R: Read> Messages<R> {
    /// Whether the end of the log was reached and the log was completed there.
    pub const fn is_complete(&self) -> bool {
        self.records.is_complete()
    }

    /// The next record; nothing at the end.
    fn take(&mut self) -> Result<Option<Taken>, ReadError> {
        let (schemas, channels) = (&mut self.schemas, &mut self.channels);
        self.records.next(|at, opcode, data| {
            if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
                return Ok(Taken::Other);
            }
            let raw = mcap::parse_record(opcode, data).map_err(|error| ReadError::Damaged {
                at,
                damage: Damage::Record(error),
            })?;
            match raw {
                Raw::Schema { header, data } => {
                    schemas.insert(header.id, (header.name, data.into_owned()));
                }
                Raw::Channel(channel) if channel.message_encoding == MESSAGE_ENCODING => {
                    if let Some((name, definition)) = schemas.get(&channel.schema_id) {
                        let channel_id = channel.id;
                        let channel = RawChannel {
                            topic: channel.topic,
                            message_type: name.clone(),
                            definition: String::from_utf8_lossy(definition).into_owned(),
                        };
                        channels.insert(channel_id, Arc::new(channel));
                    }
                }
                Raw::Message { header, data } => {
                    if let Some(channel) = channels.get(&header.channel_id) {
                        return Ok(Taken::Message(RawMessage {
                            channel: Arc::clone(channel),
                            stamp: Stamp::from_nanos(header.log_time),
                            data: data.into_owned(),
                        }));
                    }
                }
                _ => {}
            }
            Ok(Taken::Other)
        })
    }
}

impl<R: Read> Iterator for Messages<R> {
    type Item = Result<RawMessage, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.take() {
                Ok(Some(Taken::Message(message))) => return Some(Ok(message)),
                Ok(Some(Taken::Other)) => {}
                Ok(None) => return None,
                Err(error) => {
                    self.records.end();
                    return Some(Err(error));
                }
            }
        }
    }
}

impl<R: Read> std::fmt::Debug for Messages<R> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Messages")
            .field("channels", &self.channels)
            .finish_non_exhaustive()
    }
}
