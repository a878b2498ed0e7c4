//! The driver's decisions: a state machine fed with bytes, commands and time.

mod core;
mod course;
mod fault;
mod feedback;
mod link;
mod metrics;
mod orders;
mod session;
mod watch;

pub use self::core::{Core, SetupError, ToolLimits};
pub use fault::{Fault, LinkError, ProtocolError, Refused, Unfit};
pub use metrics::{Metrics, Percentiles};
