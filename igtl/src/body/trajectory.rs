//! `TRAJ`.

use super::Colour;
use super::point::{GROUP, NAME, OWNER, colour};
use crate::error::{Reject, Unsendable};
use crate::wire::{Fields, put_floats, put_padded};

/// Which ends of a path are given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ends {
    /// Only where it begins.
    Entry,
    /// Only where it leads.
    Target,
    /// Both.
    #[default]
    Both,
}

impl Ends {
    const fn code(self) -> u8 {
        match self {
            Self::Entry => 1,
            Self::Target => 2,
            Self::Both => 3,
        }
    }

    fn from_code(code: u8) -> Result<Self, Reject> {
        match code {
            1 => Ok(Self::Entry),
            2 => Ok(Self::Target),
            3 => Ok(Self::Both),
            found => Err(Reject::Value {
                field: "type of a trajectory",
                found: u64::from(found),
            }),
        }
    }
}

/// A named straight path.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// Its name.
    pub name: String,
    /// What it belongs to: `Trajectory`, ...
    pub group: String,
    /// Which of its ends are given.
    pub ends: Ends,
    /// How it is to be drawn.
    pub colour: Colour,
    /// Where it begins \[mm\].
    pub entry: [f32; 3],
    /// Where it leads \[mm\].
    pub target: [f32; 3],
    /// Its diameter \[mm\], or 0.
    pub diameter: f32,
    /// Name of the image that it belongs to.
    pub owner: String,
}

impl Trajectory {
    pub(super) fn encode(&self, out: &mut Vec<u8>) -> Result<(), Unsendable> {
        put_padded(out, &self.name, NAME, "name of a trajectory")?;
        put_padded(out, &self.group, GROUP, "group of a trajectory")?;
        out.extend_from_slice(&[self.ends.code(), 0]);
        out.extend_from_slice(&self.colour);
        put_floats(out, &self.entry);
        put_floats(out, &self.target);
        put_floats(out, &[self.diameter]);
        put_padded(out, &self.owner, OWNER, "owner of a trajectory")
    }

    pub(super) fn decode(fields: &mut Fields<'_>) -> Result<Self, Reject> {
        let name = fields.padded(NAME, "name of a trajectory")?;
        let group = fields.padded(GROUP, "group of a trajectory")?;
        let ends = Ends::from_code(fields.u8("type of a trajectory")?)?;
        fields.u8("reserved byte of a trajectory")?;
        Ok(Self {
            name,
            group,
            ends,
            colour: colour(fields)?,
            entry: fields.floats("entry of a trajectory")?,
            target: fields.floats("target of a trajectory")?,
            diameter: fields.f32("diameter of a trajectory")?,
            owner: fields.padded(OWNER, "owner of a trajectory")?,
        })
    }
}
