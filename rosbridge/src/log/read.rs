//! Reading a log back, also one that breaks off.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

use crate::seam::RosMsg;
use hal::{CameraFrame, StereoFrame, Telemetry};
use mcap::McapError;
use mcap::records::{Record as Raw, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use super::topic::{
    MESSAGE_ENCODING, META_DOCUMENT, META_LABELS, META_RUN, META_VERSIONS, TOPICS, Topic,
};
use super::{Level, Record, RunInfo};
use crate::convert::{self, ConvertError};
use crate::msg::{needle_steer_msgs, rosgraph_msgs, sensor_msgs};

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
    /// Not an MCAP file, or damaged inside.
    #[error("not a sound MCAP file")]
    Mcap(#[from] McapError),
    /// Not the log of a run.
    #[error("not the log of a run: {missing} is missing or malformed")]
    NotARun {
        /// What is missing.
        missing: &'static str,
    },
    /// Written with other message definitions.
    #[error("{topic}: written with another definition of its messages")]
    Definition {
        /// The channel.
        topic: &'static str,
    },
    /// A message is malformed.
    #[error("{topic}: malformed message")]
    Decode {
        /// The channel.
        topic: &'static str,
        /// Why.
        source: io::Error,
    },
    /// A message says something impossible.
    #[error("{topic}: {source}")]
    Content {
        /// The channel.
        topic: &'static str,
        /// Why.
        source: ConvertError,
    },
    /// A right image without its left one.
    #[error("a right image without its left one")]
    UnpairedImage,
}

/// Longest record or chunk that is read \[bytes\]; keeps a damaged length from filling memory.
const RECORD_LIMIT: usize = 256 << 20;

/// Reads a log record by record. A log that breaks off ends there; see
/// [`is_complete`](Self::is_complete). After an error nothing more is read.
pub struct LogReader<R: Read> {
    source: R,
    mcap: LinearReader,
    run: RunInfo,
    schemas: HashMap<u16, Vec<u8>>,
    channels: HashMap<u16, Topic>,
    left: Option<CameraFrame>,
    complete: bool,
    ended: bool,
}

impl LogReader<BufReader<File>> {
    /// Opens a log file.
    ///
    /// # Errors
    /// The file cannot be read or is not the log of a run.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let file = File::open(path).map_err(|source| ReadError::Io {
            path: path.display().to_string(),
            source,
        })?;
        Self::new(BufReader::new(file))
    }
}

impl<R: Read> LogReader<R> {
    /// Starts to read: takes in all that is known of the run.
    ///
    /// # Errors
    /// The source cannot be read or is not the log of a run.
    pub fn new(source: R) -> Result<Self, ReadError> {
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(RECORD_LIMIT);
        let mut reader = Self {
            source,
            mcap: LinearReader::new_with_options(options),
            run: RunInfo::default(),
            schemas: HashMap::new(),
            channels: HashMap::new(),
            left: None,
            complete: false,
            ended: false,
        };
        loop {
            match reader.event()? {
                Some(Event::RunComplete) => return Ok(reader),
                Some(Event::Nothing) => {}
                Some(Event::Record(_)) | None => {
                    return Err(ReadError::NotARun { missing: META_RUN });
                }
            }
        }
    }

    /// The run as a whole.
    pub const fn run(&self) -> &RunInfo {
        &self.run
    }

    /// Whether the end of the log was reached and the log was completed there; false for the
    /// log of a killed process.
    pub const fn is_complete(&self) -> bool {
        self.complete
    }

