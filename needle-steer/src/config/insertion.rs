//! Who pushes the needle.

use serde::{Deserialize, Serialize};

/// Who pushes the needle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum InsertionBy {
    /// The arm, or an axis of the device.
    #[default]
    Axis,
    /// A hand, in steps, through a guide: the advance is measured, not commanded.
    Hand,
}

/// The advance along the needle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Insertion {
    /// Who pushes the needle.
    pub by: InsertionBy,
    /// Step that a hand is asked for \[mm\].
    pub step_mm: f64,
}

impl Default for Insertion {
    fn default() -> Self {
        Self {
            by: InsertionBy::Axis,
            step_mm: 5.0,
        }
    }
}
