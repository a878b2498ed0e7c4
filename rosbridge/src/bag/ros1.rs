//! ROS 1 bags, format 2.0 (<http://wiki.ros.org/Bags/Format/2.0>), written from that description.

use std::io::{self, Seek, SeekFrom, Write};

use super::{Stamped, Topic};

const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
/// Bytes of the bag header's record, whatever it holds.
const HEADER: usize = 4096;
/// Size at which a chunk is closed \[bytes\].
const CHUNK: usize = 768 << 10;

/// Kinds of records.
mod op {
    pub(super) const MESSAGE: u8 = 2;
    pub(super) const BAG: u8 = 3;
    pub(super) const INDEX: u8 = 4;
    pub(super) const CHUNK: u8 = 5;
    pub(super) const CHUNK_INFO: u8 = 6;
    pub(super) const CONNECTION: u8 = 7;
}

/// A message's place in its chunk.
#[derive(Clone, Copy, Debug)]
struct Entry {
    connection: u32,
    nanos: u64,
    offset: u32,
}

/// A chunk that is written.
#[derive(Debug)]
struct Info {
    at: u64,
    first: u64,
    last: u64,
    counts: Vec<(u32, u32)>,
}

/// Writes a bag.
#[derive(Debug)]
pub(super) struct Bag<W> {
    sink: W,
    /// Bytes written.
    at: u64,
    connections: Vec<Vec<u8>>,
    chunk: Vec<u8>,
    entries: Vec<Entry>,
    infos: Vec<Info>,
}

impl<W: Write + Seek> Bag<W> {
    pub(super) fn new(mut sink: W) -> io::Result<Self> {
        sink.write_all(MAGIC)?;
        sink.write_all(&header(0, 0, 0))?;
        Ok(Self {
            sink,
            at: (MAGIC.len() + HEADER) as u64,
            connections: Vec::new(),
            chunk: Vec::new(),
            entries: Vec::new(),
            infos: Vec::new(),
        })
    }

    /// A topic; its number.
    pub(super) fn connect(&mut self, topic: &Topic<'_>) -> u32 {
        let number = u32::try_from(self.connections.len()).unwrap_or(u32::MAX);
        let mut data = Vec::new();
        field(&mut data, "topic", topic.name.as_bytes());
        field(&mut data, "type", topic.message_type.as_bytes());
        field(&mut data, "md5sum", topic.md5sum.as_bytes());
        field(&mut data, "message_definition", topic.definition.as_bytes());
        field(&mut data, "callerid", b"/needle_steer");
        if topic.latched {
            field(&mut data, "latching", b"1");
        }
        let mut head = operation(op::CONNECTION);
        field(&mut head, "conn", &number.to_le_bytes());
        field(&mut head, "topic", topic.name.as_bytes());
        let record = record(&head, &data);
        self.chunk.extend_from_slice(&record);
        self.connections.push(record);
        number
    }

    /// A message.
    pub(super) fn write(&mut self, connection: u32, message: &Stamped<'_>) -> io::Result<()> {
        let offset = u32::try_from(self.chunk.len()).unwrap_or(u32::MAX);
        self.entries.push(Entry {
            connection,
            nanos: message.nanos,
            offset,
        });
        let mut head = operation(op::MESSAGE);
        field(&mut head, "conn", &connection.to_le_bytes());
        field(&mut head, "time", &time(message.nanos));
        self.chunk.extend_from_slice(&record(&head, message.data));
        if self.chunk.len() >= CHUNK {
            self.close_chunk()?;
        }
        Ok(())
    }

