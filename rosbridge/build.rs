//! Points rosrust's message generator at the definitions in this crate, and away from any ROS
//! that happens to be installed.

use std::io::Write;

fn main() -> std::io::Result<()> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/msgs");
    let mut out = std::io::stdout().lock();
    writeln!(out, "cargo:rerun-if-changed={folder}")?;
    writeln!(out, "cargo:rustc-env=ROSRUST_MSG_PATH={folder}")?;
    writeln!(out, "cargo:rustc-env=CMAKE_PREFIX_PATH=/nonexistent")
}
