//! Holds the code to rules that no compiler checks.

use std::path::PathBuf;

use crate::arrows::MEMBERS;
use crate::equations::rust_files;

fn sources() -> Vec<(PathBuf, String)> {
    files_under(&["src"])
}

fn files_under(folders: &[&str]) -> Vec<(PathBuf, String)> {
    let root = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let mut files = Vec::new();
    for member in MEMBERS.iter().filter(|member| **member != "tests") {
        for folder in folders.iter().map(|f| root.join(member).join(f)) {
            if folder.is_dir() {
                rust_files(&folder, &mut files);
            }
        }
    }
    files
        .into_iter()
        .map(|file| (file.clone(), std::fs::read_to_string(file).unwrap()))
        .collect()
}

/// Files that may switch the lint on unsafe code off, with the number of places.
const UNSAFE_EXCEPTIONS: [(&str, usize); 1] = [("rosbridge/src/seam/sockets.rs", 1)];

#[test]
fn unsafe_code_stands_only_where_it_is_named() {
    let mut found = Vec::new();
    for (file, text) in sources() {
        let places = text.lines().filter(|l| l.contains("(unsafe_code")).count();
        if places > 0 {
            found.push((file, places));
        }
    }
    let expected: Vec<_> = UNSAFE_EXCEPTIONS.iter().collect();
    assert_eq!(found.len(), expected.len(), "{found:?}");
    for (name, places) in expected {
        assert!(
            found
                .iter()
                .any(|(file, n)| file.ends_with(name) && n == places),
            "{name}: {found:?}"
        );
    }
}

#[test]
fn no_file_is_longer_than_500_lines() {
    for (file, text) in sources() {
        let lines = text.lines().count();
        assert!(
            lines <= 500,
            "{} has {lines} lines: split it",
            file.display()
        );
    }
}

#[test]
fn nothing_is_left_to_do_in_the_code() {
    for (file, text) in sources() {
        for word in ["todo!", "unimplemented!", "FIXME", "XXX"] {
            assert!(!text.contains(word), "{}: {word}", file.display());
        }
    }
}

#[test]
fn property_tests_draw_the_same_cases_in_every_run() {
    let mut blocks = 0;
    for (file, text) in files_under(&["src", "tests"]) {
        for block in text.split("proptest! {").skip(1) {
            blocks += 1;
            let config = block.trim_start().lines().next().unwrap_or_default();
            let seeded = config.contains("rng_seed") || config.contains("seeded()");
            assert!(seeded, "{}: a block without a seed", file.display());
        }
    }
    assert!(blocks > 10, "only {blocks} blocks found");
}

/// A package is made of its crate's folder alone.
#[test]
fn every_package_carries_both_licences() {
    let root = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    for licence in ["LICENSE-MIT", "LICENSE-APACHE"] {
        let whole = std::fs::read_to_string(root.join(licence)).unwrap();
        for member in MEMBERS.iter().filter(|member| **member != "tests") {
            let carried = std::fs::read_to_string(root.join(member).join(licence));
            assert_eq!(carried.ok().as_ref(), Some(&whole), "{member}: {licence}");
        }
    }
}

/// Crates that are of use without the application.
const LIBRARIES: usize = 9;
/// Lines of a README that are still read.
const README_LINES: usize = 45;

/// The examples of READMEs are doctests, and every library has an example that `cargo test` runs.
#[test]
fn every_library_has_a_front_door() {
    let root = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    for member in &MEMBERS[..LIBRARIES] {
        let read = |file: &str| {
            let path = root.join(member).join(file);
            std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
        };
        let readme = read("README.md");
        let lines = readme.lines().count();
        assert!(
            lines <= README_LINES,
            "{member}/README.md has {lines} lines"
        );
        assert!(readme.contains("```rust"), "{member}/README.md: no example");
        assert!(
            read("src/lib.rs").contains(r#"#[doc = include_str!("../README.md")]"#),
            "{member}: the example of its README is no doctest"
        );
        let manifest: toml::Table = read("Cargo.toml").parse().unwrap();
        let run: Vec<&str> = manifest["example"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|example| example.get("test").and_then(toml::Value::as_bool) == Some(true))
            .map(|example| example["name"].as_str().unwrap())
            .collect();
        assert!(!run.is_empty(), "{member}: no example is run");
        for name in run {
            assert!(
                readme.contains(name),
                "{member}/README.md: {name} is not named"
            );
            let example = read(&format!("examples/{name}.rs"));
            assert!(example.contains("#[test]"), "{member}: {name} is not run");
        }
    }
}
