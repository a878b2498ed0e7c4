//! `sensor_msgs/Image` in the encodings of common drivers, and `CompressedImage`, as a grey image
//! of 8 bits.

use hal::{CameraFrame, GrayImage};
use image::DynamicImage;

use crate::convert;
use crate::msg::sensor_msgs;

/// An image message that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImageRefused {
    /// The encoding is not known here.
    #[error("encoding {encoding:?}; taken are {}", names())]
    Encoding {
        /// As the message names it.
        encoding: String,
    },
    /// `step` is less than a row of pixels needs.
    #[error("step {step} for {width_px} px of {encoding}, which need {needed} bytes")]
    Step {
        /// Bytes from row to row.
        step: u32,
        /// Width \[px\].
        width_px: u32,
        /// The encoding.
        encoding: String,
        /// Bytes of a row of pixels.
        needed: usize,
    },
    /// Fewer bytes than the rows need.
    #[error("{bytes} bytes for {height_px} rows of {step} bytes")]
    Short {
        /// Bytes of pixels.
        bytes: usize,
        /// Height \[px\].
        height_px: u32,
        /// Bytes from row to row.
        step: u32,
    },
    /// A compressed image that does not decode.
    #[error("compressed image of format {format:?}: {why}")]
    Compressed {
        /// As the message names it.
        format: String,
        /// What the decoder says.
        why: String,
    },
}

/// How the bytes of a pixel make its grey value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Layout {
    /// One byte.
    Byte,
    /// Two bytes, of which cameras of 10 or 12 bits fill the lower ones.
    Word,
    /// `bytes` a pixel, red, green and blue at these of them.
    Colour { bytes: usize, rgb: [usize; 3] },
    /// One colour a pixel, in squares of two by two.
    Mosaic,
}

/// Names of `sensor_msgs/image_encodings.h`.
const ENCODINGS: [(&str, Layout); 14] = [
    ("mono8", Layout::Byte),
    ("8UC1", Layout::Byte),
    ("mono16", Layout::Word),
    ("16UC1", Layout::Word),
    ("rgb8", colour(3, [0, 1, 2])),
    ("bgr8", colour(3, [2, 1, 0])),
    ("8UC3", colour(3, [2, 1, 0])),
    ("rgba8", colour(4, [0, 1, 2])),
    ("bgra8", colour(4, [2, 1, 0])),
    ("8UC4", colour(4, [2, 1, 0])),
    ("bayer_rggb8", Layout::Mosaic),
    ("bayer_bggr8", Layout::Mosaic),
    ("bayer_gbrg8", Layout::Mosaic),
    ("bayer_grbg8", Layout::Mosaic),
];

/// Weights of red, green and blue in 1/256: ITU-R BT.601 luma, as `cv_bridge` converts.
const LUMA: [u32; 3] = [77, 150, 29];

const fn colour(bytes: usize, rgb: [usize; 3]) -> Layout {
    Layout::Colour { bytes, rgb }
}

fn names() -> String {
    ENCODINGS.map(|(name, _)| name).join(", ")
}

impl Layout {
    const fn bytes(self) -> usize {
        match self {
            Self::Byte | Self::Mosaic => 1,
            Self::Word => 2,
            Self::Colour { bytes, .. } => bytes,
        }
    }
}

/// Significant bits of a camera's 16-bit pixels, learnt from what it sends: 8 to 16, never fewer
/// than before, so that grey values keep their scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Depth(u32);

impl Default for Depth {
    fn default() -> Self {
        Self(u8::BITS)
    }
}

impl Depth {
    /// Grey values of 8 bits of these pixels.
    fn grey(&mut self, words: &[u16]) -> Vec<u8> {
        let brightest = words.iter().copied().max().unwrap_or_default();
        // 10, 12, 14 or 16 bits: cameras have no odd numbers of them.
        let bits = (u16::BITS - brightest.leading_zeros()).next_multiple_of(2);
        self.0 = self.0.max(bits);
        let shift = self.0 - u8::BITS;
        words
            .iter()
            .map(|word| u8::try_from(word >> shift).unwrap_or(u8::MAX))
            .collect()
    }
}