    /// Writes what is left, and the index.
    pub(super) fn finish(mut self) -> io::Result<W> {
        self.close_chunk()?;
        let index = self.at;
        let mut tail = self.connections.concat();
        for info in &self.infos {
            let mut head = operation(op::CHUNK_INFO);
            field(&mut head, "ver", &1_u32.to_le_bytes());
            field(&mut head, "chunk_pos", &info.at.to_le_bytes());
            field(&mut head, "start_time", &time(info.first));
            field(&mut head, "end_time", &time(info.last));
            field(&mut head, "count", &length(info.counts.len()));
            let counts = info.counts.iter();
            let data: Vec<u8> = counts
                .flat_map(|(connection, count)| [connection.to_le_bytes(), count.to_le_bytes()])
                .flatten()
                .collect();
            tail.extend_from_slice(&record(&head, &data));
        }
        self.put(&tail)?;
        self.sink.seek(SeekFrom::Start(MAGIC.len() as u64))?;
        let (connections, chunks) = (self.connections.len(), self.infos.len());
        self.sink.write_all(&header(index, connections, chunks))?;
        self.sink.flush()?;
        Ok(self.sink)
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.at += bytes.len() as u64;
        self.sink.write_all(bytes)
    }

    fn close_chunk(&mut self) -> io::Result<()> {
        let entries = std::mem::take(&mut self.entries);
        let times = || entries.iter().map(|entry| entry.nanos);
        let (Some(first), Some(last)) = (times().min(), times().max()) else {
            return Ok(());
        };
        let chunk = std::mem::take(&mut self.chunk);
        let at = self.at;
        let mut head = operation(op::CHUNK);
        field(&mut head, "compression", b"none");
        field(&mut head, "size", &length(chunk.len()));
        self.put(&record(&head, &chunk))?;
        let mut counts = Vec::new();
        for connection in 0..u32::try_from(self.connections.len()).unwrap_or(u32::MAX) {
            let mut own: Vec<&Entry> = entries
                .iter()
                .filter(|entry| entry.connection == connection)
                .collect();
            if own.is_empty() {
                continue;
            }
            own.sort_by_key(|entry| entry.nanos);
            let mut head = operation(op::INDEX);
            field(&mut head, "ver", &1_u32.to_le_bytes());
            field(&mut head, "conn", &connection.to_le_bytes());
            field(&mut head, "count", &length(own.len()));
            let mut data = Vec::new();
            for entry in &own {
                data.extend_from_slice(&time(entry.nanos));
                data.extend_from_slice(&entry.offset.to_le_bytes());
            }
            self.put(&record(&head, &data))?;
            counts.push((connection, u32::try_from(own.len()).unwrap_or(u32::MAX)));
        }
        self.infos.push(Info {
            at,
            first,
            last,
            counts,
        });
        Ok(())
    }
}

/// The bag header, filled up with blanks.
fn header(index: u64, connections: usize, chunks: usize) -> Vec<u8> {
    let mut head = operation(op::BAG);
    field(&mut head, "index_pos", &index.to_le_bytes());
    field(&mut head, "conn_count", &length(connections));
    field(&mut head, "chunk_count", &length(chunks));
    let blanks = HEADER - head.len() - 8;
    record(&head, &b" ".repeat(blanks))
}

fn operation(code: u8) -> Vec<u8> {
    let mut head = Vec::new();
    field(&mut head, "op", &[code]);
    head
}

fn field(head: &mut Vec<u8>, name: &str, value: &[u8]) {
    head.extend_from_slice(&length(name.len() + 1 + value.len()));
    head.extend_from_slice(name.as_bytes());
    head.push(b'=');
    head.extend_from_slice(value);
}

fn record(head: &[u8], data: &[u8]) -> Vec<u8> {
    [&length(head.len()), head, &length(data.len()), data].concat()
}

fn length(length: usize) -> [u8; 4] {
    u32::try_from(length).unwrap_or(u32::MAX).to_le_bytes()
}

/// Seconds and nanoseconds.
fn time(nanos: u64) -> [u8; 8] {
    let (seconds, nanos) = super::seconds(nanos);
    let mut bytes = [0; 8];
    bytes[..4].copy_from_slice(&seconds.to_le_bytes());
    bytes[4..].copy_from_slice(&nanos.to_le_bytes());
    bytes
}
