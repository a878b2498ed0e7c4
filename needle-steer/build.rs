//! The version with its commit, where the sources are a git checkout.

use std::process::Command;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    for file in ["HEAD", "logs/HEAD"] {
        if let Some(path) = git(&["rev-parse", "--git-path", file]) {
            println!("cargo:rerun-if-changed={path}");
        }
    }
    let package = env!("CARGO_PKG_VERSION");
    // A release unpacked inside a foreign repository has no commit of its own.
    let tracked = git(&["ls-files", "Cargo.toml"]);
    let version = match tracked.and_then(|_| git(&["rev-parse", "--short=10", "HEAD"])) {
        Some(commit) => format!("{package} ({commit})"),
        None => package.to_owned(),
    };
    println!("cargo:rustc-env=NEEDLE_STEER_VERSION={version}");
}

/// Output of a git command in the sources' own repository; nothing without git.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let text = text.trim();
    (output.status.success() && !text.is_empty()).then(|| text.to_owned())
}