/// The image in grey.
///
/// # Errors
/// An unknown encoding, or bytes that do not make the image.
pub(crate) fn grey(
    message: sensor_msgs::Image,
    depth: &mut Depth,
) -> Result<CameraFrame, ImageRefused> {
    let layout = ENCODINGS
        .iter()
        .find(|(name, _)| *name == message.encoding)
        .map(|(_, layout)| *layout);
    let Some(layout) = layout else {
        return Err(ImageRefused::Encoding {
            encoding: message.encoding,
        });
    };
    let (width, height) = (message.width as usize, message.height as usize);
    let (step, needed) = (message.step as usize, width * layout.bytes());
    if step < needed {
        return Err(ImageRefused::Step {
            step: message.step,
            width_px: message.width,
            encoding: message.encoding,
            needed,
        });
    }
    // The last row may end without its padding.
    let least = step * height.saturating_sub(1) + if height > 0 { needed } else { 0 };
    let short = ImageRefused::Short {
        bytes: message.data.len(),
        height_px: message.height,
        step: message.step,
    };
    if message.data.len() < least {
        return Err(short);
    }
    let (stamp, sequence) = (
        convert::stamp(message.header.stamp),
        u64::from(message.header.seq),
    );
    let big = message.is_bigendian != 0;
    let bytes = if message.data.len() == needed * height {
        message.data
    } else {
        let rows = (0..height).flat_map(|y| &message.data[y * step..y * step + needed]);
        rows.copied().collect()
    };
    let pixels = match layout {
        Layout::Byte | Layout::Mosaic => bytes,
        Layout::Word => {
            let read = if big {
                u16::from_be_bytes
            } else {
                u16::from_le_bytes
            };
            let words: Vec<u16> = bytes.as_chunks().0.iter().map(|&pair| read(pair)).collect();
            depth.grey(&words)
        }
        Layout::Colour { bytes: each, rgb } => bytes
            .chunks_exact(each)
            .map(|pixel| luma(rgb.map(|at| pixel[at])))
            .collect(),
    };
    let image = GrayImage::from_pixels(width, height, pixels).map_err(|_| short)?;
    let image = if layout == Layout::Mosaic {
        image.demosaiced()
    } else {
        image
    };
    Ok(CameraFrame {
        stamp,
        sequence,
        image: image.into(),
    })
}

/// The compressed image in grey: JPEG or PNG, as `image_transport` publishes them.
///
/// # Errors
/// Data that do not decode.
pub(crate) fn decompressed(
    message: &sensor_msgs::CompressedImage,
    depth: &mut Depth,
) -> Result<CameraFrame, ImageRefused> {
    let refused = |why: String| ImageRefused::Compressed {
        format: message.format.clone(),
        why,
    };
    let decoded =
        image::load_from_memory(&message.data).map_err(|error| refused(error.to_string()))?;
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let pixels = match decoded {
        DynamicImage::ImageLuma8(grey) => grey.into_raw(),
        DynamicImage::ImageLuma16(words) => depth.grey(words.as_raw()),
        colour => {
            let rgb = colour.into_rgb8();
            rgb.pixels().map(|pixel| luma(pixel.0)).collect()
        }
    };
    Ok(CameraFrame {
        stamp: convert::stamp(message.header.stamp),
        sequence: u64::from(message.header.seq),
        image: GrayImage::from_pixels(width, height, pixels)
            .map_err(|error| refused(error.to_string()))?
            .into(),
    })
}

