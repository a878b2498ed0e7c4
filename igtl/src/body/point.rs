//! `POINT`.

use super::Colour;
use crate::error::{Reject, Unsendable};
use crate::wire::{Fields, put_floats, put_padded};

/// Room for a name, a group and an owner \[bytes\].
pub(super) const NAME: usize = 64;
pub(super) const GROUP: usize = 32;
pub(super) const OWNER: usize = 20;

/// A named point.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Point {
    /// Its name.
    pub name: String,
    /// What it belongs to: `Labeled Point`, `Fiducial`, ...
    pub group: String,
    /// How it is to be drawn.
    pub colour: Colour,
    /// Where it is \[mm\].
    pub place: [f32; 3],
    /// Its diameter \[mm\], or 0.
    pub diameter: f32,
    /// Name of the image that it belongs to.
    pub owner: String,
}

impl Point {
    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<(), Unsendable> {
        put_padded(out, &self.name, NAME, "name of a point")?;
        put_padded(out, &self.group, GROUP, "group of a point")?;
        out.extend_from_slice(&self.colour);
        put_floats(out, &self.place);
        put_floats(out, &[self.diameter]);
        put_padded(out, &self.owner, OWNER, "owner of a point")
    }

    pub(super) fn decode(fields: &mut Fields<'_>) -> Result<Self, Reject> {
        Ok(Self {
            name: fields.padded(NAME, "name of a point")?,
            group: fields.padded(GROUP, "group of a point")?,
            colour: colour(fields)?,
            place: fields.floats("place of a point")?,
            diameter: fields.f32("diameter of a point")?,
            owner: fields.padded(OWNER, "owner of a point")?,
        })
    }
}

pub(super) fn colour(fields: &mut Fields<'_>) -> Result<Colour, Reject> {
    Ok([
        fields.u8("colour")?,
        fields.u8("colour")?,
        fields.u8("colour")?,
        fields.u8("colour")?,
    ])
}
