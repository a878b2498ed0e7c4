//! Writing records as MCAP.

use std::collections::BTreeMap;
use std::io::{self, BufWriter, Write};
use std::time::Duration;

use crate::seam::RosMsg;
use hal::frame::{Frame, LeftCamera, RightCamera};
use hal::{Stamp, Telemetry};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;

use super::topic::{
    MESSAGE_ENCODING, META_DOCUMENT, META_LABELS, META_RUN, META_VERSIONS, PROFILE,
    SCHEMA_ENCODING, TOPICS, Topic,
};
use super::{Level, Record, RunInfo, Scenery};
use crate::bridge::{CameraModel, still};
use crate::msg::{needle_steer_msgs, rosgraph_msgs, std_msgs};
use crate::{convert, display};

/// A log that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The file cannot be made or written.
    #[error("log {path}")]
    Io {
        /// The file.
        path: String,
        /// Why.
        source: io::Error,
    },
    /// The MCAP writer failed.
    #[error("log")]
    Mcap(#[from] mcap::McapError),
    /// A message could not be encoded.
    #[error("encoding a log message")]
    Encode(#[from] io::Error),
    /// The log ended before, with an error that was reported then.
    #[error("the log has stopped")]
    Stopped,
    /// The disk was slower than the run.
    #[error("the disk was too slow: {records} records are missing")]
    Dropped {
        /// Records that are missing.
        records: u64,
    },
}

/// Size at which a chunk is closed \[bytes\]: what breaks off within one is lost, a tenth of a
/// second of a simulated run.
const CHUNK: u64 = 256 << 10;
/// Time between two drawings of the needle in the log.
const MARKER_PERIOD: Duration = Duration::from_millis(100);

/// Writes records to any sink, on the caller's thread. Nothing reaches the sink between
/// [`flush`](Self::flush)es except whole chunks.
pub struct LogWriter<W: Write> {
    mcap: mcap::Writer<NoSeek<BufWriter<W>>>,
    channels: [(u16, u32); TOPICS.len()],
    joint_names: Vec<String>,
    next_markers: Stamp,
    cameras: Option<[CameraModel; 2]>,
    buffer: Vec<u8>,
}

impl<W: Write> LogWriter<W> {
    /// Starts a log: writes all that is known of the run.
    ///
    /// # Errors
    /// The sink failed.
    pub fn new(sink: W, run: &RunInfo, scenery: Scenery) -> Result<Self, WriteError> {
        let mut mcap = mcap::WriteOptions::new()
            .profile(PROFILE)
            .library(concat!("needle-steer ", env!("CARGO_PKG_VERSION")))
            .chunk_size(Some(CHUNK))
            .disable_seeking(true)
            .create(NoSeek::new(BufWriter::new(sink)))?;
        for (name, metadata) in metadata(run) {
            mcap.write_metadata(&Metadata {
                name: name.to_owned(),
                metadata,
            })?;
        }
        let mut channels = [(0, 0); TOPICS.len()];
        for (channel, entry) in TOPICS.iter().zip(&mut channels) {
            let definition = (channel.definition)();
            let schema = mcap.add_schema(
                &(channel.message_type)(),
                SCHEMA_ENCODING,
                definition.as_bytes(),
            )?;
            entry.0 = mcap.add_channel(schema, channel.name, MESSAGE_ENCODING, &BTreeMap::new())?;
        }
        let mut log = Self {
            mcap,
            channels,
            joint_names: run.joint_names.clone(),
            next_markers: Stamp::ZERO,
            cameras: scenery.cameras,
            buffer: Vec::new(),
        };
        let tree = match &scenery.frames {
            Some(frames) => still(frames, Stamp::ZERO),
            None => display::tree(vec![display::edge(
                &run.world_from_left_camera,
                Stamp::ZERO,
            )]),
        };
        log.put(Topic::TfStatic, Stamp::ZERO, &tree)?;
        if let Some(data) = scenery.robot {
            log.put(Topic::Robot, Stamp::ZERO, &std_msgs::String { data })?;
        }
        log.flush()?;
        Ok(log)
    }

    /// Adds a record.
    ///
    /// # Errors
    /// The sink failed.
    pub fn write(&mut self, record: &Record) -> Result<(), WriteError> {
        match record {
            Record::Arm(state) => self.put(
                Topic::Arm,
                state.stamp,
                &needle_steer_msgs::ArmState::from(state),
            ),
            Record::Shape(shape) => self.put(
                Topic::Shape,
                shape.stamp,
                &needle_steer_msgs::Shape::from(shape),
            ),
            Record::Stereo(frame) => {
                let left = convert::image(&frame.left, LeftCamera::NAME);
                self.put(Topic::Left, frame.left.stamp, &left)?;
                let right = convert::image(&frame.right, RightCamera::NAME);
                self.put(Topic::Right, frame.right.stamp, &right)?;
                let infos = self.cameras.as_ref().map(|[of_left, of_right]| {
                    [of_left.message(left.header), of_right.message(right.header)]
                });
                let Some([of_left, of_right]) = infos else {
                    return Ok(());
                };
                self.put(Topic::LeftInfo, frame.left.stamp, &of_left)?;
                self.put(Topic::RightInfo, frame.right.stamp, &of_right)
            }
            Record::Step(telemetry) => self.step(telemetry),
            Record::Command(command) => {
                let message = needle_steer_msgs::RateCommand::from(command);
                self.put(Topic::Command, command.stamp, &message)
            }
            Record::Note { stamp, level, text } => self.note(*stamp, *level, text),
            Record::Document { name, text } => Ok(self.mcap.write_metadata(&Metadata {
                name: format!("{META_DOCUMENT}{name}"),
                metadata: [("text".to_owned(), text.clone())].into(),
            })?),
        }
    }

    /// Closes the chunk under way and hands everything to the sink.
    ///
    /// # Errors
    /// The sink failed.
    pub fn flush(&mut self) -> Result<(), WriteError> {
        Ok(self.mcap.flush()?)
    }

    /// Writes the summary and flushes: the log is complete.
    ///
    /// # Errors
    /// The sink failed.
    pub fn finish(mut self) -> Result<(), WriteError> {
        self.mcap.finish()?;
        Ok(self.mcap.into_inner().into_inner().flush()?)
    }

    fn step(&mut self, t: &Telemetry) -> Result<(), WriteError> {
        self.put(Topic::Step, t.stamp, &needle_steer_msgs::Step::from(t))?;
        let header = convert::header(t.stamp, "", t.step);
        let joints = display::joint_state(header, &self.joint_names, [&t.joints, &t.joint_rates]);
        self.put(Topic::JointStates, t.stamp, &joints)?;
        self.put(Topic::Tip, t.stamp, &display::tip(t))?;
        let needle = vec![
            display::edge(&t.world_from_base, t.stamp),
            display::tip_edge(t),
        ];
        self.put(Topic::Tf, t.stamp, &display::tree(needle))?;
        if t.stamp >= self.next_markers {
            self.next_markers = t.stamp + MARKER_PERIOD;
            self.put(Topic::Markers, t.stamp, &display::markers(t))?;
        }
        Ok(())
    }

    fn note(&mut self, stamp: Stamp, level: Level, text: &str) -> Result<(), WriteError> {
        let message = rosgraph_msgs::Log {
            header: convert::header(stamp, "", 0),
            level: level_code(level),
            name: "needle_steer".to_owned(),
            msg: text.to_owned(),
            ..rosgraph_msgs::Log::default()
        };
        self.put(Topic::Note, stamp, &message)
    }

    fn put(&mut self, topic: Topic, stamp: Stamp, message: &impl RosMsg) -> Result<(), WriteError> {
        self.buffer.clear();
        message.encode(&mut self.buffer)?;
        let (channel_id, sequence) = &mut self.channels[topic as usize];
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: *sequence,
            log_time: stamp.as_nanos(),
            publish_time: stamp.as_nanos(),
        };
        *sequence = sequence.wrapping_add(1);
        Ok(self.mcap.write_to_known_channel(&header, &self.buffer)?)
    }
}

