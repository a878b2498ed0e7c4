//! Holds docs/HAZARDS.md against the tests: every hazard has one, and every test named exists.

use std::path::Path;

use crate::equations::rust_files;

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// All of a crate's code and tests.
fn sources(member: &str) -> String {
    let mut files = Vec::new();
    for folder in ["src", "tests"] {
        let folder = Path::new(ROOT).join(member).join(folder);
        if folder.is_dir() {
            rust_files(&folder, &mut files);
        }
    }
    files
        .iter()
        .map(|file| std::fs::read_to_string(file).unwrap())
        .collect()
}

/// Whether `text` holds the function `name` right below a `#[test]`, attributes between allowed.
fn is_test(text: &str, name: &str) -> bool {
    text.find(&format!("fn {name}(")).is_some_and(|at| {
        text[..at]
            .trim_end()
            .lines()
            .rev()
            .take_while(|line| line.trim_start().starts_with('#'))
            .any(|line| line.trim() == "#[test]")
    })
}

/// Rows of the tables: hazard and tests.
fn rows() -> Vec<(String, String)> {
    std::fs::read_to_string(Path::new(ROOT).join("docs/HAZARDS.md"))
        .unwrap()
        .lines()
        .filter(|line| line.starts_with("| ") && !line.starts_with("| Hazard"))
        .map(|line| {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            assert_eq!(cells.len(), 5, "{line}");
            (cells[1].to_owned(), cells[3].to_owned())
        })
        .collect()
}

#[test]
fn every_hazard_has_a_test_that_exists() {
    let contract = std::fs::read_to_string(Path::new(ROOT).join("tests/src/arm_contract.rs"));
    let contract = contract.unwrap();
    let mut named = 0;
    for (hazard, tests) in rows() {
        let mut found = 0;
        let mut member = String::new();
        for (i, code) in tests.split('`').enumerate() {
            if i % 2 == 0 {
                continue;
            }
            found += 1;
            if let Some(clause) = code.strip_prefix("contract: ") {
                let clause = format!("fn {clause}<H: Harness>(");
                assert!(contract.contains(&clause), "{hazard}: no clause `{code}`");
                continue;
            }
            let name = if let Some((of, name)) = code.split_once(": ") {
                of.clone_into(&mut member);
                name
            } else {
                code
            };
            assert!(
                is_test(&sources(&member), name),
                "{hazard}: no test `{name}` in {member}"
            );
        }
        assert!(found > 0, "{hazard}: no test");
        named += found;
    }
    assert!(named >= 24, "the tables were not read: {named}");
}
