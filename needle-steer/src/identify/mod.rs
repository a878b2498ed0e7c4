//! One's own needle: stiffness, tip-load scale and natural curvature from recorded insertions.
//!
//! [`recording`] reads logs and CSV files, [`fit`] identifies. Two independent models are used:
//! the rod on its cut path (stiffness, cut angle) and the paper's springs (tip-load scale).

mod column;
mod csv;
pub mod fit;
pub mod recording;
mod table;
mod text;
mod tip_load;

pub use fit::{Identified, IdentifyError, Parameter, identify};
pub use recording::{Recorder, Recording, RecordingError, Seen, Support};
pub use table::TableError;
