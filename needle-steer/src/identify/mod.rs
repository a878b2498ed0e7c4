//! One's own needle: stiffness, tip-load scale and natural curvature from recorded insertions.
//!
//! [`recording`] reads logs and tables, [`fit`] identifies from points of the shaft. Two independent
//! models are used there: the rod on its cut path (stiffness, cut angle) and the paper's springs
//! (tip-load scale). [`guided`] identifies from a tip sensor alone, with a beam on an elastic bed,
//! and [`validate`](mod@validate) holds its predictions against recorded steps.

mod bed;
mod column;
mod csv;
pub mod distortion;
mod findings;
pub mod fit;
pub mod guided;
pub mod recording;
mod response;
mod steps;
mod table;
mod text;
mod tip_load;
pub mod validate;

pub use findings::Findings;
pub use fit::{Identified, IdentifyError, Parameter, identify};
pub use guided::{Interval, TipIdentified, identify_tip, is_for_tip};
pub use recording::{Recorder, Recording, RecordingError, Seen, Support};
pub use steps::LeftOut;
pub use table::TableError;
pub use validate::{Validation, validate};
