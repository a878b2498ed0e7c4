//! Reading a log back, also one that breaks off.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;
use std::time::Duration;

use crate::seam::RosMsg;
use hal::{CameraFrame, StereoFrame, Telemetry};
use mcap::records::{Record as Raw, op};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use super::error::{Damage, ReadError};
use super::kind::FileKind;
use super::records::Records;
use super::topic::{
    MESSAGE_ENCODING, META_DOCUMENT, META_LABELS, META_RUN, META_VERSIONS, TOPICS, Topic,
};
use super::{Level, Record, RunInfo};
use crate::convert::{self, ConvertError};
use crate::image::{self, Depth};
use crate::msg::{needle_steer_msgs, rosgraph_msgs, sensor_msgs};

/// Reads a log record by record, also one whose chunks are compressed with zstd or lz4. A log
/// that breaks off ends there; see [`is_complete`](Self::is_complete). After an error nothing more
/// is read.
pub struct LogReader<R: Read> {
    records: Records<R>,
    /// Records that stood before the run's description: tools that rewrite a log may move it.
    early: VecDeque<Record>,
    run: RunInfo,
    schemas: HashMap<u16, Vec<u8>>,
    channels: HashMap<u16, Topic>,
    left: Option<CameraFrame>,
}

impl LogReader<BufReader<File>> {
    /// Opens a log file.
    ///
    /// # Errors
    /// The file cannot be read or is not the log of a run.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        if path.is_dir() {
            return Err(ReadError::Foreign(FileKind::Folder));
        }
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
        let mut reader = Self {
            records: Records::new(source)?,
            early: VecDeque::new(),
            run: RunInfo::default(),
            schemas: HashMap::new(),
            channels: HashMap::new(),
            left: None,
        };
        loop {
            match reader.event()? {
                Some(Event::RunComplete) => return Ok(reader),
                Some(Event::Nothing) => {}
                Some(Event::Record(record)) => reader.early.push_back(record),
                None => return Err(ReadError::NotARun { missing: META_RUN }),
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
        self.records.is_complete()
    }

    /// Takes in one MCAP record; nothing at the end.
    fn event(&mut self) -> Result<Option<Event>, ReadError> {
        let (run, schemas) = (&mut self.run, &mut self.schemas);
        let (channels, left) = (&mut self.channels, &mut self.left);
        self.records.next(|at, opcode, data| {
            let state = State {
                at,
                run,
                schemas,
                channels,
                left,
            };
            state.parse(opcode, data)
        })
    }
}

impl<R: Read> Iterator for LogReader<R> {
    type Item = Result<Record, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(record) = self.early.pop_front() {
            return Some(Ok(record));
        }
        loop {
            match self.event() {
                Ok(Some(Event::Record(record))) => return Some(Ok(record)),
                Ok(Some(Event::Nothing | Event::RunComplete)) => {}
                Ok(None) => return None,
                Err(error) => {
                    self.records.end();
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
            .field("complete", &self.is_complete())
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
    at: u64,
    run: &'a mut RunInfo,
    schemas: &'a mut HashMap<u16, Vec<u8>>,
    channels: &'a mut HashMap<u16, Topic>,
    left: &'a mut Option<CameraFrame>,
}

impl State<'_> {
    fn parse(self, opcode: u8, data: &[u8]) -> Result<Event, ReadError> {
        if !matches!(
            opcode,
            op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA
        ) {
            return Ok(Event::Nothing);
        }
        let at = self.at;
        let raw = mcap::parse_record(opcode, data).map_err(|error| ReadError::Damaged {
            at,
            damage: Damage::Record(error),
        })?;
        self.take(raw)
    }

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
                self.run.began = entries
                    .remove("began_unix_ns")
                    .and_then(|text| text.parse().ok())
                    .map(Duration::from_nanos);
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
        let at = self.at;
        let content = |problem| ReadError::Content {
            topic: name,
            at,
            problem,
        };
        let record = match topic {
            Topic::Arm => {
                let message: needle_steer_msgs::ArmState = decode(topic, at, data)?;
                Record::Arm((&message).try_into().map_err(content)?)
            }
            Topic::Shape => {
                let message: needle_steer_msgs::Shape = decode(topic, at, data)?;
                Record::Shape((&message).try_into().map_err(content)?)
            }
            Topic::Left => {
                *self.left = Some(camera_frame(topic, at, data)?);
                return Ok(Event::Nothing);
            }
            Topic::Right => {
                let right = camera_frame(topic, at, data)?;
                let left = self.left.take().ok_or(ReadError::UnpairedImage { at })?;
                Record::Stereo(StereoFrame { left, right })
            }
            Topic::Step => {
                let message: needle_steer_msgs::Step = decode(topic, at, data)?;
                Record::Step(Box::new(Telemetry::try_from(&message).map_err(content)?))
            }
            Topic::Command => {
                let message: needle_steer_msgs::RateCommand = decode(topic, at, data)?;
                Record::Command((&message).try_into().map_err(content)?)
            }
            Topic::Note => {
                let message: rosgraph_msgs::Log = decode(topic, at, data)?;
                Record::Note {
                    stamp: convert::stamp(message.header.stamp),
                    level: level(message.level).map_err(content)?,
                    text: message.msg,
                }
            }
            Topic::JointStates
            | Topic::Tip
            | Topic::Markers
            | Topic::Tf
            | Topic::TfStatic
            | Topic::LeftInfo
            | Topic::RightInfo
            | Topic::Robot => {
                return Ok(Event::Nothing);
            }
        };
        Ok(Event::Record(record))
    }
}

/// Decodes a message that must fill its record exactly.
fn decode<M: RosMsg>(topic: Topic, at: u64, mut data: &[u8]) -> Result<M, ReadError> {
    let error = |source| ReadError::Decode {
        topic: TOPICS[topic as usize].name,
        at,
        source,
    };
    let message = M::decode(&mut data).map_err(error)?;
    if data.is_empty() {
        Ok(message)
    } else {
        Err(error(io::ErrorKind::InvalidData.into()))
    }
}

fn camera_frame(topic: Topic, at: u64, data: &[u8]) -> Result<CameraFrame, ReadError> {
    let name = TOPICS[topic as usize].name;
    if !pixels_fill(data) {
        return Err(ReadError::Decode {
            topic: name,
            at,
            source: io::ErrorKind::InvalidData.into(),
        });
    }
    let message: sensor_msgs::Image = decode(topic, at, data)?;
    image::grey(message, &mut Depth::default()).map_err(|problem| ReadError::Content {
        topic: name,
        at,
        problem: problem.into(),
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
