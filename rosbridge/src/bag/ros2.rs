//! ROS 2 bags: an MCAP file of messages in CDR and a description of it.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{Seek, Write};

use mcap::records::MessageHeader;

use super::definition::{Count, Definition, Field, Kind};
use super::rewrite::{Cdr, in_ros2, ros2_name};
use super::walk::Sink;
use super::{Stamped, Topic};

/// A field that ROS 2 has and ROS 1 has not.
pub(crate) struct Added {
    /// The type, and the field of it that it stands before.
    before: (&'static str, &'static str),
    /// As definitions have it.
    line: &'static str,
    /// Writes it where there is none.
    pub(crate) empty: fn(&mut Cdr),
}

/// What ROS 2 added to the types of ROS 1 that logs hold, in its order.
const ADDED: [Added; 4] = [
    Added {
        before: ("visualization_msgs/Marker", "text"),
        line: "string texture_resource",
        empty: |cdr| cdr.text(b""),
    },
    Added {
        before: ("visualization_msgs/Marker", "text"),
        line: "sensor_msgs/CompressedImage texture",
        empty: |cdr| {
            cdr.time(0, 0);
            cdr.text(b"");
            cdr.text(b"");
            cdr.count(0);
        },
    },
    Added {
        before: ("visualization_msgs/Marker", "text"),
        line: "visualization_msgs/UVCoordinate[] uv_coordinates",
        empty: |cdr| cdr.count(0),
    },
    Added {
        before: ("visualization_msgs/Marker", "mesh_use_embedded_materials"),
        line: "visualization_msgs/MeshFile mesh_file",
        empty: |cdr| {
            cdr.text(b"");
            cdr.count(0);
        },
    },
];

/// Types that added fields need.
const ADDED_TYPES: [(&str, &str); 3] = [
    (
        "sensor_msgs/CompressedImage",
        "std_msgs/Header header\nstring format\nuint8[] data\n",
    ),
    ("visualization_msgs/UVCoordinate", "float32 u\nfloat32 v\n"),
    (
        "visualization_msgs/MeshFile",
        "string filename\nuint8[] data\n",
    ),
];

const TIME: (&str, &str) = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
const DURATION: (&str, &str) = ("builtin_interfaces/Duration", "int32 sec\nuint32 nanosec\n");

/// What stands before that field.
pub(crate) fn added_before<'a>(
    of: &'a str,
    field: &'a str,
) -> impl Iterator<Item = &'static Added> {
    ADDED
        .iter()
        .filter(move |added| added.before == (of, field))
}

/// The definition as ROS 2 has it.
pub(crate) fn definition(definition: &Definition) -> String {
    let mut text = String::new();
    let (mut times, mut durations, mut added) = (false, false, false);
    for (i, kind) in definition.types.iter().enumerate() {
        if i > 0 {
            section(&mut text, &kind.name);
        }
        for constant in &kind.constants {
            let _ = writeln!(text, "{}", constant_line(constant));
        }
        for field in &kind.fields {
            for more in added_before(&kind.name, &field.name) {
                added = true;
                let _ = writeln!(text, "{}", more.line);
            }
            if !in_ros2(&kind.name, &field.name) {
                continue;
            }
            times |= field.kind == Kind::Time;
            durations |= field.kind == Kind::Duration;
            let _ = writeln!(text, "{} {}", type_of(field), ros2_name(&field.name));
        }
    }
    let more = [(times, TIME), (durations, DURATION)];
    let more = more
        .into_iter()
        .chain(ADDED_TYPES.map(|entry| (added, entry)));
    for (_, (name, fields)) in more.filter(|(wanted, _)| *wanted) {
        section(&mut text, name);
        text.push_str(fields);
    }
    text
}

fn section(text: &mut String, name: &str) {
    let _ = writeln!(text, "{}\nMSG: {name}", "=".repeat(80));
}

fn type_of(field: &Field) -> String {
    let name = match (&field.kind, field.type_name.as_str()) {
        (Kind::Time, _) => TIME.0,
        (Kind::Duration, _) => DURATION.0,
        // An octet of ROS 1 has a sign.
        (_, "byte") => "int8",
        (_, "char") => "uint8",
        (_, name) => name,
    };
    match field.count {
        Count::One => name.to_owned(),
        Count::Fixed(count) => format!("{name}[{count}]"),
        Count::Any => format!("{name}[]"),
    }
}