impl<W: Write> std::fmt::Debug for LogWriter<W> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LogWriter")
            .field("channels", &self.channels)
            .finish_non_exhaustive()
    }
}

pub(crate) fn level_code(level: Level) -> i8 {
    match level {
        Level::Info => rosgraph_msgs::Log::INFO,
        Level::Warning => rosgraph_msgs::Log::WARN,
        Level::Error => rosgraph_msgs::Log::ERROR,
    }
}

/// The metadata records of a run; `run` comes last and so completes it.
fn metadata(run: &RunInfo) -> [(&'static str, BTreeMap<String, String>); 3] {
    let pose = run.world_from_left_camera.isometry();
    let (p, q) = (&pose.translation, &pose.rotation);
    // Debug output of a float is the shortest text that reads back as the same bits.
    let pose = [p.x, p.y, p.z, q.i, q.j, q.k, q.w]
        .map(|x| format!("{x:?}"))
        .join(" ");
    let entries = [
        ("config", run.config.clone()),
        ("seed", run.seed.to_string()),
        ("joint_names", run.joint_names.join(" ")),
        ("world_from_left_camera", pose),
    ];
    let mut entries = BTreeMap::from(entries.map(|(key, value)| (key.to_owned(), value)));
    entries.extend(run.began.map(|began| {
        let nanos = began.as_nanos().to_string();
        ("began_unix_ns".to_owned(), nanos)
    }));
    [
        (META_LABELS, run.labels.clone()),
        (META_VERSIONS, run.versions.clone()),
        (META_RUN, entries),
    ]
}
