//! A topic's ends.

use std::collections::HashMap;
use std::convert::Infallible;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Wake, Waker};
use std::thread::{JoinHandle, Thread};
use std::time::Duration;

use rustdds::bytes::Bytes;
use rustdds::no_key::{
    DataWriter, Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter, SimpleDataReader,
};
use rustdds::rpc::SampleIdentity;
use rustdds::{
    DataWriterStatus, GUID, RTPSEntity, RepresentationIdentifier, SequenceNumber, StatusEvented,
    WriteOptions, WriteOptionsBuilder,
};

use crate::graph::Guid;
use crate::participant::{Participant, WireError};

/// Longest sleep of a reader's thread; messages wake it.
const SLEEP: Duration = Duration::from_millis(500);
/// How often the reader of a client whose request has come is looked for: a second in all, ...
const MOST_LOOKS: u32 = 500;
/// ... and after how long again.
const LOOK_AGAIN: Duration = Duration::from_millis(2);
/// Most writers whose names a reader remembers.
const MOST_NAMES: usize = 256;

/// A sample's bytes: CDR, little endian, without what precedes it.
pub(crate) struct Raw(pub(crate) Bytes);

/// Leaves bytes as they are.
pub(crate) struct Unchanged;

impl SerializerAdapter<Raw> for Unchanged {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(value: &Raw) -> Result<Bytes, Infallible> {
        Ok(value.0.clone())
    }
}

impl DeserializerAdapter<Raw> for Unchanged {
    type Error = Infallible;
    type Decoded = Raw;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE]
    }

    fn transform_decoded(decoded: Raw) -> Raw {
        decoded
    }
}

impl DefaultDecoder<Raw> for Unchanged {
    type Decoder = Copies;
    const DECODER: Copies = Copies;
}

/// Copies a sample's bytes.
#[derive(Clone)]
pub(crate) struct Copies;

impl Decode<'_, Raw> for Copies {
    type Error = Infallible;

    fn decode_bytes(self, bytes: &[u8], _: RepresentationIdentifier) -> Result<Raw, Infallible> {
        Ok(Raw(Bytes::copy_from_slice(bytes)))
    }
}

pub(crate) type RawWriter = DataWriter<Raw, Unchanged>;
pub(crate) type RawReader = SimpleDataReader<Raw, Unchanged>;

/// A message as it came.
#[derive(Clone, Copy, Debug)]
pub struct Sample<'a> {
    /// The message in CDR, little endian.
    pub payload: &'a [u8],
    /// The node that sent it; another node of the same name is told apart.
    pub from: &'a str,
}

/// Writes to a topic until it is dropped; never waits.
pub struct Writer {
    participant: Participant,
    outlet: Arc<Outlet>,
    guid: Guid,
}

/// A writer, and who reads it.
pub(crate) struct Outlet {
    dds: Mutex<RawWriter>,
    readers: AtomicI32,
    read_by: Mutex<Vec<GUID>>,
}

impl Outlet {
    /// Takes in what DDS has said of readers; it keeps but a few such notes, so they are looked at now
    /// and then.
    pub(crate) fn count_readers(&self) -> usize {
        let writer = self.dds.lock().unwrap_or_else(PoisonError::into_inner);
        let mut read_by = self.read_by.lock().unwrap_or_else(PoisonError::into_inner);
        while let Some(status) = writer.try_recv_status() {
            if let DataWriterStatus::PublicationMatched {
                current, reader, ..
            } = status
            {
                self.readers.store(current.count(), Ordering::Relaxed);
                read_by.retain(|other| *other != reader);
                if current.count_change() > 0 {
                    read_by.push(reader);
                }
            }
        }
        usize::try_from(self.readers.load(Ordering::Relaxed)).unwrap_or(0)
    }

    /// Whether anything of the participant that has `endpoint` reads.
    fn is_read_by(&self, endpoint: GUID) -> bool {
        self.count_readers();
        let read_by = self.read_by.lock().unwrap_or_else(PoisonError::into_inner);
        read_by
            .iter()
            .any(|reader| reader.prefix == endpoint.prefix)
    }
}

impl Writer {
    pub(crate) fn new(participant: Participant, writer: RawWriter) -> Self {
        let guid = writer.guid().to_bytes();
        participant.tell(|own| own.writers.push(guid));
        let outlet = Arc::new(Outlet {
            dds: Mutex::new(writer),
            readers: AtomicI32::new(0),
            read_by: Mutex::default(),
        });
        participant.keep_count(&outlet);
        Self {
            participant,
            outlet,
            guid,
        }
    }

    /// Hands a message in CDR, little endian, over; whether there was room for it.
    pub fn send(&self, payload: Vec<u8>) -> bool {
        self.send_with(payload, WriteOptions::default())
    }