    /// Takes in one MCAP record; nothing at the end.
    fn event(&mut self) -> Result<Option<Event>, ReadError> {
        while !self.ended {
            let need = match self.mcap.next_event() {
                None | Some(Err(McapError::UnexpectedEof)) => break,
                Some(Err(error)) => return Err(error.into()),
                Some(Ok(LinearReadEvent::ReadRequest(need))) => need,
                Some(Ok(LinearReadEvent::Record { data, opcode })) => match opcode {
                    op::FOOTER => {
                        self.complete = true;
                        break;
                    }
                    op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA => {
                        let state = State {
                            run: &mut self.run,
                            schemas: &mut self.schemas,
                            channels: &mut self.channels,
                            left: &mut self.left,
                        };
                        return state.take(mcap::parse_record(opcode, data)?).map(Some);
                    }
                    _ => continue,
                },
            };
            let read = loop {
                match self.source.read(self.mcap.insert(need)) {
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                    read => break read.map_err(McapError::Io)?,
                }
            };
            self.mcap.notify_read(read);
        }
        self.ended = true;
        Ok(None)
    }
}

impl<R: Read> Iterator for LogReader<R> {
    type Item = Result<Record, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.event() {
                Ok(Some(Event::Record(record))) => return Some(Ok(record)),
                Ok(Some(Event::Nothing | Event::RunComplete)) => {}
                Ok(None) => return None,
                Err(error) => {
                    self.ended = true;
                    return Some(Err(error));
                }
            }
        }
    }
}

impl<R: Read> std::fmt::Debug for LogReader<R> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LogReader")
            .field("run", &self.run)
            .field("complete", &self.complete)
            .finish_non_exhaustive()
    }
}

enum Event {
    Record(Record),
    RunComplete,
    Nothing,
}

/// The reader's memory, apart from the MCAP reader whose buffer the record borrows.
struct State<'a> {
    run: &'a mut RunInfo,
    schemas: &'a mut HashMap<u16, Vec<u8>>,
    channels: &'a mut HashMap<u16, Topic>,
    left: &'a mut Option<CameraFrame>,
}

impl State<'_> {
    fn take(self, raw: Raw<'_>) -> Result<Event, ReadError> {
        match raw {
            Raw::Schema { header, data } => {
                self.schemas.insert(header.id, data.into_owned());
            }
            Raw::Channel(channel) => {
                if let Some(known) = TOPICS.iter().find(|known| known.name == channel.topic) {
                    let schema = self.schemas.get(&channel.schema_id);
                    let same = schema.is_some_and(|data| *data == (known.definition)().as_bytes());
                    if !same || channel.message_encoding != MESSAGE_ENCODING {
                        return Err(ReadError::Definition { topic: known.name });
                    }
                    self.channels.insert(channel.id, known.topic);
                }
            }
            Raw::Metadata(metadata) => return self.metadata(&metadata.name, metadata.metadata),
            Raw::Message { header, data } => {
                if let Some(&topic) = self.channels.get(&header.channel_id) {
                    return self.message(topic, &data);
                }
            }
            _ => {}
        }
        Ok(Event::Nothing)
    }

    fn metadata(
        self,
        name: &str,
        mut entries: BTreeMap<String, String>,
    ) -> Result<Event, ReadError> {
        match name {
            META_LABELS => self.run.labels = entries,
            META_VERSIONS => self.run.versions = entries,
            META_RUN => {
                let mut take = |missing| {
                    entries
                        .remove(missing)
                        .ok_or(ReadError::NotARun { missing })
                };
                self.run.config = take("config")?;
                self.run.seed = take("seed")?
                    .parse()
                    .map_err(|_| ReadError::NotARun { missing: "seed" })?;
                self.run.joint_names = take("joint_names")?
                    .split_whitespace()
                    .map(str::to_owned)
                    .collect();
                self.run.world_from_left_camera = hal::Transform::assume(
                    isometry(&take("world_from_left_camera")?).ok_or(ReadError::NotARun {
                        missing: "world_from_left_camera",
                    })?,
                );
                return Ok(Event::RunComplete);
            }
            _ => {
                if let Some(name) = name.strip_prefix(META_DOCUMENT) {
                    return Ok(Event::Record(Record::Document {
                        name: name.to_owned(),
                        text: entries.remove("text").unwrap_or_default(),
                    }));
                }
            }
        }
        Ok(Event::Nothing)
    }

    fn message(self, topic: Topic, data: &[u8]) -> Result<Event, ReadError> {
        let name = TOPICS[topic as usize].name;
        let content = |source| ReadError::Content {
            topic: name,
            source,
        };
        let record = match topic {
            Topic::Arm => {
                let message: needle_steer_msgs::ArmState = decode(topic, data)?;
                Record::Arm((&message).try_into().map_err(content)?)
            }
            Topic::Shape => {
                let message: needle_steer_msgs::Shape = decode(topic, data)?;
                Record::Shape((&message).try_into().map_err(content)?)
            }
            Topic::Left => {
                *self.left = Some(image(topic, data)?);
                return Ok(Event::Nothing);
            }
            Topic::Right => {
                let right = image(topic, data)?;
                let left = self.left.take().ok_or(ReadError::UnpairedImage)?;
                Record::Stereo(StereoFrame { left, right })
            }
            Topic::Step => {
                let message: needle_steer_msgs::Step = decode(topic, data)?;
                Record::Step(Box::new(Telemetry::try_from(&message).map_err(content)?))
            }
            Topic::Command => {
                let message: needle_steer_msgs::RateCommand = decode(topic, data)?;
                Record::Command((&message).try_into().map_err(content)?)
            }
            Topic::Note => {
                let message: rosgraph_msgs::Log = decode(topic, data)?;
                Record::Note {
                    stamp: convert::stamp(message.header.stamp),
                    level: level(message.level).map_err(content)?,
                    text: message.msg,
                }
            }
            Topic::JointStates | Topic::Tip | Topic::Markers | Topic::Tf | Topic::TfStatic => {
                return Ok(Event::Nothing);
            }
        };
        Ok(Event::Record(record))
    }
}