/// Grey value of red, green and blue.
fn luma(rgb: [u8; 3]) -> u8 {
    let sum: u32 = rgb.iter().zip(LUMA).map(|(&c, w)| u32::from(c) * w).sum();
    u8::try_from(sum >> u8::BITS).unwrap_or(u8::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A gradient of 5 x 3 px in an encoding; `pixel` gives the bytes for a grey value.
    fn message(
        encoding: &str,
        padding: usize,
        pixel: &dyn Fn(u8) -> Vec<u8>,
    ) -> sensor_msgs::Image {
        let mut data = Vec::new();
        let mut step = 0;
        for y in 0..3 {
            let row: Vec<u8> = (0..5).flat_map(|x| pixel(value(x, y))).collect();
            step = row.len() + padding;
            data.extend(row);
            data.extend(vec![7; padding]);
        }
        sensor_msgs::Image {
            width: 5,
            height: 3,
            step: u32::try_from(step).unwrap(),
            encoding: encoding.to_owned(),
            data,
            ..sensor_msgs::Image::default()
        }
    }

    fn value(x: u8, y: u8) -> u8 {
        16 * x + 64 * y
    }

    fn largest_difference(frame: &CameraFrame) -> u8 {
        (0..3)
            .flat_map(|y| (0..5).map(move |x| (x, y)))
            .map(|(x, y)| frame.image.row(usize::from(y))[usize::from(x)].abs_diff(value(x, y)))
            .max()
            .unwrap()
    }

    #[test]
    fn every_encoding_gives_the_same_grey_image_with_and_without_padding() {
        for (encoding, layout) in ENCODINGS {
            for padding in [0, 3] {
                // The order of two bytes: the lower first.
                let pixel = |v: u8| match layout {
                    Layout::Byte | Layout::Mosaic => vec![v],
                    Layout::Word => vec![v, v],
                    Layout::Colour { bytes, .. } => vec![v; bytes],
                };
                let image = message(encoding, padding, &pixel);
                let frame = grey(image, &mut Depth::default()).unwrap();
                // A mosaic's border sees its mirror image: half a step of the gradient.
                let tolerance = if layout == Layout::Mosaic { 40 } else { 1 };
                let worst = largest_difference(&frame);
                assert!(worst <= tolerance, "{encoding} + {padding}: {worst}");
            }
        }
    }

    #[test]
    fn red_green_and_blue_are_told_apart() {
        let red = |encoding: &str, pixel: [u8; 3]| {
            let image = message(encoding, 0, &|_| pixel.to_vec());
            grey(image, &mut Depth::default()).unwrap().image.pixels()[0]
        };
        assert_eq!(red("rgb8", [200, 0, 0]), 60, "0.299 of red");
        assert_eq!(red("bgr8", [0, 0, 200]), 60);
        assert_eq!(red("bgr8", [200, 0, 0]), 22, "0.114 of blue");
    }

    #[test]
    fn twelve_bits_in_sixteen_fill_the_grey_scale_and_keep_it() {
        let mut depth = Depth::default();
        let twelve = |v: u8| (u16::from(v) << 4).to_le_bytes().to_vec();
        let frame = grey(message("mono16", 0, &twelve), &mut depth).unwrap();
        assert_eq!(largest_difference(&frame), 0);
        // A darker image after it has the same scale.
        let dark = |v: u8| (u16::from(v) << 1).to_le_bytes().to_vec();
        let frame = grey(message("mono16", 0, &dark), &mut depth).unwrap();
        assert_eq!(frame.image.row(1)[4], value(4, 1) >> 3);
    }

    /// A gradient of 16 x 16 px, compressed.
    fn packed(format: image::ImageFormat, name: &str) -> sensor_msgs::CompressedImage {
        let gradient = image::GrayImage::from_fn(16, 16, |x, y| {
            image::Luma([u8::try_from(8 * x + 6 * y).unwrap()])
        });
        let mut data = std::io::Cursor::new(Vec::new());
        let picture = match format {
            image::ImageFormat::Png => DynamicImage::from(gradient),
            _ => DynamicImage::from(gradient).into_rgb8().into(),
        };
        picture.write_to(&mut data, format).unwrap();
        sensor_msgs::CompressedImage {
            format: name.to_owned(),
            data: data.into_inner(),
            ..sensor_msgs::CompressedImage::default()
        }
    }

    #[test]
    fn jpeg_and_png_decode_and_what_does_not_is_named() {
        for (format, name, tolerance) in [
            (image::ImageFormat::Png, "mono8; png compressed mono8", 0),
            // Of JPEG at its usual quality, on a smooth gradient.
            (image::ImageFormat::Jpeg, "bgr8; jpeg compressed bgr8", 4),
        ] {
            let mut message = packed(format, name);
            let frame = decompressed(&message, &mut Depth::default()).unwrap();
            for (x, y) in [(0, 0), (5, 9), (15, 15)] {
                let value = frame.image.row(y)[x];
                let wanted = u8::try_from(8 * x + 6 * y).unwrap();
                assert!(value.abs_diff(wanted) <= tolerance, "{name}: {value}");
            }
            message.data.truncate(20);
            let text = decompressed(&message, &mut Depth::default())
                .unwrap_err()
                .to_string();
            assert!(text.contains(name), "{text}");
        }
    }

    #[test]
    fn what_cannot_be_read_says_what_is_wrong() {
        let refused = |image| grey(image, &mut Depth::default()).unwrap_err().to_string();
        let text = refused(message("yuv422", 0, &|v| vec![v, v]));
        assert!(text.contains("yuv422") && text.contains("bgr8"), "{text}");
        let mut narrow = message("bgr8", 0, &|v| vec![v; 3]);
        narrow.step = 5;
        let text = refused(narrow);
        assert!(text.contains("step 5") && text.contains("15"), "{text}");
        let mut short = message("mono8", 0, &|v| vec![v]);
        short.data.truncate(9);
        let text = refused(short);
        assert!(text.contains("9 bytes"), "{text}");
    }
}
