//! Images on disk: PNG, JPEG, PNM, BMP, TIFF, WebP; of 8 bits or more; grey or colour.

use std::fs;
use std::path::{Path, PathBuf};

use hal::GrayImage;
use image::{DynamicImage, ImageBuffer, Luma};

use super::FileError;

/// What the pixels of image files are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pixels {
    /// Grey, or colours of their own.
    #[default]
    Plain,
    /// One colour each, in squares of two by two (Bayer): what a colour camera's sensor gives.
    Mosaic,
}

/// Reads an image as grey values. Of more than eight bits, those that the image uses are scaled
/// to eight: a camera of ten or twelve writes them into files of sixteen.
///
/// # Errors
/// The file cannot be read or decoded.
pub fn read_image(path: &Path) -> Result<GrayImage, FileError> {
    read_image_of(path, Pixels::Plain)
}

/// [`read_image`] of a file whose pixels are `pixels`.
///
/// # Errors
/// The file cannot be read or decoded; it has colours where a mosaic is to be read.
pub fn read_image_of(path: &Path, pixels: Pixels) -> Result<GrayImage, FileError> {
    let bytes = fs::read(path).map_err(|source| FileError::Io {
        path: path.to_owned(),
        source,
    })?;
    let image = image::load_from_memory(&bytes).map_err(|source| FileError::Image {
        path: path.to_owned(),
        source,
    })?;
    if pixels == Pixels::Mosaic && image.color().has_color() {
        return Err(FileError::Foreign {
            path: path.to_owned(),
            what: "an image in colours, no raw mosaic of them".to_owned(),
            remedy: "read it without --bayer".to_owned(),
        });
    }
    let deep = matches!(
        image,
        DynamicImage::ImageLuma16(_)
            | DynamicImage::ImageLumaA16(_)
            | DynamicImage::ImageRgb16(_)
            | DynamicImage::ImageRgba16(_)
    );
    let image = if deep {
        eight_bits(&image.into_luma16())
    } else {
        image.into_luma8()
    };
    let (width, height) = (image.width() as usize, image.height() as usize);
    let mut grey = GrayImage::filled(width, height, 0);
    grey.pixels_mut().copy_from_slice(image.as_raw());
    Ok(match pixels {
        Pixels::Plain => grey,
        Pixels::Mosaic => grey.demosaiced(),
    })
}

/// Share of the pixels that may be brighter than the bits that count: hot pixels.
const HOT: f64 = 1e-4;

/// Scales by the number of bits that the image uses, at least eight.
fn eight_bits(image: &ImageBuffer<Luma<u16>, Vec<u16>>) -> ImageBuffer<Luma<u8>, Vec<u8>> {
    let mut bits = [0_u32; 17];
    for v in image.as_raw() {
        bits[(u16::BITS - v.leading_zeros()) as usize] += 1;
    }
    let allowed = HOT * f64::from(image.width()) * f64::from(image.height());
    let mut above = 0.0;
    let mut used = 16;
    while used > 8 {
        above += f64::from(bits[used]);
        if above > allowed {
            break;
        }
        used -= 1;
    }
    let shift = used - 8;
    ImageBuffer::from_fn(image.width(), image.height(), |x, y| {
        let v = image.get_pixel(x, y).0[0] >> shift;
        Luma([u8::try_from(v).unwrap_or(u8::MAX)])
    })
}

