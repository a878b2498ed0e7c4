//! Chunks of an MCAP file: decompression and the records inside.

use std::io::{self, Read};

use mcap::records::ChunkHeader;

use super::error::Damage;

/// Largest chunk \[bytes\]; keeps a damaged length from filling memory.
pub(super) const LIMIT: u64 = 256 << 20;
/// Opcode and length before each record.
const PREFIX: usize = 9;

/// The records of one chunk.
#[derive(Debug, Default)]
pub(super) struct Chunk {
    records: Vec<u8>,
    next: usize,
}

impl Chunk {
    /// Decompresses a chunk and checks it.
    pub(super) fn read(&mut self, header: &ChunkHeader, data: &[u8]) -> Result<(), Damage> {
        self.records.clear();
        self.next = 0;
        let size = header.uncompressed_size;
        if size > LIMIT {
            return Err(Damage::Size(size));
        }
        // One byte more than declared shows a chunk that is too long.
        let into = &mut self.records;
        match header.compression.as_str() {
            "" => data.take(size + 1).read_to_end(into),
            "lz4" => lz4_flex::frame::FrameDecoder::new(data)
                .take(size + 1)
                .read_to_end(into),
            "zstd" => zstd(data, size + 1, into),
            other => return Err(Damage::Compression(other.to_owned())),
        }
        .map_err(Damage::Compressed)?;
        if self.records.len() as u64 != size {
            return Err(Damage::Length {
                declared: size,
                found: self.records.len() as u64,
            });
        }
        let saved = header.uncompressed_crc;
        if saved != 0 && crc32fast::hash(&self.records) != saved {
            return Err(Damage::Checksum);
        }
        Ok(())
    }

    /// The next record: its opcode and its content; none at the end.
    pub(super) fn next(&mut self) -> Result<Option<(u8, &[u8])>, Damage> {
        let rest = self.records.get(self.next..).unwrap_or_default();
        if rest.is_empty() {
            return Ok(None);
        }
        let (prefix, content) = rest.split_at_checked(PREFIX).ok_or(Damage::Overrun)?;
        let mut length = [0; 8];
        length.copy_from_slice(&prefix[1..]);
        let length = usize::try_from(u64::from_le_bytes(length)).map_err(|_| Damage::Overrun)?;
        let content = content.get(..length).ok_or(Damage::Overrun)?;
        self.next += PREFIX + length;
        Ok(Some((prefix[0], content)))
    }
}

/// All frames of `data`, skippable ones left out.
fn zstd(mut data: &[u8], limit: u64, into: &mut Vec<u8>) -> io::Result<usize> {
    use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
    use ruzstd::decoding::{FrameDecoder, StreamingDecoder};

    let mut decoder = FrameDecoder::new();
    while !data.is_empty() && (into.len() as u64) < limit {
        match StreamingDecoder::new_with_decoder(&mut data, &mut decoder) {
            Ok(stream) => {
                let left = limit - into.len() as u64;
                stream.take(left).read_to_end(into)?;
            }
            Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame {
                length,
                ..
            })) => {
                let skipped = usize::try_from(length).unwrap_or(usize::MAX);
                data = data.get(skipped..).ok_or(io::ErrorKind::UnexpectedEof)?;
            }
            Err(error) => return Err(io::Error::other(error)),
        }
    }
    Ok(into.len())
}
