//! `TRANSFORM` and `POSITION`.

use crate::error::Reject;
use crate::wire::{Fields, put_floats};

/// A transform that takes coordinates in the device's frame to the frame of who shares it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform {
    /// Axes of the device's frame: the columns of the rotation.
    pub axes: [[f32; 3]; 3],
    /// Its origin \[mm\].
    pub origin: [f32; 3],
}

impl Transform {
    /// Without a rotation.
    pub const fn at(origin: [f32; 3]) -> Self {
        Self {
            axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            origin,
        }
    }

    pub(super) fn encode(&self, out: &mut Vec<u8>) {
        put_floats(out, self.axes.as_flattened());
        put_floats(out, &self.origin);
    }

    pub(super) fn decode(fields: &mut Fields<'_>) -> Result<Self, Reject> {
        Ok(Self {
            axes: [
                fields.floats("rotation")?,
                fields.floats("rotation")?,
                fields.floats("rotation")?,
            ],
            origin: fields.floats("translation")?,
        })
    }
}

/// A place with an orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Position {
    /// The place \[mm\].
    pub origin: [f32; 3],
    /// The orientation, a quaternion x, y, z, w; no rotation where none was sent.
    pub orientation: [f32; 4],
}

impl Position {
    pub(super) fn encode(&self, out: &mut Vec<u8>) {
        put_floats(out, &self.origin);
        put_floats(out, &self.orientation);
    }

    /// Senders may leave out w, or the whole quaternion.
    pub(super) fn decode(fields: &mut Fields<'_>) -> Result<Self, Reject> {
        let origin = fields.floats("position")?;
        let orientation = match fields.remaining() {
            0 => [0.0, 0.0, 0.0, 1.0],
            12 => {
                let [x, y, z] = fields.floats("orientation")?;
                let w = (1.0 - (x * x + y * y + z * z)).max(0.0).sqrt();
                [x, y, z, w]
            }
            _ => fields.floats("orientation")?,
        };
        Ok(Self {
            origin,
            orientation,
        })
    }
}