/// Decodes a message that must fill its record exactly.
fn decode<M: RosMsg>(topic: Topic, mut data: &[u8]) -> Result<M, ReadError> {
    let error = |source| ReadError::Decode {
        topic: TOPICS[topic as usize].name,
        source,
    };
    let message = M::decode(&mut data).map_err(error)?;
    if data.is_empty() {
        Ok(message)
    } else {
        Err(error(io::ErrorKind::InvalidData.into()))
    }
}

fn image(topic: Topic, data: &[u8]) -> Result<CameraFrame, ReadError> {
    let name = TOPICS[topic as usize].name;
    if !pixels_fill(data) {
        return Err(ReadError::Decode {
            topic: name,
            source: io::ErrorKind::InvalidData.into(),
        });
    }
    let message: sensor_msgs::Image = decode(topic, data)?;
    convert::from_image(message).map_err(|source| ReadError::Content {
        topic: name,
        source,
    })
}

/// Whether an encoded image declares exactly as many pixels as follow; the generated decoder
/// reserves what is declared before it looks.
fn pixels_fill(data: &[u8]) -> bool {
    let length = |at: usize| {
        let bytes = data.get(at..at.checked_add(4)?)?.try_into().ok()?;
        usize::try_from(u32::from_le_bytes(bytes)).ok()
    };
    let frame_id = 12;
    let filled = || {
        let encoding = frame_id + 4 + length(frame_id)? + 8;
        let pixels = encoding + 4 + length(encoding)? + 5;
        Some(data.len() == pixels + 4 + length(pixels)?)
    };
    filled().unwrap_or(false)
}

fn level(code: i8) -> Result<Level, ConvertError> {
    match code {
        rosgraph_msgs::Log::INFO => Ok(Level::Info),
        rosgraph_msgs::Log::WARN => Ok(Level::Warning),
        rosgraph_msgs::Log::ERROR => Ok(Level::Error),
        _ => Err(ConvertError::UnknownCode {
            field: "level",
            code: u8::try_from(code).unwrap_or(u8::MAX),
        }),
    }
}

/// Translation and quaternion from seven numbers, bit by bit.
fn isometry(text: &str) -> Option<Isometry3<f64>> {
    let numbers: Vec<f64> = text
        .split(' ')
        .map(str::parse)
        .collect::<Result<_, _>>()
        .ok()?;
    let &[x, y, z, i, j, k, w] = numbers.as_slice() else {
        return None;
    };
    Some(Isometry3::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k)),
    ))
}
