//! The records of an MCAP file one after the other, those inside chunks included.

use std::io::{self, Read};

use mcap::McapError;
use mcap::records::{Record as Raw, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::chunk::{self, Chunk};
use super::error::{Damage, ReadError};
use super::kind::{self, FileKind};

/// Most that is read at once \[bytes\]: a damaged length asks for all memory.
const READ: usize = 1 << 20;
/// The magic bytes before the first record, opcode and length before each \[bytes\].
const MAGIC: u64 = 8;
const PREFIX: u64 = 9;

/// Reads records; a file that breaks off ends there.
pub(super) struct Records<R: Read> {
    source: R,
    mcap: LinearReader,
    /// Offset of the next record of the file, and of the one being read.
    next: u64,
    at: u64,
    chunk: Chunk,
    complete: bool,
    ended: bool,
}

impl<R: Read> Records<R> {
    /// Starts to read.
    pub(super) fn new(mut source: R) -> Result<Self, ReadError> {
        let mut head = Vec::new();
        source
            .by_ref()
            .take(kind::HEAD as u64)
            .read_to_end(&mut head)
            .map_err(|source| ReadError::Source { at: 0, source })?;
        match FileKind::of(&head) {
            FileKind::Mcap => {}
            other => return Err(ReadError::Foreign(other)),
        }
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_emit_chunks(true)
            .with_record_length_limit(usize::try_from(chunk::LIMIT).unwrap_or(usize::MAX));
        let mut mcap = LinearReader::new_with_options(options);
        mcap.insert(head.len()).copy_from_slice(&head);
        mcap.notify_read(head.len());
        Ok(Self {
            source,
            mcap,
            next: MAGIC,
            at: 0,
            chunk: Chunk::default(),
            complete: false,
            ended: false,
        })
    }

    /// Whether the end of the file was reached and the file was completed there.
    pub(super) const fn is_complete(&self) -> bool {
        self.complete
    }

    /// Reads nothing any more.
    pub(super) const fn end(&mut self) {
        self.ended = true;
    }

    /// Hands the next record to `take`: the offset at which it is, or its chunk, its opcode and its
    /// content. Nothing at the end.
    pub(super) fn next<T>(
        &mut self,
        take: impl FnOnce(u64, u8, &[u8]) -> Result<T, ReadError>,
    ) -> Result<Option<T>, ReadError> {
        while !self.ended {
            if let Some((opcode, data)) = self.chunk.next().map_err(damaged(self.at))? {
                return take(self.at, opcode, data).map(Some);
            }
            let at = self.next;
            let need = match self.mcap.next_event() {
                None | Some(Err(McapError::UnexpectedEof)) => break,
                Some(Err(error)) => return Err(damaged(at)(Damage::Record(error))),
                Some(Ok(LinearReadEvent::ReadRequest(need))) => need,
                Some(Ok(LinearReadEvent::Record { data, opcode })) => {
                    self.at = at;
                    self.next += PREFIX + data.len() as u64;
                    match opcode {
                        op::FOOTER => {
                            self.complete = true;
                            break;
                        }
                        op::CHUNK => {
                            let parsed = mcap::parse_record(opcode, data)
                                .map_err(|e| damaged(at)(Damage::Record(e)))?;
                            if let Raw::Chunk { header, data } = parsed {
                                self.chunk.read(&header, &data).map_err(damaged(at))?;
                            }
                            continue;
                        }
                        _ => return take(at, opcode, data).map(Some),
                    }
                }
            };
            let read = loop {
                match self.source.read(self.mcap.insert(need.min(READ))) {
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                    read => break read.map_err(|source| ReadError::Source { at, source })?,
                }
            };
            self.mcap.notify_read(read);
        }
        self.ended = true;
        Ok(None)
    }
}

fn damaged(at: u64) -> impl Fn(Damage) -> ReadError {
    move |damage| match damage {
        Damage::Compression(name) => ReadError::Compression { at, name },
        damage => ReadError::Damaged { at, damage },
    }
}
