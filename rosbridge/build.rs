//! Points rosrust's message generator at the definitions in this crate, and away from any ROS
//! that happens to be installed.

use std::io::Write;

fn main() -> std::io::Result<()> {
    // The messages of this project are a ROS package of their own, beside the launch files.
    let folders = ["msgs", "ros"].map(|name| format!("{}/{name}", env!("CARGO_MANIFEST_DIR")));
    let mut out = std::io::stdout().lock();
    for folder in &folders {
        writeln!(out, "cargo:rerun-if-changed={folder}")?;
    }
    writeln!(
        out,
        "cargo:rustc-env=ROSRUST_MSG_PATH={}",
        folders.join(":")
    )?;
    writeln!(out, "cargo:rustc-env=CMAKE_PREFIX_PATH=/nonexistent")
}
