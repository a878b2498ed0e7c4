//! Grey images and the contract of a stereo camera.

use std::sync::Arc;

use crate::{Error, Stamp};

/// Grey image, 8 bits, row-major without padding. Pixel centres have integer coordinates.
#[derive(Clone, PartialEq, Eq)]
pub struct GrayImage {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

/// Pixels that do not fill `width` x `height`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{pixels} pixels do not make an image of {width} x {height}")]
pub struct SizeMismatch {
    /// Width \[px\].
    pub width: usize,
    /// Height \[px\].
    pub height: usize,
    /// Number of pixels given.
    pub pixels: usize,
}

impl GrayImage {
    /// An image of one grey value.
    pub fn filled(width: usize, height: usize, value: u8) -> Self {
        Self {
            width,
            height,
            pixels: vec![value; width * height],
        }
    }

    /// Takes row-major pixels.
    ///
    /// # Errors
    /// The number of pixels is not `width * height`.
    pub fn from_pixels(width: usize, height: usize, pixels: Vec<u8>) -> Result<Self, SizeMismatch> {
        if width.checked_mul(height) == Some(pixels.len()) {
            Ok(Self {
                width,
                height,
                pixels,
            })
        } else {
            Err(SizeMismatch {
                width,
                height,
                pixels: pixels.len(),
            })
        }
    }

    /// Width \[px\].
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Height \[px\].
    pub const fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row-major.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// All pixels, row-major.
    pub fn pixels_mut(&mut self) -> &mut [u8] {
        &mut self.pixels
    }

    /// Grey values where this is a colour mosaic (Bayer): the weights 1 2 1 across and down hold each
    /// colour of a square of two by two in its share, whichever of them is in the middle. No place is
    /// shifted by it, and the order of the colours does not matter.
    #[must_use]
    pub fn demosaiced(&self) -> Self {
        // Mirrored at the border, so that the colours alternate there too.
        let around = |i: usize, n: usize| {
            let before = if i == 0 { 1.min(n - 1) } else { i - 1 };
            let after = if i + 1 == n {
                n.saturating_sub(2)
            } else {
                i + 1
            };
            [before, i, after]
        };
        let mut grey = Vec::with_capacity(self.pixels.len());
        for y in 0..self.height {
            let rows = around(y, self.height).map(|y| self.row(y));
            for x in 0..self.width {
                let columns = around(x, self.width);
                let mut sum = 0_u32;
                for (row, across) in rows.iter().zip([1, 2, 1]) {
                    for (column, along) in columns.iter().zip([1, 2, 1]) {
                        sum += across * along * u32::from(row[*column]);
                    }
                }
                grey.push(u8::try_from(sum >> 4).unwrap_or(u8::MAX));
            }
        }
        Self {
            width: self.width,
            height: self.height,
            pixels: grey,
        }
    }

    /// Pixels of row `y`.
    pub fn row(&self, y: usize) -> &[u8] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }
}

impl core::fmt::Debug for GrayImage {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "GrayImage {} x {}", self.width, self.height)
    }
}

/// One camera's image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraFrame {
    /// Middle of the exposure.
    pub stamp: Stamp,
    /// Counts the camera's exposures; a gap says that frames were dropped.
    pub sequence: u64,
    /// The image; shared so that logs and telemetry need no copy.
    pub image: Arc<GrayImage>,
}

/// Images of both cameras, taken together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StereoFrame {
    /// Left camera.
    pub left: CameraFrame,
    /// Right camera.
    pub right: CameraFrame,
}

/// A pair of synchronised cameras.
///
/// # Contract
/// `poll` never blocks; it returns the newest pair that was not yet returned, and skips older
/// ones. Stamps are of the exposure, on the rig's clock.
pub trait StereoCamera: Send {
    /// The newest pair, if there is a new one.
    ///
    /// # Errors
    /// The cameras are gone.
    fn poll(&mut self) -> Result<Option<StereoFrame>, Error>;

    /// Why no pairs come, in words, from cameras that know it: before the first pair, and when the
    /// newest is old. Cameras that say nothing are taken to be ready.
    fn hindrance(&self) -> Option<String> {
        None
    }
}
