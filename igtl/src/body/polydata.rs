//! `POLYDATA`.

use crate::error::{Reject, Unsendable};
use crate::wire::{Fields, count, put_floats, without_zero};

/// Longest name of an attribute \[bytes\].
const NAME: usize = 255;
/// Largest number that can be counted.
const MANY: usize = u32::MAX as usize;

/// Numbers that go with points or cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Attribute {
    /// What they are, by the protocol's code: 0 to 4 scalars, vectors, normals, tensors and RGBA of
    /// points, 16 to 20 the same of cells.
    pub kind: u8,
    /// Numbers a point or cell.
    pub components: u8,
    /// Name; at most 255 bytes.
    pub name: String,
    /// The numbers: `components` a point or cell.
    pub values: Vec<f32>,
}

/// Points, and cells made of their numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolyData {
    /// Where the points are \[mm\].
    pub points: Vec<[f32; 3]>,
    /// Groups of single points.
    pub vertices: Vec<Vec<u32>>,
    /// Polylines.
    pub lines: Vec<Vec<u32>>,
    /// Polygons.
    pub polygons: Vec<Vec<u32>>,
    /// Strips of triangles.
    pub strips: Vec<Vec<u32>>,
    /// What goes with points or cells.
    pub attributes: Vec<Attribute>,
}

impl PolyData {
    /// Polylines, each through points of its own; those of fewer than two points are left out.
    pub fn polylines<'a>(lines: impl IntoIterator<Item = &'a [[f32; 3]]>) -> Self {
        let mut data = Self::default();
        for line in lines {
            let first = u32::try_from(data.points.len()).unwrap_or(u32::MAX);
            let number = u32::try_from(line.len()).unwrap_or(0);
            if number > 1 {
                data.points.extend_from_slice(line);
                data.lines.push((first..first + number).collect());
            }
        }
        data
    }

    fn cells(&self) -> [&Vec<Vec<u32>>; 4] {
        [&self.vertices, &self.lines, &self.polygons, &self.strips]
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<(), Unsendable> {
        let mut put = |n: usize, field| -> Result<(), Unsendable> {
            out.extend_from_slice(&count::<u32>(n, MANY, field)?.to_be_bytes());
            Ok(())
        };
        put(self.points.len(), "points")?;
        for cells in self.cells() {
            put(cells.len(), "cells")?;
            let words: usize = cells.iter().map(|cell| 1 + cell.len()).sum();
            put(4 * words, "bytes of cells")?;
        }
        put(self.attributes.len(), "attributes")?;
        put_floats(out, self.points.as_flattened());
        for cell in self.cells().into_iter().flatten() {
            let number: u32 = count(cell.len(), MANY, "points of a cell")?;
            for word in std::iter::once(&number).chain(cell) {
                out.extend_from_slice(&word.to_be_bytes());
            }
        }
        self.encode_attributes(out)
    }

    fn encode_attributes(&self, out: &mut Vec<u8>) -> Result<(), Unsendable> {
        for attribute in &self.attributes {
            let components = usize::from(attribute.components).max(1);
            let number = attribute.values.len() / components;
            if attribute.values.len() != number * usize::from(attribute.components) {
                return Err(Unsendable::Disagree {
                    field: "values of an attribute",
                    found: attribute.values.len(),
                    expected: number * usize::from(attribute.components),
                });
            }
            out.extend_from_slice(&[attribute.kind, attribute.components]);
            let number: u32 = count(number, MANY, "values of an attribute")?;
            out.extend_from_slice(&number.to_be_bytes());
        }
        let mut names = 0;
        for Attribute { name, .. } in &self.attributes {
            without_zero(name, "name of an attribute")?;
            if name.len() > NAME {
                return Err(Unsendable::Long {
                    field: "name of an attribute",
                    bytes: name.len(),
                    limit: NAME,
                });
            }
            out.extend_from_slice(name.as_bytes());
            out.push(0);
            names += name.len() + 1;
        }
        if names % 2 == 1 {
            out.push(0);
        }
        for attribute in &self.attributes {
            put_floats(out, &attribute.values);
        }
        Ok(())
    }

    pub(super) fn decode(fields: &mut Fields<'_>) -> Result<Self, Reject> {
        let number = length(fields.u32("polydata")?)?;
        let mut sizes = [(0, 0); 4];
        for (cells, bytes) in &mut sizes {
            *cells = length(fields.u32("polydata")?)?;
            *bytes = length(fields.u32("polydata")?)?;
        }
        let attributes = length(fields.u32("polydata")?)?;
        let bytes = number
            .checked_mul(12)
            .ok_or(Reject::Truncated { field: "points" })?;
        let mut points = Fields::new(fields.bytes(bytes, "points")?);
        let mut data = Self {
            points: (0..number)
                .map(|_| points.floats("points"))
                .collect::<Result<_, _>>()?,
            ..Self::default()
        };
        let [vertices, lines, polygons, strips] = sizes;
        data.vertices = cells(fields, vertices, number)?;
        data.lines = cells(fields, lines, number)?;
        data.polygons = cells(fields, polygons, number)?;
        data.strips = cells(fields, strips, number)?;
        data.attributes = decode_attributes(fields, attributes)?;
        Ok(data)
    }
}

fn length(n: u32) -> Result<usize, Reject> {
    usize::try_from(n).map_err(|_| Reject::Truncated { field: "polydata" })
}

/// So many cells in so many bytes, of the numbers of `points` points.
fn cells(
    fields: &mut Fields<'_>,
    (number, bytes): (usize, usize),
    points: usize,
) -> Result<Vec<Vec<u32>>, Reject> {
    let mut fields = Fields::new(fields.bytes(bytes, "cells")?);
    let mut list = Vec::new();
    for _ in 0..number {
        let size = length(fields.u32("cells")?)?;
        if size > fields.remaining() / 4 {
            return Err(Reject::Truncated { field: "cells" });
        }
        let mut cell = Vec::with_capacity(size);
        for _ in 0..size {
            let index = fields.u32("cells")?;
            if length(index)? >= points {
                return Err(Reject::Value {
                    field: "number of a cell's point",
                    found: u64::from(index),
                });
            }
            cell.push(index);
        }
        list.push(cell);
    }
    fields.end()?;
    Ok(list)
}

fn decode_attributes(fields: &mut Fields<'_>, number: usize) -> Result<Vec<Attribute>, Reject> {
    const FIELD: &str = "attributes";
    let mut attributes = Vec::new();
    let mut sizes = Vec::new();
    for _ in 0..number {
        let (kind, components) = (fields.u8(FIELD)?, fields.u8(FIELD)?);
        sizes.push(length(fields.u32(FIELD)?)?);
        attributes.push(Attribute {
            kind,
            components,
            name: String::new(),
            values: Vec::new(),
        });
    }
    let before = fields.remaining();
    for attribute in &mut attributes {
        attribute.name = fields.terminated("name of an attribute")?;
    }
    if (before - fields.remaining()) % 2 == 1 {
        fields.u8("padding of names")?;
    }
    for (attribute, size) in attributes.iter_mut().zip(sizes) {
        let bytes = size
            .checked_mul(4 * usize::from(attribute.components))
            .ok_or(Reject::Truncated { field: FIELD })?;
        let mut values = Fields::new(fields.bytes(bytes, FIELD)?);
        while values.remaining() > 0 {
            attribute.values.push(values.f32(FIELD)?);
        }
    }
    Ok(attributes)
}
