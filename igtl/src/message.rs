//! A whole message.

use crate::body::Body;
use crate::crc::crc64;
use crate::error::{Reject, Unsendable};
use crate::header::{HEADER, Header};
use crate::stamp::Timestamp;
use crate::wire::{Fields, count, text};

/// Size of the extended header \[bytes\]; longer ones may come and are skipped.
const EXTENDED: u16 = 12;
/// Size of an entry of the metadata's index \[bytes\].
const ENTRY: usize = 8;

/// Most entries of the metadata, and bytes of a key, that can be counted.
const KEYS: usize = u16::MAX as usize;
/// Most bytes of metadata that can be counted.
const VALUES: usize = u32::MAX as usize;

/// A value of the metadata.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MetaValue {
    /// Its character set by IANA's number (MIBenum); 3 is US-ASCII, 106 UTF-8.
    pub encoding: u16,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// What header version 2 adds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Extension {
    /// Number of the message.
    pub id: u32,
    /// Keys and values.
    pub metadata: Vec<(String, MetaValue)>,
}

/// One message.
#[derive(Clone, Debug, PartialEq)]
pub struct Message {
    /// Name of the device, or of what the message is about; at most 20 bytes.
    pub device: String,
    /// When the data were so.
    pub stamp: Timestamp,
    /// Of header version 2; nothing in header version 1.
    pub extension: Option<Extension>,
    /// The content.
    pub body: Body,
}

impl Message {
    /// A message of header version 1 without a time.
    pub fn new(device: impl Into<String>, body: Body) -> Self {
        Self {
            device: device.into(),
            stamp: Timestamp::default(),
            extension: None,
            body,
        }
    }

    /// Its bytes: header, and body with checksum.
    ///
    /// # Errors
    /// See [`Unsendable`].
    pub fn encode(&self) -> Result<Vec<u8>, Unsendable> {
        let mut body = Vec::new();
        match &self.extension {
            None => self.body.encode(&mut body)?,
            Some(extension) => {
                let (index, values) = extension.encode()?;
                body.extend_from_slice(&EXTENDED.to_be_bytes());
                let size: u16 = count(index.len(), KEYS, "bytes of metadata")?;
                body.extend_from_slice(&size.to_be_bytes());
                let size: u32 = count(values.len(), VALUES, "bytes of metadata")?;
                body.extend_from_slice(&size.to_be_bytes());
                body.extend_from_slice(&extension.id.to_be_bytes());
                self.body.encode(&mut body)?;
                body.extend_from_slice(&index);
                body.extend_from_slice(&values);
            }
        }
        let header = Header {
            version: if self.extension.is_some() { 2 } else { 1 },
            kind: self.body.kind().to_owned(),
            device: self.device.clone(),
            stamp: self.stamp,
            body_size: body.len() as u64,
            crc: crc64(&body),
        };
        let mut out = header.encode()?;
        out.append(&mut body);
        Ok(out)
    }

    /// One message from exactly its bytes.
    ///
    /// # Errors
    /// See [`Reject`].
    pub fn decode(bytes: &[u8]) -> Result<Self, Reject> {
        let header = Header::decode(bytes)?;
        let body = bytes
            .get(HEADER..)
            .ok_or(Reject::Truncated { field: "header" })?;
        let size =
            usize::try_from(header.body_size).map_err(|_| Reject::Truncated { field: "body" })?;
        match body.len().checked_sub(size) {
            None => Err(Reject::Truncated { field: "body" }),
            Some(0) => Self::from_parts(&header, body),
            Some(bytes) => Err(Reject::Trailing { bytes }),
        }
    }

    /// The message of a header and the body that follows it.
    pub(crate) fn from_parts(header: &Header, body: &[u8]) -> Result<Self, Reject> {
        let expected = crc64(body);
        if expected != header.crc {
            return Err(Reject::Checksum {
                expected,
                found: header.crc,
            });
        }
        let (extension, content) = if header.version == 1 {
            (None, body)
        } else {
            let (extension, content) = Extension::split(body)?;
            (Some(extension), content)
        };
        Ok(Self {
            device: header.device.clone(),
            stamp: header.stamp,
            extension,
            body: Body::decode(&header.kind, content)?,
        })
    }
}

impl Extension {
    /// The metadata's index and its bytes.
    fn encode(&self) -> Result<(Vec<u8>, Vec<u8>), Unsendable> {
        if self.metadata.is_empty() {
            return Ok((0_u16.to_be_bytes().to_vec(), Vec::new()));
        }
        let number: u16 = count(self.metadata.len(), KEYS, "metadata")?;
        let (mut index, mut values) = (number.to_be_bytes().to_vec(), Vec::new());
        for (key, value) in &self.metadata {
            crate::wire::without_zero(key, "key of the metadata")?;
            let size: u16 = count(key.len(), KEYS, "bytes of a key of the metadata")?;
            index.extend_from_slice(&size.to_be_bytes());
            index.extend_from_slice(&value.encoding.to_be_bytes());
            let size: u32 = count(value.bytes.len(), VALUES, "bytes of metadata")?;
            index.extend_from_slice(&size.to_be_bytes());
            values.extend_from_slice(key.as_bytes());
            values.extend_from_slice(&value.bytes);
        }
        Ok((index, values))
    }

    /// A body's extended header and metadata, and the content between them.
    fn split(body: &[u8]) -> Result<(Self, &[u8]), Reject> {
        let mut fields = Fields::new(body);
        let size = fields.u16("extended header")?;
        let index = usize::from(fields.u16("extended header")?);
        let values = fields.u32("extended header")?;
        let id = fields.u32("extended header")?;
        if size < EXTENDED {
            return Err(Reject::Value {
                field: "size of the extended header",
                found: u64::from(size),
            });
        }
        fields.bytes(usize::from(size - EXTENDED), "extended header")?;
        let metadata = usize::try_from(values)
            .ok()
            .and_then(|values| values.checked_add(index));
        let content = metadata
            .and_then(|metadata| fields.remaining().checked_sub(metadata))
            .ok_or(Reject::Truncated { field: "metadata" })?;
        let content = fields.bytes(content, "content")?;
        let index = Fields::new(fields.bytes(index, "metadata")?);
        let metadata = read_metadata(index, fields)?;
        Ok((Self { id, metadata }, content))
    }
}

fn read_metadata(
    mut index: Fields<'_>,
    mut values: Fields<'_>,
) -> Result<Vec<(String, MetaValue)>, Reject> {
    const FIELD: &str = "metadata";
    if index.remaining() == 0 {
        values.end()?;
        return Ok(Vec::new());
    }
    let number = usize::from(index.u16(FIELD)?);
    if index.remaining() != number * ENTRY {
        return Err(Reject::Truncated { field: FIELD });
    }
    let mut metadata = Vec::with_capacity(number);
    for _ in 0..number {
        let key = usize::from(index.u16(FIELD)?);
        let encoding = index.u16(FIELD)?;
        let value = index.u32(FIELD)?;
        let key = text(values.bytes(key, FIELD)?, FIELD)?;
        let value = usize::try_from(value).map_err(|_| Reject::Truncated { field: FIELD })?;
        let bytes = values.bytes(value, FIELD)?.to_vec();
        metadata.push((key, MetaValue { encoding, bytes }));
    }
    values.end()?;
    Ok(metadata)
}
