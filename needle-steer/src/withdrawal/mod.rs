//! The way out: the needle's base driven back along the path that it came.
//!
//! A withdrawal needs an arm that can move and nothing else: no image, no model, no law. It has
//! its own bounds (health of the arm, speed of the base, distance from the path, progress), clears
//! latched faults because whoever asks for it asks for that too, and never goes over into
//! steering.

mod conduct;
mod path;
mod rebuild;
mod record;
mod recording;
mod verdict;

pub use conduct::{Request, make_ready, told, withdraw};
pub use path::{BasePath, Lead, OffPath, Place};
pub use rebuild::{RebuildError, rebuild};
pub use record::Record;
pub use recording::{Recording, RecordingError};
pub use verdict::{Refusal, Stop, Summary, Verdict};
