//! The ROS side on a private master, with ROS's own tools as the judges.
//!
//! Needs Debian's ROS 1 packages (see `docs/ROS.md`). Without them the tests do nothing but say
//! so, unless `NEEDLE_STEER_REQUIRE_ROS` is set: then they fail.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::print_stderr,
    clippy::disallowed_methods,
    reason = "tests of live processes: they wait, tell what they skip, and fail by panicking"
)]

mod arm;
mod child;
#[expect(dead_code, reason = "shared with tests that use more of it")]
mod master;
mod robustness;
mod telemetry;
