//! The 58 bytes before every body.

use crate::error::{Reject, Unsendable};
use crate::stamp::Timestamp;
use crate::wire::{Fields, put_padded};

/// Size of a header \[bytes\].
pub const HEADER: usize = 58;
/// Room for the type's name \[bytes\].
const TYPE: usize = 12;
/// Room for the device's name \[bytes\].
const DEVICE: usize = 20;

/// What precedes a body.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Header version: 1 for protocol versions 1 and 2; from 2 on the body has an extended header.
    pub version: u16,
    /// Name of the type of message.
    pub kind: String,
    /// Name of the device, or of what the message is about.
    pub device: String,
    /// When the data were so.
    pub stamp: Timestamp,
    /// Size of the body \[bytes\].
    pub body_size: u64,
    /// Checksum of the body.
    pub crc: u64,
}

impl Header {
    /// Reads a header.
    ///
    /// # Errors
    /// Too few bytes, a version that is not known, or names that are no text.
    pub fn decode(bytes: &[u8]) -> Result<Self, Reject> {
        let mut fields = Fields::new(bytes);
        let version = fields.u16("header")?;
        if !(1..=3).contains(&version) {
            return Err(Reject::Version { found: version });
        }
        let kind = fields.bytes(TYPE, "header")?;
        let device = fields.bytes(DEVICE, "header")?;
        Ok(Self {
            version,
            // What is no text is no type that is known either: the message after it is.
            kind: String::from_utf8_lossy(trimmed(kind)).into_owned(),
            device: String::from_utf8_lossy(trimmed(device)).into_owned(),
            stamp: Timestamp(fields.u64("header")?),
            body_size: fields.u64("header")?,
            crc: fields.u64("header")?,
        })
    }

    pub(crate) fn encode(&self) -> Result<Vec<u8>, Unsendable> {
        let mut out = Vec::with_capacity(HEADER);
        out.extend_from_slice(&self.version.to_be_bytes());
        put_padded(&mut out, &self.kind, TYPE, "type")?;
        put_padded(&mut out, &self.device, DEVICE, "device name")?;
        for number in [self.stamp.0, self.body_size, self.crc] {
            out.extend_from_slice(&number.to_be_bytes());
        }
        Ok(out)
    }
}

/// What precedes the first zero byte.
fn trimmed(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().position(|&byte| byte == 0);
    &bytes[..end.unwrap_or(bytes.len())]
}