    /// As an answer to a request that `asker` wrote. A client's two ends are discovered one after the
    /// other, and what is written before its reader is known never reaches it: that is waited for.
    pub(crate) fn answer(&self, payload: Vec<u8>, to: SampleIdentity, asker: GUID) -> bool {
        for _ in 0..MOST_LOOKS {
            if self.outlet.is_read_by(asker) {
                break;
            }
            // A message that comes meanwhile wakes the thread sooner.
            std::thread::park_timeout(LOOK_AGAIN);
        }
        let options = WriteOptionsBuilder::new().related_sample_identity(to);
        self.send_with(payload, options.build())
    }

    fn send_with(&self, payload: Vec<u8>, options: WriteOptions) -> bool {
        let writer = self.outlet.dds.lock();
        let writer = writer.unwrap_or_else(PoisonError::into_inner);
        let raw = Raw(Bytes::from(payload));
        writer.write_with_options(raw, options).is_ok()
    }

    /// Number of readers.
    pub fn readers(&self) -> usize {
        self.outlet.count_readers()
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        let guid = self.guid;
        self.participant
            .tell(|own| own.writers.retain(|writer| *writer != guid));
    }
}

impl std::fmt::Debug for Writer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Writer").finish_non_exhaustive()
    }
}

/// A sample with what services need to know of it.
pub(crate) struct Arrived {
    pub(crate) payload: Bytes,
    pub(crate) writer: GUID,
    pub(crate) number: SequenceNumber,
    pub(crate) related: Option<SampleIdentity>,
}

/// Reads a topic on a thread of its own until it is dropped.
pub struct Reader {
    participant: Participant,
    guid: Guid,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Wakes a thread that is parked.
struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }
}

impl Reader {
    /// Calls `handler` with every message, on the reader's thread.
    pub(crate) fn start(
        participant: Participant,
        reader: RawReader,
        name: &str,
        mut handler: impl FnMut(Arrived) + Send + 'static,
    ) -> Result<Self, WireError> {
        let guid = reader.guid().to_bytes();
        let ended = Arc::new(AtomicBool::new(false));
        let (told, counted) = (Arc::clone(&ended), participant.downgrade());
        let thread = std::thread::Builder::new()
            .name(format!("ros2 {name}"))
            .spawn(move || {
                let waker = Waker::from(Arc::new(Unpark(std::thread::current())));
                while !told.load(Ordering::Acquire) {
                    // Before looking: what comes later wakes the thread.
                    reader.set_waker(Some(waker.clone()));
                    reader.drain_read_notifications();
                    loop {
                        match reader.try_take_one() {
                            Ok(Some(sample)) => handler(Arrived {
                                writer: sample.writer_guid(),
                                number: sample.sequence_number,
                                related: sample.related_sample_identity(),
                                payload: sample.into_value().0,
                            }),
                            // Bytes in another encoding; the next ones may be readable.
                            Err(rustdds::dds::ReadError::Deserialization { .. }) => {}
                            Ok(None) | Err(_) => break,
                        }
                        if told.load(Ordering::Acquire) {
                            return;
                        }
                    }
                    counted.count_readers();
                    std::thread::park_timeout(SLEEP);
                }
            })
            .map_err(WireError::Thread)?;
        participant.tell(|own| own.readers.push(guid));
        Ok(Self {
            participant,
            guid,
            ended,
            thread: Some(thread),
        })
    }

    /// As [`start`](Self::start), with the sender's name.
    pub(crate) fn named(
        participant: Participant,
        reader: RawReader,
        name: &str,
        handler: impl Fn(Sample<'_>) + Send + 'static,
    ) -> Result<Self, WireError> {
        let asked = participant.downgrade();
        // A sender keeps the name under which it was first heard.
        let mut names: HashMap<Guid, String> = HashMap::new();
        Self::start(participant, reader, name, move |arrived| {
            let writer = arrived.writer.to_bytes();
            if names.len() >= MOST_NAMES {
                names.clear();
            }
            let from = names
                .entry(writer)
                .or_insert_with(|| asked.name_of(&writer).unwrap_or_default());
            handler(Sample {
                payload: &arrived.payload,
                from,
            });
        })
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Release);
        let guid = self.guid;
        self.participant
            .tell(|own| own.readers.retain(|reader| *reader != guid));
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // The handler may be what drops its own reader.
            if thread.thread().id() != std::thread::current().id() {
                // A panic has been reported where it happened.
                let _ = thread.join();
            }
        }
    }
}

impl std::fmt::Debug for Reader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Reader").finish_non_exhaustive()
    }
}
