//! `IMAGE`.

use crate::error::{Reject, Unsendable};
use crate::wire::{Fields, put_floats};

/// Version of the image's header.
const VERSION: u16 = 1;

/// What a pixel is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "named by their meaning")]
pub enum Scalar {
    Int8,
    Uint8,
    Int16,
    Uint16,
    Int32,
    Uint32,
    Float32,
    Float64,
}

impl Scalar {
    const ALL: [(Self, u8, usize); 8] = [
        (Self::Int8, 2, 1),
        (Self::Uint8, 3, 1),
        (Self::Int16, 4, 2),
        (Self::Uint16, 5, 2),
        (Self::Int32, 6, 4),
        (Self::Uint32, 7, 4),
        (Self::Float32, 10, 4),
        (Self::Float64, 11, 8),
    ];

    fn entry(self) -> (u8, usize) {
        let found = Self::ALL.iter().find(|(scalar, ..)| *scalar == self);
        found.map_or((3, 1), |&(_, code, size)| (code, size))
    }

    /// Its size \[bytes\].
    pub fn size(self) -> usize {
        self.entry().1
    }

    fn from_code(code: u8) -> Result<Self, Reject> {
        let found = Self::ALL.iter().find(|(_, known, _)| *known == code);
        found.map(|(scalar, ..)| *scalar).ok_or(Reject::Value {
            field: "scalar type of an image",
            found: u64::from(code),
        })
    }
}

/// Which way the axes of an image's frame point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coordinates {
    /// Right, anterior, superior.
    Ras,
    /// Left, posterior, superior.
    Lps,
}

/// A picture or a volume, sent whole or in part.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Scalars a pixel, interleaved.
    pub components: u8,
    /// What they are.
    pub scalar: Scalar,
    /// Whether their bytes come with the highest first.
    pub big_endian: bool,
    /// The frame of what follows.
    pub coordinates: Coordinates,
    /// Number of pixels in each direction.
    pub size: [u16; 3],
    /// From a pixel to the next in each direction \[mm\].
    pub steps: [[f32; 3]; 3],
    /// Centre of the image \[mm\].
    pub centre: [f32; 3],
    /// First pixel of the part that is sent.
    pub part_from: [u16; 3],
    /// Number of pixels of that part.
    pub part_size: [u16; 3],
    /// Its pixels, the first direction fastest.
    pub pixels: Vec<u8>,
}

impl Image {
    /// Number of bytes that the pixels take, if it can be counted.
    fn expected(&self) -> Option<usize> {
        self.part_size
            .iter()
            .map(|&n| usize::from(n))
            .chain([usize::from(self.components), self.scalar.size()])
            .try_fold(1, usize::checked_mul)
    }

    fn is_inside(&self) -> bool {
        let ends = self.part_from.iter().zip(&self.part_size);
        ends.zip(&self.size)
            .all(|((&from, &n), &size)| u32::from(from) + u32::from(n) <= u32::from(size))
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<(), Unsendable> {
        let expected = self.expected().unwrap_or(usize::MAX);
        if expected != self.pixels.len() {
            return Err(Unsendable::Disagree {
                field: "bytes of pixels",
                found: self.pixels.len(),
                expected,
            });
        }
        if !self.is_inside() {
            return Err(Unsendable::Disagree {
                field: "last pixel of the part",
                found: usize::from(self.part_size[0]),
                expected: usize::from(self.size[0]),
            });
        }
        out.extend_from_slice(&VERSION.to_be_bytes());
        let endian = if self.big_endian { 1 } else { 2 };
        let coordinates = match self.coordinates {
            Coordinates::Ras => 1,
            Coordinates::Lps => 2,
        };
        out.extend_from_slice(&[self.components, self.scalar.entry().0, endian, coordinates]);
        put_sizes(out, self.size);
        put_floats(out, self.steps.as_flattened());
        put_floats(out, &self.centre);
        put_sizes(out, self.part_from);
        put_sizes(out, self.part_size);
        out.extend_from_slice(&self.pixels);
        Ok(())
    }

    pub(super) fn decode(fields: &mut Fields<'_>) -> Result<Self, Reject> {
        let value = |field, found: u16| Reject::Value {
            field,
            found: u64::from(found),
        };
        let version = fields.u16("image")?;
        if version != VERSION {
            return Err(value("version of an image", version));
        }
        let components = fields.u8("image")?;
        let scalar = Scalar::from_code(fields.u8("image")?)?;
        let big_endian = match fields.u8("image")? {
            1 => true,
            2 => false,
            other => return Err(value("byte order of an image", other.into())),
        };
        let coordinates = match fields.u8("image")? {
            1 => Coordinates::Ras,
            2 => Coordinates::Lps,
            other => return Err(value("coordinates of an image", other.into())),
        };
        let mut image = Self {
            components,
            scalar,
            big_endian,
            coordinates,
            size: sizes(fields)?,
            steps: [
                fields.floats("image")?,
                fields.floats("image")?,
                fields.floats("image")?,
            ],
            centre: fields.floats("image")?,
            part_from: sizes(fields)?,
            part_size: sizes(fields)?,
            pixels: Vec::new(),
        };
        if !image.is_inside() {
            return Err(value("size of an image's part", image.part_size[0]));
        }
        let expected = image
            .expected()
            .ok_or(Reject::Truncated { field: "pixels" })?;
        image.pixels = fields.bytes(expected, "pixels")?.to_vec();
        Ok(image)
    }
}

fn put_sizes(out: &mut Vec<u8>, sizes: [u16; 3]) {
    for size in sizes {
        out.extend_from_slice(&size.to_be_bytes());
    }
}

fn sizes(fields: &mut Fields<'_>) -> Result<[u16; 3], Reject> {
    Ok([
        fields.u16("image")?,
        fields.u16("image")?,
        fields.u16("image")?,
    ])
}
