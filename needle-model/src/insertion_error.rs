//! Errors of an insertion.

use thiserror::Error;

use crate::equilibrium_error::EquilibriumError;
use crate::needle::NeedleError;

/// Why an insertion step was refused or failed; the needle is then back where the step began.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum InsertionError {
    /// A setting out of range.
    #[error("insertion setting {name} out of range, got {value}")]
    Setting {
        /// Its name.
        name: &'static str,
        /// Offending value, in SI units.
        value: f64,
    },
    /// The base pose is not finite.
    #[error("the base pose is not finite")]
    BasePose,
    /// A step too long for an insertion.
    #[error("a step of {travel_m} m and {turn_rad} rad is too long")]
    Step {
        /// Way of the base \[m\].
        travel_m: f64,
        /// Turn of the base \[rad\].
        turn_rad: f64,
    },
    /// The measured tip is not finite.
    #[error("the measured tip is not finite")]
    MeasuredTip,
    /// The tip starts inside the tissue.
    #[error("the needle must start outside the tissue: its tip is {:.2} mm deep", depth_m * 1e3)]
    StartsInside {
        /// Depth of the tip \[m\].
        depth_m: f64,
    },
    /// A spring would be born or passed, but the place could not be found.
    #[error("no place found for an event of the insertion (last gap {gap_m} m)")]
    Event {
        /// Remaining gap \[m\].
        gap_m: f64,
    },
    /// A length of needle that is none.
    #[error(transparent)]
    Needle(#[from] NeedleError),
    /// No equilibrium.
    #[error(transparent)]
    Equilibrium(#[from] EquilibriumError),
}
