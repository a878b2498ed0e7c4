//! `STRING`.

use crate::error::{Reject, Unsendable};
use crate::wire::{Fields, count};

/// IANA's number (MIBenum) of US-ASCII.
pub const ASCII: u16 = 3;
/// IANA's number (MIBenum) of UTF-8.
pub const UTF_8: u16 = 106;

/// A text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Text {
    /// Its character set by IANA's number (MIBenum).
    pub encoding: u16,
    /// Its bytes; at most 65535.
    pub bytes: Vec<u8>,
}

impl Text {
    /// A text in ASCII where it is all that, else in UTF-8.
    pub fn new(text: &str) -> Self {
        Self {
            encoding: if text.is_ascii() { ASCII } else { UTF_8 },
            bytes: text.as_bytes().to_vec(),
        }
    }

    /// The text, where it is ASCII or UTF-8; what else it may be is not read.
    ///
    /// # Errors
    /// Another character set, or bytes that are none of it.
    pub fn text(&self) -> Result<&str, Reject> {
        const FIELD: &str = "string";
        if ![ASCII, UTF_8].contains(&self.encoding) {
            return Err(Reject::Value {
                field: "character set of a string",
                found: u64::from(self.encoding),
            });
        }
        std::str::from_utf8(&self.bytes).map_err(|_| Reject::Text { field: FIELD })
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<(), Unsendable> {
        const LONGEST: usize = u16::MAX as usize;
        let size: u16 = count(self.bytes.len(), LONGEST, "bytes of a string")?;
        out.extend_from_slice(&self.encoding.to_be_bytes());
        out.extend_from_slice(&size.to_be_bytes());
        out.extend_from_slice(&self.bytes);
        Ok(())
    }

    pub(super) fn decode(fields: &mut Fields<'_>) -> Result<Self, Reject> {
        let encoding = fields.u16("string")?;
        let size = usize::from(fields.u16("string")?);
        Ok(Self {
            encoding,
            bytes: fields.bytes(size, "string")?.to_vec(),
        })
    }
}