/// The size that all images have, from their headers alone \[px\]; zero without images.
///
/// # Errors
/// A file cannot be read, is no image, or differs in size from the first.
pub fn same_size<'a>(
    paths: impl IntoIterator<Item = &'a PathBuf>,
) -> Result<(usize, usize), FileError> {
    let mut first: Option<(&PathBuf, (usize, usize))> = None;
    for path in paths {
        let io = |source| FileError::Io {
            path: path.clone(),
            source,
        };
        let (width, height) = image::ImageReader::open(path)
            .and_then(image::ImageReader::with_guessed_format)
            .map_err(io)?
            .into_dimensions()
            .map_err(|source| FileError::Image {
                path: path.clone(),
                source,
            })?;
        let size = (width as usize, height as usize);
        match first {
            None => first = Some((path, size)),
            Some((_, (first_width, first_height))) if size == (first_width, first_height) => {}
            Some((first, (first_width, first_height))) => {
                return Err(FileError::MixedSizes {
                    path: path.clone(),
                    width: size.0,
                    height: size.1,
                    first: first.clone(),
                    first_width,
                    first_height,
                });
            }
        }
    }
    Ok(first.map_or((0, 0), |(_, size)| size))
}

/// Reads images that must all have the same size.
///
/// # Errors
/// As [`read_image_of`]; an image that differs in size from the first.
pub fn read_images(paths: &[PathBuf], pixels: Pixels) -> Result<Vec<GrayImage>, FileError> {
    let mut images: Vec<GrayImage> = Vec::with_capacity(paths.len());
    for path in paths {
        let image = read_image_of(path, pixels)?;
        if let (Some(first), Some(first_path)) = (images.first(), paths.first())
            && (first.width(), first.height()) != (image.width(), image.height())
        {
            return Err(FileError::MixedSizes {
                path: path.clone(),
                width: image.width(),
                height: image.height(),
                first: first_path.clone(),
                first_width: first.width(),
                first_height: first.height(),
            });
        }
        images.push(image);
    }
    Ok(images)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mosaic_of_a_coloured_scene_is_even_and_keeps_its_edges_places() {
        // A scene of one colour, dark from column 50 on: its mosaic is a chequered pattern.
        let colour = [200_u8, 120, 60];
        for order in [[0, 1, 1, 2], [2, 1, 1, 0], [1, 0, 2, 1], [1, 2, 0, 1]] {
            let image = ImageBuffer::from_fn(100, 40, |x, y| {
                let dimmed = if x < 50 { 1 } else { 4 };
                let which = order[((y % 2) * 2 + x % 2) as usize];
                Luma([colour[which] / dimmed])
            });
            let path = std::env::temp_dir().join(format!(
                "vision-mosaic-{}-{}{}.png",
                std::process::id(),
                order[0],
                order[1]
            ));
            image.save(&path).unwrap();
            let grey = read_image_of(&path, Pixels::Mosaic).unwrap();
            assert_ne!(read_image(&path).unwrap(), grey);
            fs::remove_file(&path).unwrap();
            for y in 0..40 {
                let row = grey.row(y);
                // (200 + 2 * 120 + 60) / 4.
                assert!(row[2..48].iter().all(|v| v.abs_diff(125) <= 1), "{row:?}");
                assert!(row[53..98].iter().all(|v| v.abs_diff(31) <= 1));
                let dark: f64 = row[40..60]
                    .iter()
                    .map(|v| (125.0 - f64::from(*v)) / 94.0)
                    .sum();
                assert!((dark - 10.0).abs() < 0.5, "{order:?} {y}: {dark}");
            }
        }
    }

    #[test]
    fn the_bits_that_an_image_uses_are_scaled_and_a_hot_pixel_does_not_count() {
        let mut image =
            ImageBuffer::from_fn(200, 100, |x, _| Luma([if x < 100 { 40 } else { 900 }]));
        image.put_pixel(3, 3, Luma([65_535]));
        let grey = eight_bits(&image);
        assert_eq!(grey.get_pixel(0, 0).0[0], 10);
        assert_eq!(grey.get_pixel(150, 0).0[0], 225);
        assert_eq!(grey.get_pixel(3, 3).0[0], 255);
        let full = ImageBuffer::from_fn(20, 10, |_, _| Luma([40_000]));
        assert_eq!(eight_bits(&full).get_pixel(0, 0).0[0], 156);
    }
}
