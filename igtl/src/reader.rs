//! Messages out of a stream.

use crate::error::Reject;
use crate::header::{HEADER, Header};
use crate::message::Message;

/// Memory that is kept between two messages \[bytes\].
const KEPT: usize = 8 << 10;

/// Puts messages together from the pieces in which a stream delivers them. It holds at most one
/// message, and reserves nothing that has not come.
///
/// A header that makes no sense, or a wrong checksum, leaves no way to tell where the next message
/// begins: the reader is then [lost](Self::is_lost), takes nothing any more, and the connection is
/// to be closed.
#[derive(Debug)]
pub struct Reader {
    limit: usize,
    buffer: Vec<u8>,
    header: Option<Header>,
    lost: bool,
}

impl Reader {
    /// A reader of messages whose bodies have at most `limit` bytes.
    pub const fn new(limit: usize) -> Self {
        Self {
            limit,
            buffer: Vec::new(),
            header: None,
            lost: false,
        }
    }

    /// Takes bytes from the front of `bytes`: up to the end of a message, which is returned, or all.
    /// Call it until `bytes` is empty.
    pub fn push(&mut self, bytes: &mut &[u8]) -> Option<Result<Message, Reject>> {
        if self.lost {
            *bytes = &[];
            return None;
        }
        if self.header.is_none() {
            if !self.fill(bytes, HEADER) {
                return None;
            }
            match self.read_header() {
                Ok(header) => self.header = Some(header),
                Err(reject) => return Some(Err(self.give_up(reject, bytes))),
            }
        }
        let size = self.header.as_ref().map_or(0, |header| header.body_size);
        // Not larger than the limit, which is a `usize`.
        let size = usize::try_from(size).unwrap_or(self.limit);
        if !self.fill(bytes, HEADER + size) {
            return None;
        }
        let header = self.header.take()?;
        let message = Message::from_parts(&header, &self.buffer[HEADER..]);
        self.buffer.clear();
        self.buffer.shrink_to(KEPT);
        Some(message.map_err(|reject| {
            if reject.is_fatal() {
                self.give_up(reject, bytes)
            } else {
                reject
            }
        }))
    }

    /// Whether the beginning of the next message is unknown.
    pub const fn is_lost(&self) -> bool {
        self.lost
    }

    /// What the end of the stream says of a message that had begun.
    pub fn end(&self) -> Option<Reject> {
        let field = if self.header.is_some() {
            "body"
        } else {
            "header"
        };
        (!self.lost && !self.buffer.is_empty()).then_some(Reject::Truncated { field })
    }

    /// Memory in use \[bytes\].
    pub const fn memory(&self) -> usize {
        self.buffer.capacity()
    }

    /// Takes what is missing to `wanted` bytes; whether all are there.
    fn fill(&mut self, bytes: &mut &[u8], wanted: usize) -> bool {
        let missing = wanted.saturating_sub(self.buffer.len());
        let (taken, rest) = bytes.split_at(missing.min(bytes.len()));
        self.buffer.extend_from_slice(taken);
        *bytes = rest;
        self.buffer.len() >= wanted
    }

    fn read_header(&self) -> Result<Header, Reject> {
        let header = Header::decode(&self.buffer)?;
        if header.body_size > self.limit as u64 {
            return Err(Reject::Oversized {
                bytes: header.body_size,
                limit: self.limit,
            });
        }
        Ok(header)
    }

    fn give_up(&mut self, reject: Reject, bytes: &mut &[u8]) -> Reject {
        self.lost = true;
        self.header = None;
        self.buffer = Vec::new();
        *bytes = &[];
        reject
    }
}
