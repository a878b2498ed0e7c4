//! Holds docs/EQUATIONS.md against the code, both ways.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::hazards::{is_test, sources};

fn workspace() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

pub(crate) fn rust_files(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            rust_files(&path, into);
        } else if path.extension().is_some_and(|e| e == "rs") {
            into.push(path);
        }
    }
}

/// Name of the item that a line declares, if it declares a function.
fn function_name(line: &str) -> Option<&str> {
    let rest = line.trim_start();
    let at = rest.find("fn ")?;
    let before = &rest[..at];
    let only_qualifiers = before
        .split_whitespace()
        .all(|word| ["const", "async", "unsafe"].contains(&word) || word.starts_with("pub"));
    let name = rest[at + 3..]
        .split(|c: char| !c.is_alphanumeric() && c != '_')
        .next()?;
    only_qualifiers.then_some(name)
}

/// Equation number to `crate::function`, from summary lines that end with `: Eq. (n).`.
fn equations_in_code() -> BTreeMap<u32, Vec<String>> {
    let mut found: BTreeMap<u32, Vec<String>> = BTreeMap::new();
    for member in ["needle-model", "hybrid-control"] {
        let mut files = Vec::new();
        rust_files(&workspace().join(member).join("src"), &mut files);
        for file in files {
            let text = std::fs::read_to_string(&file).unwrap();
            let mut pending: Option<u32> = None;
            for line in text.lines() {
                if let Some(doc) = line.trim_start().strip_prefix("///") {
                    if let Some(at) = doc.find(": Eq. (") {
                        let number = doc[at + 7..].split(')').next().unwrap();
                        pending = Some(number.parse().unwrap_or_else(|_| {
                            panic!("{}: bad equation number in `{line}`", file.display())
                        }));
                    }
                } else if let (Some(number), Some(name)) = (pending, function_name(line)) {
                    found
                        .entry(number)
                        .or_default()
                        .push(format!("{}::{name}", member.replace('-', "_")));
                    pending = None;
                }
            }
            assert!(
                pending.is_none(),
                "{}: equation without a function",
                file.display()
            );
        }
    }
    found
}

/// Rows `| (n) | `crate::function` | `test` | ... |` of the index.
fn equations_in_index() -> BTreeMap<u32, (String, String)> {
    let text = std::fs::read_to_string(workspace().join("docs/EQUATIONS.md")).unwrap();
    let mut rows = BTreeMap::new();
    for line in text.lines().filter(|line| line.starts_with("| (")) {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let number: u32 = cells[1].trim_matches(['(', ')']).parse().unwrap();
        let strip = |cell: &str| cell.trim_matches('`').to_owned();
        let before = rows.insert(number, (strip(cells[2]), strip(cells[3])));
        assert!(before.is_none(), "equation ({number}) has two rows");
    }
    rows
}

#[test]
fn every_equation_has_one_function_and_every_row_is_true() {
    let code = equations_in_code();
    let index = equations_in_index();
    for (number, functions) in &code {
        assert_eq!(functions.len(), 1, "equation ({number}) in {functions:?}");
        let row = index
            .get(number)
            .unwrap_or_else(|| panic!("equation ({number}) has no row"));
        assert_eq!(row.0, functions[0], "equation ({number})");
    }
    for (number, (function, _)) in &index {
        assert!(
            code.contains_key(number),
            "({number}): `{function}` is not in the code"
        );
    }
}

#[test]
fn every_test_of_the_index_exists() {
    for (number, (_, test)) in equations_in_index() {
        let (member, name) = test
            .split_once("::")
            .unwrap_or_else(|| panic!("({number}): `{test}` names no crate"));
        assert!(
            is_test(&sources(member), name),
            "({number}): no test `{name}` in {member}"
        );
    }
}
