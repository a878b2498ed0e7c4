//! Frames out of a stream of bytes.

use super::{ByteOrder, Frame, HEADER, MAX_FRAME, WireError};

const LEAST: usize = HEADER - 4;
const MOST: usize = MAX_FRAME - 4;

/// Cuts a stream into frames, whatever the pieces in which it arrives. Its memory is one frame.
///
/// The first error is final: a stream that lost its frame cannot be trusted again.
#[derive(Clone, Debug)]
pub struct Decoder {
    order: ByteOrder,
    skip: usize,
    buffer: [u8; MAX_FRAME],
    filled: usize,
    failed: Option<WireError>,
}

impl Decoder {
    /// A decoder for a fresh stream that ignores the first `preamble` bytes.
    pub const fn new(order: ByteOrder, preamble: usize) -> Self {
        Self {
            order,
            skip: preamble,
            buffer: [0; MAX_FRAME],
            filled: 0,
            failed: None,
        }
    }

    /// Takes the next bytes of the stream and hands every completed frame to `sink`.
    ///
    /// # Errors
    /// The first [`WireError`] of this stream, now and at every later call.
    pub fn push(&mut self, bytes: &[u8], mut sink: impl FnMut(Frame)) -> Result<(), WireError> {
        if let Some(error) = self.failed {
            return Err(error);
        }
        let skipped = self.skip.min(bytes.len());
        self.skip -= skipped;
        let mut rest = &bytes[skipped..];
        while !rest.is_empty() {
            let wanted = if self.filled < 4 {
                4
            } else {
                self.frame_size()?
            };
            let taken = (wanted - self.filled).min(rest.len());
            self.buffer[self.filled..self.filled + taken].copy_from_slice(&rest[..taken]);
            self.filled += taken;
            rest = &rest[taken..];
            if self.filled < 4 {
                continue;
            }
            let size = self.frame_size()?;
            if self.filled == size {
                self.filled = 0;
                match Frame::decode(&self.buffer[4..size], self.order) {
                    Ok(frame) => sink(frame),
                    Err(error) => return Err(*self.failed.insert(error)),
                }
            }
        }
        Ok(())
    }

    /// Whether a frame has begun but not ended.
    pub const fn is_mid_frame(&self) -> bool {
        self.filled > 0
    }

    #[expect(clippy::cast_sign_loss, reason = "the error shows the bits")]
    fn frame_size(&mut self) -> Result<usize, WireError> {
        let [a, b, c, d, ..] = self.buffer;
        let plausible = |length: i32| {
            usize::try_from(length)
                .ok()
                .filter(|length| (LEAST..=MOST).contains(length))
        };
        let length = self.order.integer([a, b, c, d]);
        if let Some(length) = plausible(length) {
            return Ok(length + 4);
        }
        let swapped = self.order.swapped().integer([a, b, c, d]);
        let error = if plausible(swapped).is_some() {
            WireError::ByteOrder {
                found: length as u32,
                swapped: swapped as u32,
            }
        } else {
            WireError::Length {
                length,
                least: LEAST,
                most: MOST,
            }
        };
        Err(*self.failed.insert(error))
    }
}
