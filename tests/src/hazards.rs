//! Holds docs/HAZARDS.md against the code: what a row cites is called by the product, and the
//! tests it names exist.

use std::path::Path;

use crate::equations::rust_files;

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
/// What a row may name as back ends.
const BACK_ENDS: [&str; 3] = ["sim", "viper", "ros"];

/// One row of the tables.
struct Row {
    hazard: String,
    symbols: Vec<String>,
    callers: Vec<String>,
    back_ends: String,
    tests: Vec<String>,
}

fn read(file: &str) -> Option<String> {
    std::fs::read_to_string(Path::new(ROOT).join(file)).ok()
}

/// What stands in backquotes.
fn codes(cell: &str) -> Vec<String> {
    let parts = cell.split('`').skip(1).step_by(2);
    parts.map(str::to_owned).collect()
}

fn rows() -> Vec<Row> {
    read("docs/HAZARDS.md")
        .unwrap()
        .lines()
        .filter(|line| line.starts_with("| ") && !line.starts_with("| Hazard"))
        .map(|line| {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            assert_eq!(cells.len(), 8, "six columns: {line}");
            Row {
                hazard: cells[1].to_owned(),
                symbols: codes(cells[3]),
                callers: codes(cells[4]),
                back_ends: cells[5].to_owned(),
                // A word in brackets is a remark on a test.
                tests: codes(cells[6].split(" (").next().unwrap_or_default())
                    .into_iter()
                    .chain(cells[6].split(") ").skip(1).flat_map(codes))
                    .collect(),
            }
        })
        .collect()
}

/// All of a crate's code and tests.
pub(crate) fn sources(member: &str) -> String {
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

/// Code of the product: no tests, no comments, no imports.
fn product(text: &str) -> String {
    let code = text.split("#[cfg(test)]\nmod").next().unwrap_or_default();
    code.lines()
        .filter(|line| {
            let line = line.trim_start();
            !line.starts_with("//") && !line.starts_with("use ") && !line.starts_with("pub use ")
        })
        .flat_map(|line| [line, "\n"])
        .collect()
}

/// Whether `code` calls `symbol`, which is `function`, `Type::method` or `Type::CONSTANT`.
fn calls(code: &str, symbol: &str) -> bool {
    let name = symbol.rsplit("::").next().unwrap_or(symbol);
    if name.chars().all(|c| c.is_ascii_uppercase() || c == '_') {
        return code.contains(symbol);
    }
    let (path, method) = (format!("{symbol}("), format!(".{name}("));
    if symbol.contains("::") {
        return code.contains(&path)
            || (name != "new" && code.contains(&method))
            // Handed over as a function.
            || code.contains(&format!("({symbol})"));
    }
    code.match_indices(&path).any(|(at, _)| {
        let before = &code[..at];
        !before.ends_with("fn ") && !before.ends_with(|c: char| c.is_alphanumeric() || c == '_')
    })
}

/// Whether `text` holds the function `name` right below a `#[test]`, attributes between allowed.
pub(crate) fn is_test(text: &str, name: &str) -> bool {
    text.find(&format!("fn {name}(")).is_some_and(|at| {
        text[..at]
            .trim_end()
            .lines()
            .rev()
            .take_while(|line| line.trim_start().starts_with('#'))
            .any(|line| line.trim() == "#[test]")
    })
}

/// Asserts that the tests that a cell names exist: `crate: test`, the crate of the name before where
/// none is given.
fn tests_exist(of: &str, tests: &[String]) {
    let contract = read("tests/src/arm_contract.rs").unwrap();
    let mut member = String::new();
    for code in tests {
        if let Some(clause) = code.strip_prefix("contract: ") {
            let clause = format!("fn {clause}<H: Harness>(");
            assert!(contract.contains(&clause), "{of}: no clause `{code}`");
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
            "{of}: no test `{name}` in {member}"
        );
    }
}

#[test]
fn every_hazard_has_a_test_that_exists() {
    let mut named = 0;
    for Row { hazard, tests, .. } in rows() {
        tests_exist(&hazard, &tests);
        assert!(!tests.is_empty(), "{hazard}: no test");
        named += tests.len();
    }
    assert!(named >= 24, "the tables were not read: {named}");
}

/// docs/WITHDRAWAL.md: each cell of the kinds of stop is in the list that is tried on every back end,
/// has a test of its own, or says why it has none.
#[test]
fn every_kind_of_stop_has_a_way_out_that_is_tried() {
    let text = read("docs/WITHDRAWAL.md").unwrap();
    let mut listed = Vec::new();
    for line in text.lines().filter(|line| line.starts_with("| ")).skip(1) {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        assert_eq!(cells.len(), 7, "five columns: {line}");
        let kind = cells[1];
        for cell in &cells[3..6] {
            match *cell {
                "list" => listed.push(kind),
                cell if cell.starts_with('`') => tests_exist(kind, &codes(cell)),
                reason => assert!(reason.starts_with("as "), "{kind}: {reason}"),
            }
        }
    }
    for kind in crate::ways_out::names() {
        assert!(listed.contains(&kind), "{kind} is not in the table");
    }
    for kind in listed {
        let known = crate::ways_out::names().any(|name| name == kind);
        assert!(known, "{kind} is not in the list");
    }
}

#[test]
fn every_mitigation_is_called_by_the_product() {
    let mut held = 0;
    for row in rows() {
        let hazard = &row.hazard;
        held += 1;
        assert!(!row.symbols.is_empty(), "{hazard}: no symbol");
        let callers: Vec<(&String, String)> = row
            .callers
            .iter()
            .map(|file| {
                assert!(
                    file.contains("/src/"),
                    "{hazard}: {file} is no product code"
                );
                let text = read(file).unwrap_or_else(|| panic!("{hazard}: no file {file}"));
                (file, product(&text))
            })
            .collect();
        for symbol in &row.symbols {
            assert!(
                callers.iter().any(|(_, code)| calls(code, symbol)),
                "{hazard}: `{symbol}` is called in none of {:?}",
                row.callers
            );
        }
        for (file, code) in &callers {
            assert!(
                row.symbols.iter().any(|symbol| calls(code, symbol)),
                "{hazard}: {file} calls none of {:?}",
                row.symbols
            );
        }
    }
    assert!(held >= 50, "the tables were not read: {held}");
}

#[test]
fn every_hazard_names_its_back_ends() {
    for row in rows() {
        let known = |name: &str| BACK_ENDS.contains(&name);
        assert!(
            row.back_ends.split(", ").all(known),
            "{}: `{}`",
            row.hazard,
            row.back_ends
        );
    }
}

#[test]
fn a_definition_a_comment_or_a_test_is_no_call() {
    let text = "use a::admit;\n// admit(1)\nfn admit(x: f64) {}\n#[cfg(test)]\nmod tests {\n admit(1.0);\n}\n";
    assert!(!calls(&product(text), "admit"));
    assert!(!calls(&product("fn f() { readmit(1); }"), "admit"));
    assert!(calls(&product("fn f() { admit(1); }"), "admit"));
    assert!(calls(
        &product("fn f() { budget.admit(1); }"),
        "TurnBudget::admit"
    ));
    assert!(!calls(
        &product("fn f() { Other::new(1); }"),
        "Guarded::new"
    ));
}