fn constant_line(constant: &str) -> String {
    match constant.split_once(' ') {
        Some(("byte", rest)) => format!("int8 {rest}"),
        Some(("char", rest)) => format!("uint8 {rest}"),
        _ => constant.to_owned(),
    }
}

/// A type's name in ROS 2.
pub(crate) fn type_name(name: &str) -> String {
    name.replacen('/', "/msg/", 1)
}

/// Quality of service of what is said once and holds, as bags describe it: the last one, reliable,
/// kept for late subscribers.
const LATCHED: &str = "- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: 1
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false";

/// The quality of service that the file and its description say.
fn quality(latched: bool) -> &'static str {
    if latched { LATCHED } else { "" }
}

/// What a description says of a topic.
#[derive(Debug)]
struct Told {
    id: u16,
    name: String,
    message_type: String,
    latched: bool,
    count: u32,
}

/// Writes the MCAP file of a bag.
pub(super) struct Storage<W: Write + Seek> {
    mcap: mcap::Writer<W>,
    topics: Vec<Told>,
    times: Option<(u64, u64)>,
}

impl<W: Write + Seek> Storage<W> {
    pub(super) fn new(sink: W) -> Result<Self, mcap::McapError> {
        let mcap = mcap::WriteOptions::new()
            .profile("ros2")
            .library(concat!("needle-steer ", env!("CARGO_PKG_VERSION")))
            .create(sink)?;
        Ok(Self {
            mcap,
            topics: Vec::new(),
            times: None,
        })
    }

    /// A topic, `message_type` and definition being ROS 2's; its number.
    pub(super) fn connect(&mut self, topic: &Topic<'_>) -> Result<usize, mcap::McapError> {
        let schema =
            self.mcap
                .add_schema(topic.message_type, "ros2msg", topic.definition.as_bytes())?;
        let quality = quality(topic.latched).to_owned();
        let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), quality)]);
        let id = self
            .mcap
            .add_channel(schema, topic.name, "cdr", &metadata)?;
        self.topics.push(Told {
            id,
            name: topic.name.to_owned(),
            message_type: topic.message_type.to_owned(),
            latched: topic.latched,
            count: 0,
        });
        Ok(self.topics.len() - 1)
    }

    pub(super) fn write(
        &mut self,
        topic: usize,
        message: &Stamped<'_>,
    ) -> Result<(), mcap::McapError> {
        let Some(told) = self.topics.get_mut(topic) else {
            return Ok(());
        };
        let header = MessageHeader {
            channel_id: told.id,
            sequence: told.count,
            log_time: message.nanos,
            publish_time: message.nanos,
        };
        told.count += 1;
        let (first, last) = self.times.unwrap_or((message.nanos, message.nanos));
        self.times = Some((first.min(message.nanos), last.max(message.nanos)));
        self.mcap.write_to_known_channel(&header, message.data)
    }

    /// Completes the file; the description that stands beside it, whose name is `file`.
    pub(super) fn finish(mut self, file: &str) -> Result<String, mcap::McapError> {
        self.mcap.finish()?;
        let (first, last) = self.times.unwrap_or_default();
        let count: u64 = self.topics.iter().map(|told| u64::from(told.count)).sum();
        let duration = last - first;
        let mut text = format!(
            "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  duration:\n    \
             nanoseconds: {duration}\n  starting_time:\n    nanoseconds_since_epoch: {first}\n  \
             message_count: {count}\n  topics_with_message_count:\n"
        );
        for told in &self.topics {
            let quality = quality(told.latched).replace('\n', "\\n");
            let _ = write!(
                text,
                "    - topic_metadata:\n        name: {}\n        type: {}\n        \
                 serialization_format: cdr\n        offered_qos_profiles: \"{quality}\"\n      \
                 message_count: {}\n",
                told.name, told.message_type, told.count
            );
        }
        let _ = write!(
            text,
            "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - {file}\n  \
             files:\n    - path: {file}\n      starting_time:\n        nanoseconds_since_epoch: {first}\n      \
             duration:\n        nanoseconds: {duration}\n      message_count: {count}\n"
        );
        Ok(text)
    }
}
