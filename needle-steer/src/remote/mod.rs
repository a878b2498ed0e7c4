//! Other programs that watch a run and ask something of it: what they have in common, OpenIGTLink,
//! and the live view over Foxglove's WebSocket protocol (feature `live`).
//!
//! A run knows an `Interface` only: it hands over snapshots and polls for requests, and neither
//! waits. ROS is one more of them (`ros::door`).
//!
//! **Architecture invariant:** nothing here runs on the run's thread but the hand-over of a
//! snapshot to a bounded queue and the poll of another.

pub mod address;
mod budget;
mod feed;
pub mod igtl;
#[cfg(feature = "live")]
pub mod live;
mod mailbox;

use std::sync::Arc;
use std::time::Instant;

use hal::request::Request;
use hal::{ArmState, Overlay, StereoFrame, Telemetry};
use rosbridge::Severity;

pub(crate) use budget::Budget;
pub(crate) use feed::{Due, Feed, FeedRates, Scene, Show};
pub(crate) use mailbox::{Mailbox, Post};

/// A way in which other programs watch a run and ask something of it.
pub(crate) trait Interface {
    /// Shows a snapshot from now on.
    fn show(&mut self, telemetry: &Arc<Telemetry>);

    /// Shows newer feedback of the arm than the last snapshot had.
    fn show_arm(&mut self, state: &ArmState);

    /// Shows a pair of images, and the left one with what was found in it.
    fn show_images(&mut self, pair: &StereoFrame, overlay: &Arc<Overlay>);

    /// What is asked next.
    fn poll(&mut self) -> Option<Request>;

    /// Says something to all who are told so much; whether that is on standard error, too.
    fn say(&mut self, severity: Severity, text: &str) -> bool;
}

/// Lets the run's thread go before the calling one, where the system can: on Linux a thread has a priority
/// of its own.
pub(crate) fn stand_back() {
    #[cfg(target_os = "linux")]
    {
        /// As `nice` does it: a tenth of the run's share where both want a processor.
        const NICE: i32 = 10;
        // Without it the thread works all the same.
        let _ = rustix::process::setpriority_process(None, NICE);
    }
}

/// The wall clock, for rates and deadlines of connections: no time of the run.
#[expect(
    clippy::disallowed_methods,
    reason = "rates and deadlines of connections are wall-clock time"
)]
fn now() -> Instant {
    Instant::now()
}
