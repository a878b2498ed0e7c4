//! Runs that are served to other programs: to pyigtl over OpenIGTLink, to a WebSocket client as a live
//! view, to a tracker, and to clients that mean no good.
#![expect(
    clippy::panic,
    clippy::unwrap_used,
    clippy::print_stderr,
    clippy::disallowed_methods,
    reason = "live processes and sockets: tests wait, a failed step is a failed test, and one that is \
              skipped says so"
)]

mod hostile;
mod peers;
mod tracker;
