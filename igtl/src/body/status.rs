//! `STATUS`.

use crate::error::{Reject, Unsendable};
use crate::wire::{Fields, put_padded, text, without_zero};

/// Room for the error's name \[bytes\].
const NAME: usize = 20;

/// Codes of the protocol that a device of one's own needs; others stay numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StatusCode(pub u16);

impl StatusCode {
    /// All is well.
    pub const OK: Self = Self(1);
    /// Some error.
    pub const UNKNOWN_ERROR: Self = Self(2);
    /// What was asked for is not allowed.
    pub const ACCESS_DENIED: Self = Self(5);
    /// Busy with something else.
    pub const BUSY: Self = Self(6);
    /// An instruction that is not known.
    pub const UNKNOWN_INSTRUCTION: Self = Self(12);
    /// Not ready, or starting.
    pub const NOT_READY: Self = Self(13);
    /// Switched off, or holding still on request.
    pub const DISABLED: Self = Self(15);
    /// The hardware failed.
    pub const HARDWARE_FAILURE: Self = Self(18);
    /// Ending.
    pub const EXITING: Self = Self(19);
}

/// How the sender is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// What is the case.
    pub code: StatusCode,
    /// More about it, by the device's own numbers.
    pub sub_code: i64,
    /// A word for it; at most 20 bytes.
    pub name: String,
    /// It in words.
    pub text: String,
}

impl Status {
    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<(), Unsendable> {
        out.extend_from_slice(&self.code.0.to_be_bytes());
        out.extend_from_slice(&self.sub_code.to_be_bytes());
        put_padded(out, &self.name, NAME, "name of a status")?;
        without_zero(&self.text, "text of a status")?;
        out.extend_from_slice(self.text.as_bytes());
        // The reference library ends the text with a zero byte and takes one for granted.
        out.push(0);
        Ok(())
    }

    pub(super) fn decode(fields: &mut Fields<'_>) -> Result<Self, Reject> {
        Ok(Self {
            code: StatusCode(fields.u16("status")?),
            sub_code: fields.i64("status")?,
            name: fields.padded(NAME, "name of a status")?,
            text: {
                let bytes = fields.bytes(fields.remaining(), "text of a status")?;
                text(bytes, "text of a status")?
            },
        })
    }
}
