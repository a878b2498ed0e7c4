//! What recordings tell, by whichever of the two ways they allow.

use serde::Serialize;

use super::fit::{Identified, IdentifyError, identify};
use super::guided::{TipIdentified, identify_tip, is_for_tip};
use super::recording::Recording;
use crate::config::Config;

/// What recordings tell of a needle, of which the shaft was seen or the tip alone.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Findings {
    /// From the shaft, or from what the bevel did.
    Needle(Box<Identified>),
    /// From the tip's answers to motion of the base.
    Tip(Box<TipIdentified>),
}

impl Findings {
    /// Identifies what these recordings are fit for.
    ///
    /// # Errors
    /// See [`IdentifyError`].
    pub fn of(recordings: &[Recording]) -> Result<Self, IdentifyError> {
        Ok(if is_for_tip(recordings) {
            Self::Tip(Box::new(identify_tip(recordings)?))
        } else {
            Self::Needle(Box::new(identify(recordings)?))
        })
    }

    /// The configuration with what was identified: `given` where the user `named` one; else, from the
    /// shaft, that of the first of the `recordings`, as logs hold their own.
    pub fn apply(&self, given: &Config, named: bool, recordings: &[Recording]) -> Config {
        match self {
            Self::Tip(found) => found.apply(given),
            Self::Needle(found) => found.apply(match recordings.first() {
                Some(first) if !named => &first.config,
                _ => given,
            }),
        }
    }

    /// How many insertions and measurements were used.
    pub fn counts(&self) -> (usize, usize) {
        match self {
            Self::Needle(found) => (found.recordings, found.measurements),
            Self::Tip(found) => (found.recordings, found.measurements),
        }
    }
}
